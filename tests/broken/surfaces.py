"""Kinds of broken surfaces, under skeletons that are as they should be."""

import numpy as np

from .bodies import (
    ball,
    box,
    chain,
    cloth,
    joined,
    person,
    person_of_parts,
    person_skeleton,
    reversed_faces,
    shifted,
    slab,
    spine,
    strip,
    tube,
    worm,
)
from .case import Case, kind
from .damage import (
    as_soup,
    crumpled,
    quantised,
    with_cracks,
    with_doubled_faces,
    with_fins,
    with_flat_faces,
    with_flips,
    with_hanging_vertices,
    with_holes,
    with_isolated_vertices,
    with_needles,
    with_seams,
    with_spike,
    with_two_shells,
)
from .defects import (
    boundary_edges,
    bow_ties,
    crossings,
    crowded_edges,
    enclosed_volume,
    flat_faces,
    hanging_vertices,
    holes,
    isolated_vertices,
    joints_outside,
    misoriented_edges,
    needles,
    pieces,
    repeated_faces,
    repeated_vertices,
    size,
)


@kind(lambda c: holes(c.F) == 1)
def one_hole(rng):
    return Case(*with_holes(worm(), rng, 1, 0.06), spine(), worm())


@kind(lambda c: holes(c.F) >= 8)
def many_holes(rng):
    return Case(*with_holes(person(), rng, 12, 0.03), person_skeleton(), person())


@kind(lambda c: boundary_edges(c.F) > 20 and len(c.F) < 0.7 * len(c.solid[1]))
def a_third_cut_away(rng):
    V, F = worm(rings=65)
    return Case(V, F[V[F].mean(axis=1)[:, 1] > -0.04], spine(), (V, F))


@kind(lambda c: holes(c.F) == 2 and pieces(c.F) == 1)
def open_tube(rng):
    x = np.linspace(0, 1, 33)
    path = np.stack([x, 0 * x, 0 * x], axis=1)
    return Case(*tube(path, 0.1, capped=False), spine(), tube(path, 0.1))


@kind(lambda c: holes(c.F) == 1)
def mask(rng):
    """The front of a head alone."""
    V, F = ball([0, 0, 0], 1, around=24)
    return Case(V, F[V[F].mean(axis=1)[:, 2] > 0.2], chain([[0, -0.7, 0.3], [0, 0, 0.4], [0, 0.7, 0.3]]), (V, F))


@kind(lambda c: misoriented_edges(c.F) > 20)
def one_in_twenty_flipped(rng):
    return Case(*with_flips(worm(), rng, 0.05), spine(), worm())


@kind(lambda c: misoriented_edges(c.F) > 500)
def half_flipped(rng):
    return Case(*with_flips(worm(), rng, 0.5), spine(), worm())


@kind(lambda c: enclosed_volume(c.V, c.F) < 0 and misoriented_edges(c.F) == 0)
def inside_out(rng):
    return Case(*reversed_faces(worm()), spine())


@kind(lambda c: misoriented_edges(c.F) == 0 and pieces(c.F) == 2 and abs(enclosed_volume(c.V, c.F)) < 1e-9)
def one_of_two_bodies_inside_out(rng):
    other = shifted(worm(), 0, 0.5, 0)
    skeleton = chain([[0.1, 0, 0], [0.9, 0, 0], [0.9, 0.5, 0], [0.1, 0.5, 0]])
    return Case(*joined(worm(), reversed_faces(other)), skeleton, joined(worm(), other))


@kind(lambda c: repeated_faces(c.F, same_way=True) == len(c.F) // 2)
def doubled_faces(rng):
    return Case(*with_doubled_faces(worm(), rng, 1, same_way=True), spine(), worm())


@kind(lambda c: repeated_faces(c.F, same_way=False) == len(c.F) // 2)
def doubled_the_other_way(rng):
    return Case(*with_doubled_faces(worm(), rng, 1, same_way=False), spine(), worm())


@kind(lambda c: 100 < repeated_faces(c.F, same_way=False) < 500 and crowded_edges(c.F) > 100)
def partly_doubled_the_other_way(rng):
    return Case(*with_doubled_faces(worm(), rng, 0.3, same_way=False), spine(), worm())


@kind(lambda c: hanging_vertices(c.V, c.F) > 50)
def t_junctions(rng):
    return Case(*with_hanging_vertices(worm(), rng, 100), spine(), worm())


@kind(lambda c: crossings(c.V, c.F) > 50 and boundary_edges(c.F) == 0)
def self_intersecting_limb(rng):
    """A tube tied into a loop that passes through itself."""
    s = np.linspace(-0.9, 0.9, 49)
    path = np.stack([s - 1.3 * np.sin(np.pi * s), np.cos(np.pi * s) - s**2, 0 * s], axis=1)
    return Case(*tube(path, 0.15, around=12), chain(path[4:-4:8]))


@kind(lambda c: pieces(c.F) == 14 and boundary_edges(c.F) == 0 and crossings(c.V, c.F) > 500)
def overlapping_bodies(rng):
    return Case(*person_of_parts(), person_skeleton())


@kind(lambda c: pieces(c.F) == 3)
def disjoint_bodies(rng):
    skeleton = chain([[0.1, y, 0] if i % 2 == 0 else [0.9, y, 0] for y in (0, 0.3, 0.6) for i in (0, 1)])
    return Case(*joined(*(shifted(worm(), 0, y, 0) for y in (0, 0.3, 0.6))), skeleton)


@kind(lambda c: pieces(c.F) == 3 and np.ptp(c.skeleton.C[:, 1]) == 0)
def bodies_that_no_bone_enters(rng):
    V, F = worm()
    return Case(*joined((V, F), ball([0.5, 0.4, 0], 0.1), ball([1.4, 0, 0.2], 0.08)), spine())


@kind(lambda c: pieces(c.F) == 30)
def thirty_pieces(rng):
    balls = [ball(x, 0.1, around=10) for x in 0.9 * turned_grid(rng)]
    return Case(*joined(*balls), chain([[0.1, 0.1, 0.1], [0.5, 0.5, 0.5], [1, 0.9, 0.5], [1.5, 1, 0.5]]))


def turned_grid(rng):
    x = np.stack(np.meshgrid(np.arange(5), np.arange(3), np.arange(2), indexing="ij"), axis=-1).reshape(-1, 3)
    return 0.4 * x + rng.uniform(-0.05, 0.05, x.shape)


@kind(lambda c: pieces(c.F) == 2 and crossings(c.V, c.F) == 0 and joints_outside(c.V, c.F, c.skeleton.C) == 5)
def cavity(rng):
    """A hollow bar: the inner shell bounds a void around the bones."""
    V, F = worm(radius=0.12)
    return Case(*joined((V, F), reversed_faces((V * [0.9, 0.5, 0.5] + np.array([0.05, 0, 0]), F))), spine())


@kind(lambda c: pieces(c.F) == 2 and crossings(c.V, c.F) == 0)
def clothes_close_to_the_body(rng):
    V, F = worm()
    return Case(*joined((V, F), ((V - np.array([0.5, 0, 0])) * 1.05 + np.array([0.5, 0, 0]), F)), spine())


@kind(lambda c: boundary_edges(c.F) > 50 and holes(c.F) == 1)
def open_sheet(rng):
    return Case(*cloth(), chain([[0.1, 0, 0], [0.5, 0, 0], [0.9, 0, 0]]))


@kind(lambda c: np.linalg.matrix_rank(c.V[c.F.ravel()] - c.V[0], tol=1e-9) == 2, outcome="either", error="plane")
def tilted_plane(rng):
    V, F = cloth()
    V = V * [1, 1, 0] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Case(V, F, chain([V[10], V[len(V) // 2], V[-10]]))


@kind(lambda c: pieces(c.F) == 3 and crossings(c.V, c.F) > 5)
def crossing_sheets(rng):
    V, F = strip_of_cloth()
    return Case(*joined((V, F), (V[:, [0, 2, 1]], F), (V[:, [2, 1, 0]] + [0.5, 0, -0.5], F)), spine(3))


def strip_of_cloth():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 18), np.linspace(-0.21, 0.2, 8), indexing="ij"))
    return np.stack([x, y, 0 * x], axis=1), strip(18, 8)


@kind(lambda c: boundary_edges(c.F) == 0 and np.ptp(c.V, axis=0).min() < 0.0011)
def plate_of_a_thousandth(rng):
    return Case(
        *slab([0, 0, 0], [1, 0.5, 0.001]), chain([[0.1, 0.25, 0.0005], [0.5, 0.25, 0.0005], [0.9, 0.25, 0.0005]])
    )


@kind(lambda c: pieces(c.F) == 41 and boundary_edges(c.F) >= 40 * 8)
def hair_cards(rng):
    head = ball([0, 0, 0], 0.5)
    card = np.stack(np.meshgrid(np.linspace(-0.06, 0.06, 2), np.linspace(0.4, 0.9, 4), indexing="ij"), axis=-1).reshape(
        -1, 2
    )
    cards = [
        (np.pad(card, ((0, 0), (0, 1))) @ np.linalg.qr(rng.normal(size=(3, 3)))[0], strip(2, 4)) for _ in range(40)
    ]
    return Case(*joined(head, *cards), chain([[0, -0.4, 0], [0, 0, 0], [0, 0.4, 0]]), head)


@kind(lambda c: repeated_faces(c.F, same_way=False) == 30 and crowded_edges(c.F) >= 20)
def parts_without_volume(rng):
    return Case(*with_fins(worm(), rng, 30, both_sides=True), spine(), worm())


@kind(lambda c: flat_faces(c.V, c.F) >= 150)
def faces_without_area(rng):
    return Case(*with_flat_faces(worm(), rng, 50), spine(), worm())


@kind(lambda c: needles(c.V, c.F) >= 90 and boundary_edges(c.F) == 0)
def needle_triangles(rng):
    return Case(*with_needles(worm(), rng, 100), spine())


@kind(lambda c: len(c.V) == 3 * len(c.F) and pieces(c.F) == len(c.F))
def triangle_soup(rng):
    return Case(*as_soup(worm()), spine(), worm())


@kind(lambda c: pieces(c.F) == len(c.F) and repeated_vertices(c.V) == 0)
def soup_with_gaps(rng):
    return Case(*with_cracks(worm(), rng, 1e-3), spine(), worm())


@kind(lambda c: repeated_vertices(c.V) > 30 and boundary_edges(c.F) > 60)
def texture_seams(rng):
    return Case(*with_seams(worm(), rng, 6), spine(), worm())


@kind(lambda c: isolated_vertices(c.V, c.F) == 2000)
def many_isolated_vertices(rng):
    return Case(*with_isolated_vertices(worm(), rng, 2000, 1), spine())


@kind(lambda c: isolated_vertices(c.V, c.F) == 3 and np.ptp(c.V) > 1e3 * size(c.V, c.F))
def isolated_vertices_far_away(rng):
    return Case(*with_isolated_vertices(worm(), rng, 3, 1e4), spine())


@kind(lambda c: crowded_edges(c.F) >= 20 and boundary_edges(c.F) >= 40)
def edges_with_three_faces(rng):
    return Case(*with_fins(worm(), rng, 30, both_sides=False), spine(), worm())


@kind(lambda c: bow_ties(c.F) == 1 and pieces(c.F) == 1)
def bow_tie(rng):
    """Two bodies that share one vertex."""
    (V, F), n = worm(), len(worm()[0])
    V2 = np.concatenate([V, shifted((V, F), V[-1, 0] - V[-2, 0], 0, 0)[0]])
    G = F + n
    return Case(
        V2, np.concatenate([F, np.where(n + n - 2 == G, n - 1, G)]), spine(6, 0.1, 1.9), (V2, np.concatenate([F, G]))
    )


@kind(lambda c: crowded_edges(c.F) == 1)
def cubes_that_share_an_edge(rng):
    V, F = box([0, 0, 0], [1, 1, 1])
    both, index = np.unique(joined((V, F), shifted((V, F), 1, 1, 0))[0], axis=0, return_inverse=True)
    return Case(
        both, index.ravel()[np.concatenate([F, F + 8])], chain([[0.2, 0.2, 0.5], [0.8, 0.8, 0.5], [1.8, 1.8, 0.5]])
    )


@kind(lambda c: holes(c.F) == 1 and misoriented_edges(c.F) > 0)
def moebius_strip(rng):
    u, v = (
        a.ravel()
        for a in np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), np.linspace(-0.3, 0.3, 9), indexing="ij")
    )
    r = 1 + v * np.cos(u / 2)
    V = np.stack([r * np.cos(u), r * np.sin(u), v * np.sin(u / 2)], axis=1)
    angle = np.linspace(0, 1.5 * np.pi, 5)
    return Case(
        V, strip(60, 9, closed_rows="mirrored"), chain(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    )


@kind(lambda c: boundary_edges(c.F) == 0 and misoriented_edges(c.F) > 0 and crossings(c.V, c.F) > 0)
def klein_bottle(rng):
    """A figure of eight that turns over once on its way round."""
    u, v = (
        a.ravel()
        for a in np.meshgrid(*(2 * np.pi * (np.arange(n) + s) / n for n, s in ((60, 0), (24, 0.5))), indexing="ij")
    )
    r = 2 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    V = np.stack([r * np.cos(u), r * np.sin(u), np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)], axis=1)
    index = np.arange(60 * 24).reshape(60, 24)
    # After one round v runs backwards.
    F = strip(61, 24, closed_columns=True)
    place = np.concatenate([index.ravel(), index[0, ::-1]])
    angle = np.linspace(0.2, 1.5 * np.pi, 5)
    V += 1e-3 * rng.normal(size=V.shape)
    return Case(V, place[F], chain(np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0.2 + 0 * angle], axis=1)))


@kind(lambda c: size(c.V, c.F) > 3 * size(*c.solid))
def spike(rng):
    return Case(*with_spike(worm(), rng, 3), spine(), worm())


@kind(lambda c: len(c.F) == 4)
def single_tetrahedron(rng):
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    return Case(V, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), chain([[0.1, 0.1, 0.1], [0.5, 0.2, 0.1]]))


@kind(lambda c: len(c.F) == 1)
def single_triangle(rng):
    V = rng.normal(size=(3, 3))
    return Case(V, np.array([[0, 1, 2]]), chain([0.7 * V[0] + 0.3 * V[1], V.mean(axis=0), V[2]]))


@kind(lambda c: len(c.F) == 12 and len(c.skeleton.BE) == 3)
def cube_of_twelve_triangles(rng):
    return Case(*box([0, 0, 0], [1, 1, 1]), chain([[0.1, 0.1, 0.1], [0.5, 0.4, 0.5], [0.6, 0.8, 0.5], [0.9, 0.9, 0.9]]))


@kind(lambda c: size(c.V, c.F) > 900 * np.ptp(c.V[:, 1]))
def very_long_body(rng):
    V, F = worm(radius=0.0005, rings=400, around=8)
    return Case(V, F, spine())


@kind(lambda c: len(c.F) >= 60_000)
def sixty_thousand_faces(rng):
    return Case(*person(180), person_skeleton())


@kind(lambda c: crossings(c.V, c.F) > 100)
def crumpled_surface(rng):
    return Case(*crumpled(worm(), rng, 1.0), spine(), worm())


@kind(lambda c: repeated_vertices(c.V) > 50 and flat_faces(c.V, c.F) > 100)
def rounded_to_a_coarse_grid(rng):
    return Case(*quantised(worm(rings=65, around=24), 32), spine(), worm())


@kind(lambda c: pieces(c.F) == 3 and crossings(c.V, c.F) > 20 and boundary_edges(c.F) > 20)
def two_shells_through_the_body(rng):
    return Case(*with_two_shells(person(), rng), person_skeleton(), person())


@kind(lambda c: pieces(c.F) == 2 and np.ptp(c.V[:, 0]) > 3 and joints_outside(*c.solid, c.skeleton.C) == 0)
def ground_under_the_feet(rng):
    """A person on a large flat square, in one file."""
    s, t = (a.ravel() for a in np.meshgrid(*[np.linspace(-2, 2, 6)] * 2, indexing="ij"))
    return Case(*joined(person(), (np.stack([s, 0 * s, t], axis=1), strip(6, 6))), person_skeleton(), person())


@kind(lambda c: holes(c.F) == 14 and crossings(c.V, c.F) > 200)
def open_parts_stuck_into_each_other(rng):
    """A body built of pieces, every one open at one end."""
    V, F = person_of_parts()
    piece = np.arange(len(F)) // (len(F) // 14)
    lid = np.isin(F, len(V) // 14 * np.arange(1, 15) - 1).any(axis=1)
    assert (np.bincount(piece[lid]) == 14).all()
    return Case(V, F[~lid], person_skeleton(), (V, F))


@kind(lambda c: not len(c.F), outcome="error", error="no triangle|no face")
def no_faces(rng):
    return Case(worm()[0], np.zeros((0, 3), dtype=int), spine())


@kind(lambda c: not len(c.V), outcome="error", error="no vert|no triangle|no face|empty")
def empty_mesh(rng):
    return Case(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), spine())


@kind(lambda c: np.linalg.matrix_rank(c.V - c.V[0], tol=1e-9) == 1, outcome="error", error="line|extent|area")
def all_points_on_a_line(rng):
    V, F = worm()
    return Case(V[:, :1] * [0.3, 0.4, 0.5], F, chain([[0, 0, 0], [0.15, 0.2, 0.25]]))


@kind(lambda c: np.ptp(c.V) == 0, outcome="error", error="extent|one place|same place|area")
def all_points_in_one_place(rng):
    V, F = worm()
    return Case(0 * V + 0.5, F, chain([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5]]))


@kind(lambda c: flat_faces(c.V, c.F) == len(c.F), outcome="error", error="area|extent")
def every_face_without_area(rng):
    V, F = worm()
    return Case(V, F[:, [0, 1, 1]], spine())


@kind(lambda c: np.isnan(c.V).sum() == 1, outcome="error", error="finite")
def not_a_number(rng):
    V, F = worm()
    V[rng.integers(len(V)), 1] = np.nan
    return Case(V, F, spine())


@kind(lambda c: c.F.max() >= len(c.V), outcome="error", error="does not index")
def index_out_of_range(rng):
    V, F = worm()
    return Case(V[:-1], F, spine())
