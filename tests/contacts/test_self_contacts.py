import numpy as np
import pytest

from nilbs.contacts.self_contacts import SelfContactFinder, self_contacts, touching
from nilbs.engine.other_roots import other_roots
from nilbs.engine.unit_frame import at_rest
from nilbs.geometry.distance import closest_points
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.winding import winding_number
from nilbs.models.fitting import fit

from .conftest import BONES


@pytest.fixture(params=[2, 3])
def chain(chains, request):
    """A long capsule of eight bones."""
    return chains[request.param]


def test_a_chain_rolled_into_itself(chain, rolled) -> None:
    pose, c = rolled(chain, 62), chain.character
    finder = SelfContactFinder(chain, samples=20_000)
    found, posed = finder(pose), chain.posed(pose)
    # Every point that is reported is wound around twice, and its depth is its distance to the skin.
    assert len(found.depth) > 100
    assert (winding_number(posed.U, c.F, found.point) > 1.5).mean() > 0.99
    np.testing.assert_allclose(found.depth, closest_points(posed.U, c.F, found.point)[0], atol=1e-9)
    assert (np.diff(found.depth) <= 0).all()
    for rest in (found.x_rest, found.other):
        np.testing.assert_allclose(posed.posed_points(rest), found.point, atol=2e-3 * c.L)
    assert (np.abs(found.part - found.other_part) > 2).all()
    # Nearly all points of the body with two sheets of it are reported.
    x = posed.posed_points(finder.x_rest)
    twice = winding_number(posed.U, c.F, x) > 1.5
    assert len(found.depth) == pytest.approx(twice.sum(), rel=0.1)


def test_another_root_is_not_the_known_one(chain, rolled) -> None:
    c, pose = chain.character, rolled(chain, 62)
    posed = chain.posed(pose)
    rest = SelfContactFinder(chain, samples=5000).x_rest
    unit = at_rest(c, rest)
    x = posed.posed_points(rest)
    other, distance = other_roots(chain.engine()(posed.frame.B), x, posed.frame.to_unit, unit)
    found = ~np.isnan(other[:, 0])
    assert (found == (winding_number(posed.U, c.F, x) > 1.5)).mean() > 0.97
    assert (np.linalg.norm(other - unit, axis=1)[found] > 0.1).all()
    np.testing.assert_array_equal(np.isinf(distance), ~found)
    assert (distance[found] < 0).all()


def test_pairs_that_are_exempt_are_no_contacts(chain, rolled) -> None:
    pose = rolled(chain, 62)
    assert len(SelfContactFinder(chain, samples=5000)(pose).depth) > 0
    assert len(SelfContactFinder(chain, samples=5000, steps=BONES)(pose).depth) == 0


def test_a_bent_chain_does_not_meet_itself(chain, rolled) -> None:
    assert len(self_contacts(chain, rolled(chain, 25)).depth) == 0


def test_a_fold_is_no_contact(chain) -> None:
    """Where skin folds inside a sharp bend, a place may have two canonical points but be covered once."""
    c, s = chain.character, chain.character.skeleton
    theta = np.zeros((BONES, 1 if c.d == 2 else 3))
    theta[BONES // 2, -1] = np.radians(90)
    pose = forward_kinematics(s.C, s.BE, s.P, theta)
    finder = SelfContactFinder(chain, samples=20_000)
    finder.exempt = np.eye(BONES, dtype=bool)  # neighbours are looked at, too
    found, posed = finder(pose), chain.posed(pose)
    unit = at_rest(c, finder.x_rest)
    x = posed.posed_points(finder.x_rest)
    other, _ = other_roots(chain.engine()(posed.frame.B), x, posed.frame.to_unit, unit)
    w = winding_number(posed.U, c.F, x)
    two = ~np.isnan(other[:, 0])
    assert (two & (w > 0.9) & (w < 1.1)).sum() > 20
    assert len(found.depth) > 10
    assert (winding_number(posed.U, c.F, found.point) > 1.5).all()
    # Of the points with two canonical points that the mesh covers twice, none is lost unless one part has both.
    parts = [finder.part_of_facet[closest_points(c.V, c.F, p[two])[1]] for p in (finder.x_rest, other * c.L + c.center)]
    lost = np.setdiff1d(np.flatnonzero(two)[(w[two] > 1.5) & (parts[0] != parts[1])], found.sample)
    assert len(lost) <= 0.02 * len(found.sample)


def test_neighbours_are_exempt(chain) -> None:
    finder = SelfContactFinder(chain, samples=10, steps=3)
    i = np.arange(BONES)
    np.testing.assert_array_equal(finder.exempt, np.abs(i[:, None] - i) <= 3)


def test_parts_that_touch() -> None:
    V = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [5, 0], [6, 0]])
    F, part = np.array([[0, 1], [2, 3], [4, 5]]), np.array([0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(touching(V, F, part, 3, 0.9), np.zeros((3, 3), dtype=bool))
    near = touching(V, F, part, 3, 1.1)
    assert np.argwhere(near).tolist() == [[0, 1], [1, 0]]


def test_other_methods_are_refused(chain, rolled) -> None:
    other = fit(chain.character, chain.motion, method="nearest")
    with pytest.raises(ValueError, match="the method nearest has not here"):
        SelfContactFinder(other)
    with pytest.raises(ValueError, match=r"pose must be \(b, d\+1, d\+1\)"):
        SelfContactFinder(chain, samples=10)(rolled(chain, 5)[None])
