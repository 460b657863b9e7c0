"""Kinds of broken skeletons, in bodies that are as they should be; and characters broken in several ways at once."""

import numpy as np

from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

from .bodies import (
    Mesh,
    ball,
    box,
    chain,
    joined,
    person,
    person_of_parts,
    person_skeleton,
    shifted,
    skeleton,
    spine,
    worm,
)
from .case import Case, kind
from .damage import (
    as_soup,
    crumpled,
    turned,
    with_doubled_faces,
    with_fins,
    with_flat_faces,
    with_flips,
    with_holes,
    with_isolated_vertices,
    with_seams,
    with_two_shells,
)
from .defects import boundary_edges, joints_outside, pieces, relative_lengths, size


def moved(s: Skeleton, C: np.ndarray) -> Skeleton:
    return Skeleton(C, s.BE, s.P, s.names, s.forks)


def outside(c: Case) -> int:
    return joints_outside(c.V, c.F, c.skeleton.C)


def lengths(c: Case) -> np.ndarray:
    return relative_lengths(c.V, c.F, c.skeleton.C, c.skeleton.BE)


@kind(lambda c: outside(c) == len(c.skeleton.C))
def joints_all_outside(rng):
    return Case(*worm(), moved(spine(), spine().C + np.array([0, 0.15, 0.1])))


@kind(lambda c: 0 < outside(c) < len(c.skeleton.C))
def joints_partly_outside(rng):
    return Case(*worm(), spine(5, -0.3, 1.2))


@kind(lambda c: 3 <= outside(c) < 14)
def joints_outside_at_random(rng):
    s = person_skeleton()
    return Case(*person(), moved(s, s.C + 0.1 * rng.normal(size=s.C.shape)))


@kind(lambda c: (c.skeleton.C[:, None] == c.V).all(axis=2).any(axis=1).all())
def joints_on_vertices(rng):
    V, F = worm()
    return Case(V, F, chain(V[16 * np.array([3, 12, 20, 29])]))


@kind(lambda c: outside(c) == 2)
def one_joint_far_away(rng):
    """A bone for an aim of the eyes or a foot, well in front of the body."""
    s = person_skeleton()
    C = np.concatenate([s.C, [[0.05, 0.9, 2.5], [0.05, 0.9, 2.6]]])
    return Case(*person(), skeleton(C, np.concatenate([s.BE, [[15, 16]]]), np.append(s.P, 1)))


@kind(lambda c: (lengths(c) > 0.1).all() and len(np.unique(c.skeleton.C[c.skeleton.BE].reshape(-1, 6), axis=0)) == 4)
def coincident_bones(rng):
    """Every bone three times."""
    s = spine()
    return Case(*worm(), skeleton(s.C, np.tile(s.BE, (3, 1)), np.concatenate([s.P, np.arange(4), np.arange(4, 8)])))


def _nearly_coincident(gap):
    def make(rng):
        s = spine()
        C = np.concatenate([s.C, s.C + gap * rng.uniform(-1, 1, s.C.shape)])
        return Case(*worm(), skeleton(C, np.concatenate([s.BE, s.BE + 5]), np.concatenate([s.P, np.arange(4)])))

    return make


for gap in (1e-9, 1e-6, 1e-3):
    kind(lambda c, gap=gap: 0 < np.abs(c.skeleton.C[:5] - c.skeleton.C[5:]).max() <= gap, name=f"bones_{gap:g}_apart")(
        _nearly_coincident(gap)
    )


@kind(lambda c: (lengths(c) == 0).sum() == 3)
def bones_without_length(rng):
    """In the middle of a chain, joints that lie on each other."""
    x = np.array([0.1, 0.3, 0.3, 0.3, 0.6, 0.6, 0.9])
    return Case(*worm(), chain(np.stack([x, 0 * x, 0 * x], axis=1)))


@kind(lambda c: (lengths(c) == 0).all())
def only_points(rng):
    x = np.linspace(0.1, 0.9, 5)
    return Case(
        *worm(), skeleton(np.stack([x, 0 * x, 0 * x], axis=1), np.arange(5)[:, None].repeat(2, 1), np.arange(5) - 1)
    )


@kind(lambda c: np.ptp(c.skeleton.C, axis=0).max() == 0 and len(c.skeleton.BE) == 4)
def all_bones_at_one_point(rng):
    return Case(*worm(), chain(np.tile([0.4, 0.01, 0], (5, 1))))


def _tiny(length):
    def make(rng):
        x = np.array([0.1, 0.4, 0.4 + length, 0.4 + 2 * length, 0.9])
        return Case(*worm(), chain(np.stack([x, 0 * x, 0 * x], axis=1)))

    return make


for length in (1e-9, 1e-6, 1e-3):
    kind(lambda c, length=length: 0 < np.sort(lengths(c))[1] < 1.01 * length, name=f"bones_{length:g}_long")(
        _tiny(length)
    )


@kind(lambda c: (lengths(c) == 0).sum() == 5 and len(c.skeleton.forks) > 0)
def bones_are_joints(rng):
    """As game rigs are: a bone for every joint, those at the tips without length."""
    s = person_skeleton()
    parent = np.full(len(s.C), -1)
    parent[s.BE[:, 1]] = s.BE[:, 0]
    return Case(*person(), skeleton_of_joints(s.C, parent, [f"joint{i}" for i in range(len(s.C))]))


@kind(lambda c: (lengths(c) == 0).sum() >= 8 and len(np.unique(c.skeleton.C, axis=0)) < len(c.skeleton.C))
def bones_are_joints_some_twice(rng):
    """As game rigs are, with helpers on top of other joints."""
    s = person_skeleton()
    parent = np.full(len(s.C), -1)
    parent[s.BE[:, 1]] = s.BE[:, 0]
    again = [1, 4, 7, 10, 13]
    C, parent = np.concatenate([s.C, s.C[again]]), np.concatenate([parent, again])
    return Case(*person(), skeleton_of_joints(C, parent, [f"joint{i}" for i in range(len(C))]))


@kind(
    lambda c: (
        np.linalg.norm(c.skeleton.C[c.skeleton.BE[1:, 0]] - c.skeleton.C[c.skeleton.BE[c.skeleton.P[1:], 1]], axis=1)
        > 0.01
    ).all()
)
def parents_that_do_not_meet_children(rng):
    x = np.array([[0.1, 0.2], [0.3, 0.45], [0.5, 0.62], [0.7, 0.9]]).ravel()
    C = np.stack([x, 0.02 * np.sin(40 * x), 0 * x], axis=1)
    return Case(*worm(), skeleton(C, np.arange(8).reshape(4, 2), [-1, 0, 1, 2]))


@kind(lambda c: (c.skeleton.P < 0).all() and len(c.skeleton.P) == 4)
def several_roots(rng):
    s = spine()
    return Case(*worm(), skeleton(s.C, s.BE, [-1] * 4))


@kind(lambda c: len(c.skeleton.BE) == 1)
def one_bone(rng):
    return Case(*worm(), spine(1))


@kind(lambda c: len(c.skeleton.BE) == 1 and outside(c) == 2)
def one_bone_outside(rng):
    return Case(*worm(), chain([[0.2, 0.2, 0], [0.8, 0.2, 0]]))


@kind(lambda c: len(c.skeleton.BE) == 1 and lengths(c).max() == 0)
def one_point(rng):
    return Case(*worm(), skeleton([[0.5, 0, 0]], [[0, 0]], [-1]))


@kind(lambda c: len(c.skeleton.BE) == 200)
def chain_of_200(rng):
    return Case(*worm(rings=65, around=12), spine(200, 0.02, 0.98))


@kind(lambda c: len(c.skeleton.BE) == 200 and outside(c) == 0)
def tree_of_200(rng):
    x = turned(rng.uniform(-1, 1, (4000, 3)), rng)
    C = 0.9 * x[np.linalg.norm(x, axis=1) < 1][:201]
    parent = [int(np.linalg.norm(C[:i] - C[i], axis=1).argmin()) for i in range(1, 201)]
    return Case(*ball([0, 0, 0], 1, around=32), skeleton(C, np.stack([parent, np.arange(1, 201)], axis=1)))


@kind(lambda c: len(c.skeleton.BE) == 40 and (c.skeleton.BE[:, 0] == 0).all())
def forty_bones_from_one_joint(rng):
    tips = rng.normal(size=(40, 3))
    C = np.concatenate([[[0, 0, 0]], 0.8 * tips / np.linalg.norm(tips, axis=1, keepdims=True)])
    return Case(
        *ball([0, 0, 0], 1, around=24), skeleton(C, np.stack([np.zeros(40, dtype=int), np.arange(1, 41)], axis=1))
    )


@kind(lambda c: len(c.skeleton.BE) == 3 and np.abs(c.skeleton.C.reshape(3, 2, 3).mean(axis=1)).max() < 1e-12)
def crossing_bones(rng):
    C = [[-0.7, 0, 0], [0.7, 0, 0], [0, -0.7, 0], [0, 0.7, 0], [0, 0, -0.7], [0, 0, 0.7]]
    return Case(*ball([0, 0, 0], 1), skeleton(C, [[0, 1], [2, 3], [4, 5]], [-1, 0, 1]))


@kind(lambda c: len(c.skeleton.BE) == 2 and lengths(c)[1] < lengths(c)[0] and (c.skeleton.C[:, 1:] == 0).all())
def bone_within_a_bone(rng):
    C = np.array([[0.1, 0, 0], [0.9, 0, 0], [0.4, 0, 0], [0.6, 0, 0]])
    return Case(*worm(), skeleton(C, [[0, 1], [2, 3]], [-1, 0]))


@kind(lambda c: pieces(c.F) == 2 and outside(c) == 0)
def bone_from_one_body_to_another(rng):
    C = [[0.1, 0, 0], [0.9, 0, 0], [0.9, 0.4, 0], [0.1, 0.4, 0]]
    return Case(*joined(worm(), shifted(worm(), 0, 0.4, 0)), skeleton(C, [[0, 1], [1, 2], [2, 3]]))


@kind(lambda c: outside(c) == 0 and np.linalg.norm(np.diff(c.skeleton.C[[5, 8]], axis=0)) > 0.5)
def bone_across_the_gap(rng):
    """A bone from one hand to the other, far below the chest."""
    s = person_skeleton()
    return Case(*person(), skeleton(s.C, np.concatenate([s.BE, [[11, 14]]]), np.append(s.P, 0)))


@kind(lambda c: size(c.V, c.F) * 30 < np.ptp(c.skeleton.C, axis=0).max(), outcome="error", error="unit")
def rig_in_a_unit_100_times_larger(rng):
    s = person_skeleton()
    return Case(*person(), moved(s, 100 * s.C))


@kind(lambda c: size(c.V, c.F) > 30 * np.ptp(c.skeleton.C, axis=0).max(), outcome="either", error="unit")
def rig_in_a_unit_100_times_smaller(rng):
    s = person_skeleton()
    return Case(*person(), moved(s, 0.01 * s.C))


@kind(lambda c: c.skeleton.C[:, 0].min() > c.V[:, 0].max(), outcome="error", error="unit|frame")
def rig_in_another_frame(rng):
    s = person_skeleton()
    return Case(*person(), moved(s, s.C + np.array([5, 0, 0])))


@kind(lambda c: outside(c) > 5, outcome="either", error="unit|frame")
def rig_with_another_axis_up(rng):
    s = person_skeleton()
    return Case(*person(), moved(s, s.C[:, [0, 2, 1]]))


@kind(lambda c: c.skeleton.d == 2 and c.V.shape[1] == 3, outcome="error", error="dimension")
def rig_of_another_dimension(rng):
    s = spine()
    return Case(*worm(), moved(s, s.C[:, :2]))


def _scaled(scale, shift):
    def make(rng):
        s = person_skeleton()
        V, F = person(24)
        return Case(scale * V + shift, F, moved(s, scale * s.C + shift))

    return make


for scale in (1e-12, 1e-9, 1e-4, 1e4, 1e9):
    kind(lambda c, scale=scale: 1 < size(c.V, c.F) / scale < 2, name=f"scale_{scale:g}")(_scaled(scale, 0))
kind(lambda c: np.abs(c.V).min() > 0.9e5, name="offset_of_1e5_sizes")(_scaled(1, 1.2e5))


@kind(lambda c: len(c.skeleton.BE) == 2 and outside(c) == 0)
def more_than_fits_a_cube(rng):
    """Bones of one body inside another one's box, and a body as thin as its bone."""
    rod = box([-2, 0.499, 0.499], [2, 0.501, 0.501])
    return Case(*joined(box([0, 0, 0], [1, 1, 1]), rod), chain([[-1.9, 0.5, 0.5], [0.5, 0.5, 0.5], [1.9, 0.5, 0.5]]))


def damaged(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Holes and flips, and three more kinds of damage by chance."""
    more = [
        lambda m: with_two_shells(m, rng),
        lambda m: joined(m, ball(rng.uniform(-0.5, 1, 3), 0.05, around=8)),
        lambda m: with_doubled_faces(m, rng, rng.uniform(), same_way=bool(rng.integers(2))),
        lambda m: with_fins(m, rng, 20, both_sides=bool(rng.integers(2))),
        lambda m: with_flat_faces(m, rng, 20),
        lambda m: with_seams(m, rng, 8),
        lambda m: crumpled(m, rng, rng.uniform(0, 0.5)),
        lambda m: with_isolated_vertices(m, rng, 50, rng.choice([0.5, 10.0])),
        lambda m: with_holes(m, rng, 5, 0.02),
        as_soup,
    ]
    mesh = with_flips(with_holes(mesh, rng, 3, 0.04), rng, rng.choice([0.05, 0.5]))
    for i in rng.permutation(len(more))[:3]:
        mesh = more[i](mesh)
    return mesh


def with_bad_joints(s: Skeleton, rng: np.random.Generator) -> Skeleton:
    """Joints moved, some out of the body, some onto each other, some bones twice."""
    C = s.C + rng.choice([0.01, 0.05]) * rng.normal(size=s.C.shape)
    i, j = rng.permutation(len(C))[:2]
    C[i] = C[j]
    again = rng.permutation(len(s.BE))[:3]
    return skeleton(C, np.concatenate([s.BE, s.BE[again], [[2, 2]]]), np.concatenate([s.P, again, [1]]))


def _wild(rng):
    solid = person() if rng.integers(2) else person_of_parts()
    return Case(*damaged(solid, rng), with_bad_joints(person_skeleton(), rng), solid)


for name in ("a", "b", "c", "d", "e", "f"):
    kind(lambda c: boundary_edges(c.F) > 20 and len(c.skeleton.BE) == 18, name=f"wild_{name}")(_wild)
