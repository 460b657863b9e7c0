"""Every kind has the defect that its name states, so that the list cannot rot."""

from dataclasses import replace

import numpy as np
import pytest

from . import defects, figures, rigs, surfaces  # noqa: F401  (they fill the list)
from .bodies import ball, box, person, person_skeleton, plate, spine, tube, worm
from .case import KINDS


@pytest.mark.parametrize("name", KINDS)
def test_a_kind_is_broken_as_its_name_states_and_its_body_before_is_not(name: str) -> None:
    kind = KINDS[name]
    case, again = kind.case(), kind.case()
    assert kind.is_broken(case)
    np.testing.assert_array_equal(again.V, case.V)
    np.testing.assert_array_equal(again.F, case.F)
    np.testing.assert_array_equal(again.skeleton.C, case.skeleton.C)
    if case.solid is not None:
        V, F = case.solid
        assert not kind.is_broken(replace(case, V=V, F=F))


def test_there_are_many_kinds() -> None:
    assert len(KINDS) >= 136


def test_bodies_are_intact() -> None:
    for V, F in (
        worm(),
        person(),
        tube([[0, 0, 0], [1, 0, 0], [2, 1, 0]], 0.1),
        ball([1, 2, 3], 2.0),
        box([0] * 3, [1] * 3),
    ):
        assert defects.boundary_edges(F) == defects.crowded_edges(F) == defects.misoriented_edges(F) == 0
        assert defects.crossings(V, F) == defects.flat_faces(V, F) == defects.bow_ties(F) == 0
        assert defects.pieces(F) == 1
        assert defects.enclosed_volume(V, F) > 0
        assert defects.isolated_vertices(V, F) == defects.repeated_vertices(V) == defects.hanging_vertices(V, F) == 0
    assert defects.joints_outside(*worm(), spine().C) == 0
    assert defects.joints_outside(*person(), person_skeleton().C) == 0
    assert defects.negative_triangles(*plate()) == defects.overlapping_triangles(*plate()) == 0
