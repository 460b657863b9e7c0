"""Kinds of broken figures in the plane."""

import numpy as np

from nilbs.characters.gingerbread import gingerbread

from .bodies import chain, joined, plate, plate_spine, reversed_faces, shifted, skeleton
from .case import Case, kind
from .damage import (
    as_soup,
    with_doubled_faces,
    with_flat_faces,
    with_flips,
    with_hanging_vertices,
    with_holes,
    with_isolated_vertices,
    with_needles,
    with_seams,
)
from .defects import (
    boundary_edges,
    bow_ties,
    crowded_edges,
    flat_faces,
    hanging_vertices,
    holes,
    isolated_vertices,
    needles,
    negative_triangles,
    overlapping_triangles,
    pieces,
    repeated_faces,
    repeated_vertices,
)


def flat_gingerbread():
    V, T, C, BE = gingerbread(2)
    return (V, T), skeleton(C[:, :2], BE)


@kind(lambda c: holes(c.F) == 4)
def flat_with_holes(rng):
    V, F = plate()
    middle = np.array([[0.5, 0.2], [1, 0.8], [1.5, 0.45]])
    distance = np.linalg.norm(V[F].mean(axis=1)[:, None] - middle, axis=2).min(axis=1)
    return Case(V, F[distance > 0.12], plate_spine())


@kind(lambda c: boundary_edges(c.F) > 400)
def flat_with_a_ragged_rim(rng):
    mesh, s = flat_gingerbread()
    return Case(*with_holes(mesh, rng, 30, 0.015), s)


@kind(lambda c: 300 < negative_triangles(c.V, c.F) < len(c.F) - 300)
def flat_half_flipped(rng):
    return Case(*with_flips(plate(), rng, 0.5), plate_spine())


@kind(lambda c: negative_triangles(c.V, c.F) == len(c.F))
def flat_all_flipped(rng):
    return Case(*reversed_faces(plate()), plate_spine())


@kind(lambda c: overlapping_triangles(c.V, c.F) > 100 and pieces(c.F) == 1)
def flat_arm_over_body(rng):
    """A strip bent so far that one end covers the other."""
    V, F = plate(8)
    angle = 1.6 * np.pi * V[:, 0] ** 2 / 2
    V = np.stack([np.sin(angle), np.cos(angle)], axis=1) * (0.4 + V[:, 1:] * 0.4)
    middle = 1.6 * np.pi * np.array([0.3, 0.9, 1.4, 1.9]) ** 2 / 2
    return Case(V, F, chain(0.6 * np.stack([np.sin(middle), np.cos(middle)], axis=1)))


@kind(lambda c: overlapping_triangles(c.V, c.F) > 50 and pieces(c.F) == 2)
def flat_pieces_that_overlap(rng):
    V, F = plate(12)
    C = [[0.2, 0.5], [1.8, 0.5], [1.1, 0.8], [1.1, 2.3]]
    return Case(
        *joined((V, F), (V[:, ::-1] * [0.5, 1] + [0.8, 0.5], F[:, ::-1])), skeleton(C, [[0, 1], [2, 3]], [-1, 0])
    )


@kind(lambda c: repeated_faces(c.F, same_way=True) > 500)
def flat_doubled(rng):
    return Case(*with_doubled_faces(plate(), rng, 0.5, same_way=True), plate_spine())


@kind(lambda c: repeated_faces(c.F, same_way=False) > 500 and crowded_edges(c.F) > 0)
def flat_doubled_the_other_way(rng):
    return Case(*with_doubled_faces(plate(), rng, 0.5, same_way=False), plate_spine())


@kind(lambda c: isolated_vertices(c.V, c.F) == 100)
def flat_isolated_vertices(rng):
    return Case(*with_isolated_vertices(plate(), rng, 100, 3), plate_spine())


@kind(lambda c: (c.skeleton.C[:, 1] > 1).all())
def flat_joints_outside(rng):
    return Case(*plate(), chain([[0.3, 1.2], [1, 1.1], [1.9, 1.3]]))


@kind(lambda c: (c.skeleton.C[:, 0] > 2).any() and (c.skeleton.C[:, 0] < 2).any())
def flat_joints_partly_outside(rng):
    return Case(*plate(), chain([[0.3, 0.5], [1.3, 0.5], [2.3, 0.5], [2.6, 0.5]]))


@kind(lambda c: pieces(c.F) == 3)
def flat_pieces(rng):
    meshes = [shifted(plate(10), 0, 1.5 * i) for i in range(3)]
    return Case(*joined(*meshes), chain([[0.2, 0.5], [1.8, 0.5], [1.8, 2], [0.2, 2]]))


@kind(lambda c: pieces(c.F) == len(c.F) and repeated_vertices(c.V) > 0)
def flat_soup(rng):
    mesh, s = flat_gingerbread()
    return Case(*as_soup(mesh), s)


@kind(lambda c: repeated_vertices(c.V) > 30)
def flat_seams(rng):
    mesh, s = flat_gingerbread()
    return Case(*with_seams(mesh, rng, 8), s)


@kind(lambda c: flat_faces(c.V, c.F) >= 150)
def flat_faces_without_area(rng):
    return Case(*with_flat_faces(plate(), rng, 50), plate_spine())


@kind(lambda c: needles(c.V, c.F) >= 90)
def flat_needles(rng):
    return Case(*with_needles(plate(), rng, 100), plate_spine())


@kind(lambda c: hanging_vertices(c.V, c.F) > 30)
def flat_t_junctions(rng):
    return Case(*with_hanging_vertices(plate(), rng, 60), plate_spine())


@kind(lambda c: bow_ties(c.F) == 1)
def flat_bow_tie(rng):
    V, F = plate(8)
    corner = int(((V - [2, 1]) ** 2).sum(axis=1).argmin())
    V2, F2 = joined((V, F), shifted((V, F), 2, 1))
    return Case(V2, np.where(len(V) == F2, corner, F2), chain([[0.3, 0.5], [1.6, 0.6], [2.4, 1.4], [3.7, 1.6]]))


@kind(lambda c: len(c.F) == 1)
def flat_single_triangle(rng):
    return Case(
        np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([[0, 1, 2]]), chain([[0.1, 0.1], [0.3, 0.3], [0.8, 0.1]])
    )


@kind(lambda c: len(np.unique(c.skeleton.C[c.skeleton.BE].reshape(-1, 4), axis=0)) == 3 and len(c.skeleton.BE) == 9)
def flat_coincident_bones(rng):
    s = plate_spine()
    return Case(*plate(), skeleton(s.C, np.tile(s.BE, (3, 1)), np.concatenate([s.P, np.arange(3), np.arange(3, 6)])))


@kind(lambda c: (c.skeleton.BE[:, 0] == c.skeleton.BE[:, 1]).all())
def flat_only_points(rng):
    C = plate_spine().C
    return Case(*plate(), skeleton(C, np.arange(4)[:, None].repeat(2, 1), np.arange(4) - 1))


@kind(lambda c: len(c.skeleton.BE) == 2 and boundary_edges(c.F) > 100)
def flat_crossing_bones(rng):
    return Case(*plate(), skeleton([[0.2, 0.2], [1.8, 0.8], [0.2, 0.8], [1.8, 0.2]], [[0, 1], [2, 3]], [-1, 0]))


@kind(lambda c: holes(c.F) == 2)
def flat_bone_in_a_hole(rng):
    V, F = plate()
    centre = V[F].mean(axis=1)
    return Case(
        V, F[np.linalg.norm(centre - [1, 0.5], axis=1) > 0.3], chain([[0.2, 0.5], [0.85, 0.5], [1.15, 0.5], [1.8, 0.5]])
    )


def _scaled(scale, shift):
    def make(rng):
        (V, F), s = flat_gingerbread()
        return Case(scale * V + shift, F, skeleton(scale * s.C + shift, s.BE))

    return make


for scale in (1e-9, 1e-4, 1e4):
    kind(lambda c, scale=scale: 0.5 < np.ptp(c.V) / scale < 2, name=f"flat_scale_{scale:g}")(_scaled(scale, 0))
kind(lambda c: np.abs(c.V).min() > 0.9e5, name="flat_offset_of_1e5_sizes")(_scaled(1, 1e5))


@kind(lambda c: np.ptp(c.V[:, 1]) == 0, outcome="error", error="extent|area|line")
def flat_on_a_line(rng):
    V, F = plate()
    return Case(V * [1, 0], F, chain(plate_spine().C * [1, 0]))


@kind(lambda c: c.skeleton.C[:, 0].min() > 2, outcome="error", error="unit|frame")
def flat_rig_in_another_frame(rng):
    return Case(*plate(), chain(plate_spine().C + np.array([50, 0])))


@kind(lambda c: c.skeleton.d == 3 and np.ptp(c.skeleton.C[:, 2]) > 0, outcome="error", error="flat|dimension")
def flat_mesh_with_a_rig_in_space(rng):
    s = plate_spine()
    return Case(*plate(), chain(np.concatenate([s.C, s.C[:, :1]], axis=1)))


def _wild(rng):
    mesh, s = flat_gingerbread()
    mesh = with_flips(with_holes(mesh, rng, 4, 0.02), rng, 0.3)
    mesh = with_doubled_faces(mesh, rng, 0.2, same_way=bool(rng.integers(2)))
    mesh = with_isolated_vertices(with_flat_faces(with_needles(mesh, rng, 20), rng, 20), rng, 20, 1)
    mesh = as_soup(mesh) if rng.integers(2) else joined(mesh, plate(4))
    return Case(*mesh, skeleton(s.C + 0.04 * rng.normal(size=s.C.shape), s.BE))


for name in ("a", "b", "c"):
    kind(lambda c: flat_faces(c.V, c.F) >= 50 and boundary_edges(c.F) > 100, name=f"flat_wild_{name}")(_wild)
