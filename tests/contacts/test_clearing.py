import numpy as np
import pytest

from nilbs.characters.motion import Motion
from nilbs.contacts.blending import smallest_blend
from nilbs.contacts.clearing import REACH, SMOOTH, clear_motion, roughness, windows_near
from nilbs.contacts.demands import Finders
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.least_change import least_change, smoothing_inverse
from nilbs.contacts.obstacles import joined
from nilbs.contacts.pairs import Contacts
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rotation_matrices, rotation_vectors


@pytest.fixture(scope="module")
def rolling(chains, rolled) -> dict[int, Motion]:
    """By dimension: a chain that rolls until it meets itself, and back."""
    found = {}
    for d in (2, 3):
        degrees = np.concatenate([np.full(10, 40.0), np.linspace(40, 62, 6), np.linspace(62, 40, 6), np.full(10, 40.0)])
        B = np.stack([rolled(chains[d], angle) for angle in degrees])
        found[d] = Motion(B, np.arange(len(B)), "rolling", skeleton=chains[d].character.skeleton)
    return found


@pytest.mark.parametrize("d", [2, 3])
def test_a_chain_is_kept_from_itself(chains, rolling, d) -> None:
    model, motion = chains[d], rolling[d]
    finder, L = SelfContactFinder(model, samples=3000), model.character.L
    found = clear_motion(model, motion, finder=finder)
    assert found.before.depth.max() > 0.01 * L
    assert len(found.remaining) == 0
    depth = np.array([finder(B).depth.max(initial=0.0) for B in found.motion.B])
    assert depth.max() < 0.005 * L
    # What is far from contacts stays, and the change is smooth.
    touched = np.flatnonzero(found.before.bad)
    away = np.abs(np.arange(len(motion))[:, None] - touched).min(axis=1) > REACH
    assert away.any()
    np.testing.assert_array_equal(found.motion.B[away], motion.B[away])
    changes = JointChanges(motion.skeleton, motion.B)
    rough = [roughness(changes.rotations(np.arange(len(motion)), c)) for c in (None, found.change)]
    assert rough[1] <= max(2 * rough[0], np.radians(2)) + 1e-12
    # A blend with the rest pose changes the joints more.
    run = np.flatnonzero(found.change.any(axis=(1, 2)))

    def bad(frames: np.ndarray, B: np.ndarray) -> np.ndarray:
        return np.array([finder(pose).depth.max(initial=0.0) > 0.0045 * L for pose in B])

    blend = smallest_blend(changes, run, bad, smooth=1.5, ends=(True, True))
    assert (found.change**2).sum() < (blend**2).sum()
    values = found.values(motion, L)
    assert values["after"]["deepest_of_L"] == pytest.approx(depth.max() / L)
    assert values["summed_squared_change"] == pytest.approx((found.change**2).sum())


def test_only_joints_that_matter_are_turned(chains) -> None:
    """A chain that is twisted at its first joint rolls until it meets itself: it unrolls a little, the twist stays."""
    model = chains[3]
    s, L = model.character.skeleton, model.character.L
    poses = []
    for degrees in np.concatenate([np.full(10, 40.0), np.linspace(40, 65, 6), np.linspace(65, 40, 6), np.full(10, 40)]):
        theta = np.zeros((len(s.BE), 3))
        theta[1, 1], theta[2:, 2] = np.radians(170), np.radians(degrees)
        poses.append(forward_kinematics(s.C, s.BE, s.P, theta))
    motion = Motion(np.stack(poses), np.arange(len(poses)), "twisted", skeleton=s)
    finder = SelfContactFinder(model, samples=3000)
    left: list[int] = []
    found = clear_motion(model, motion, finder=finder, step=left.append)
    assert (len(found.remaining), len(left), left[-1]) == (0, found.rounds, 0)
    depth = np.array([finder(B).depth.max(initial=0.0) for B in found.motion.B])
    assert depth.max() < 0.005 * L < 0.02 * L < found.before.depth.max()

    def bad(frames: np.ndarray, B: np.ndarray) -> np.ndarray:
        return np.array([finder(pose).depth.max(initial=0.0) > 0.0045 * L for pose in B], dtype=bool)

    ((run, ends),) = windows_near(motion, found.before.bad)
    blend = smallest_blend(JointChanges(s, motion.B), run, bad, smooth=SMOOTH, ends=ends)
    assert (found.change**2).sum() < 0.5 * (blend**2).sum()


def test_what_is_clear_stays(chains, rolling) -> None:
    finder = SelfContactFinder(chains[2], samples=500)
    same = clear_motion(chains[2], rolling[2], finder=finder, depth=0.2)
    assert same.motion is rolling[2]
    assert (same.rounds, len(same.remaining), same.change.any()) == (0, 0, False)


def test_two_bodies_are_kept_apart(capsules, moved) -> None:
    """A capsule whose upper bone is bent by another one, which stands where it is."""
    model = capsules[2]
    still = np.stack([moved(2)] * 5)
    motion = Motion(still, np.arange(5), "still", skeleton=model.character.skeleton)
    aside = moved(2, 0.34, 0.35)
    other = type(model)(
        model.character, Motion(np.stack([aside] * 5), np.arange(5), "x"), model.method, model.history,
        model.parameters, model.rest,
    )  # fmt: skip
    found = clear_motion(model, motion, against=[other])
    assert found.before.depth.max() > 0.02
    assert len(found.remaining) == 0


@pytest.mark.parametrize("wrong", [{"depth": -0.1}, {"distance": np.inf}, {"rounds": -1}, {"smooth": np.nan}])
def test_numbers_out_of_range_are_refused(capsules, wrong) -> None:
    model = capsules[2]
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} must be a number of at least 0"):
        clear_motion(model, model.motion, **wrong)


def test_motions_and_models_that_do_not_fit_are_refused(capsules) -> None:
    model = capsules[2]
    with pytest.raises(ValueError, match="not of the skeleton"):
        clear_motion(model, Motion(model.motion.B, np.arange(len(model.motion)), "without a skeleton"))
    with pytest.raises(ValueError, match="another dimension"):
        clear_motion(model, model.motion, against=[capsules[3]])


def test_places_of_a_facet_and_of_two_bodies_are_demands_of_their_own(capsules) -> None:
    model = capsules[3]
    finders = Finders(model, model.motion, [model, model], 0.0, None, SelfContactFinder(model, samples=100))
    # Of the first two, coordinates weighted by 1, 2 and 3 have one sum; of the last two, the first two coordinates.
    barycentric = np.array([[0.5, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.25, 0.25], [0.25, 0.5, 0.25]])
    x, zero = np.linspace([0.0, 0, 0], [0.3, 0, 0], 4), np.zeros(4, dtype=np.int64)
    for of_b in (False, True):
        pair = Contacts(x, x, np.ones(4), x, np.full(4, of_b), zero, barycentric, zero, barycentric)
        sets = [demands for k in (0, 1) for demands in finders._of_pair(0, k, pair)]
        assert len(joined(sets).frame) == 8
        assert len(joined([*sets, *sets]).frame) == 8


@pytest.mark.parametrize("d", [2, 3])
def test_slopes_are_differences(chains, rolled, rng, d) -> None:
    model = chains[d]
    c, b = model.character, len(model.character.skeleton.BE)
    changes = JointChanges(c.skeleton, np.stack([rolled(model, 10), rolled(model, 30)]))
    change = 0.1 * rng.normal(size=(2, b, changes.r))
    B, of = changes.turned(np.arange(2), change), np.array([0, 1, 1])
    vertex = rng.integers(len(c.V), size=3)
    home = c.W[vertex][:, :, None] * np.concatenate([c.V[vertex], np.ones((3, 1))], axis=1)[:, None]
    along = rng.normal(size=(3, d))
    slopes = changes.slopes(B, of, home, along)

    def lengths(B: np.ndarray) -> np.ndarray:
        return np.einsum("kr,kbrc,kbc->k", along, B[of][..., :d, :], home)

    for bone in range(b):
        for axis in range(changes.r):
            turn = np.zeros_like(change)
            turn[:, bone, axis] = 1e-6
            R = rotation_matrices(turn) @ rotation_matrices(change)
            there = changes.turned(np.arange(2), rotation_vectors(R))
            np.testing.assert_allclose((lengths(there) - lengths(B)) / 1e-6, slopes[:, bone, axis], atol=1e-5)


def test_the_least_change_is_that_of_the_primal_problem(rng) -> None:
    n, v, smooth = 12, 3, 1.5
    frame, slope, demand = rng.integers(n, size=9), rng.normal(size=(9, v)), rng.uniform(0.1, 0.5, 9)
    inverse = smoothing_inverse(n, smooth, held_before=True, held_after=False)
    found = least_change(frame, slope, demand, inverse, smooth=smooth)
    met = (slope * found[frame]).sum(axis=1)
    assert (met > demand - 0.01).all()
    # Stationary: what pulls at the change are demands that are just met, each with a force that is not negative.
    pull = np.linalg.solve(inverse, found)
    tight = np.flatnonzero(met < demand + 1e-3)
    columns = np.zeros((len(tight), n, v))
    columns[np.arange(len(tight)), frame[tight]] = slope[tight]
    force, *_ = np.linalg.lstsq(columns.reshape(len(tight), -1).T, pull.ravel(), rcond=None)
    np.testing.assert_allclose(columns.reshape(len(tight), -1).T @ force, pull.ravel(), atol=1e-2)
    assert force.min() > -1e-2
