"""Every broken character gets valid weights, or the error that names its fault; there is no third outcome."""

import re
from dataclasses import replace

import numpy as np
import pytest

from nilbs.geometry.rig_weights import solve_weights

from . import figures, rigs, surfaces  # noqa: F401  (they fill the list)
from .bodies import person, person_skeleton, skeleton, spine, worm
from .case import KINDS, Case
from .verdict import body_samples, faults, shares, verdict

# One or two for every way through the solver: a solid filled as it is, a wrap, blocks where no wrap can be filled, a
# surface that is decimated, more bones than the usual elements serve, a body thinner than a cell, damage of many kinds.
FULL_RESOLUTION = [
    "bones_are_joints",
    "inside_out",
    "tree_of_200",
    "sixty_thousand_faces",
    "overlapping_bodies",
    "hair_cards",
    "plate_of_a_thousandth",
    "clothes_close_to_the_body",
    "moebius_strip",
    "more_than_fits_a_cube",
    "wild_c",
    "wild_d",
]


@pytest.mark.usefixtures("coarse_volumes")
@pytest.mark.parametrize("name", KINDS)
def test_a_broken_character_gets_valid_weights_or_its_error(name: str) -> None:
    assert verdict(KINDS[name]).problems == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", FULL_RESOLUTION)
def test_the_outcome_is_the_same_at_full_resolution(name: str) -> None:
    assert verdict(KINDS[name]).problems == ()


def test_shares_of_the_body() -> None:
    case = Case(*worm(), spine(4))
    # A bar is cut across halfway; its two ends are a little longer than its middle parts.
    np.testing.assert_allclose(shares(case), [0.28, 0.22, 0.22, 0.28], atol=0.03)
    twice = skeleton(spine().C, np.tile(spine().BE, (2, 1)), np.concatenate([spine().P, np.arange(4)]))
    np.testing.assert_allclose(shares(Case(*worm(), twice)), np.tile(shares(case), 2))
    x = body_samples(Case(*person(), person_skeleton()), np.random.default_rng(0))
    assert len(x) > 2000
    assert np.abs(x[:, 0]).max() < 0.5


@pytest.mark.usefixtures("coarse_volumes")
def test_faults_are_found() -> None:
    case = Case(*worm(), spine(2))
    solved = solve_weights(case.V, case.F, case.skeleton)
    assert faults(case, solved) == []
    for change, words in (
        ({"W": solved.W[:-1]}, r"W is \(529, 2\)"),
        ({"W": np.where(np.arange(530)[:, None] == 7, np.nan, solved.W)}, "not finite in 1 rows"),
        ({"W": solved.W + 1e-8}, "W goes to"),
        ({"W_volume": solved.W_volume * [1, 1.1]}, "W_volume goes to"),
        ({"T": solved.T[:, [1, 0, 2, 3]]}, "elements without volume"),
        (
            {name: np.tile([1.0, 0.0], (len(getattr(solved, name)), 1)) for name in ("W", "W_volume")},
            "bone 1 owns nothing, though nearest to 5",
        ),
    ):
        (found,) = faults(case, replace(solved, **change))
        assert re.search(words, found)
