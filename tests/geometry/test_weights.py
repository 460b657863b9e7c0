from collections.abc import Callable
from functools import partial

import clarabel
import igl
import numpy as np
import pytest
from scipy import sparse

from nilbs.geometry.copyleft.tetrahedra import conforming_tetrahedra
from nilbs.geometry.grids import Grid
from nilbs.geometry.handles import bone_conditions, bone_points, distinct_points
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.triangles import conforming_triangles
from nilbs.geometry.weights import (
    biharmonic_energy,
    bounded_biharmonic_weights,
    extend_weights,
    simplex_projection,
)


def bar(d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A bent bar with three bones in a row, filled: V, T, fixed, W_fixed."""
    if d == 2:
        V = np.array([[0, 0], [4, 0], [4, 2.5], [3, 2.5], [3, 1], [0, 1.0]])
        T = np.array([[0, 1, 4], [0, 4, 5], [1, 2, 4], [2, 3, 4]])
        C = np.array([[0.4, 0.5], [2, 0.45], [3.5, 0.6], [3.4, 2.2]])
        x, bone = bone_points(Skeleton(C, BE, [-1, 0, 1], "abc"), spacing=0.4)
        V, T = conforming_triangles(V, T, x, spacing=0.045)
    else:
        V = np.array([[x, y, z] for x in (0, 4) for y in (0, 1) for z in (0, 1)], dtype=float)
        C = np.array([[0.4, 0.5, 0.5], [1.5, 0.4, 0.5], [2.5, 0.5, 0.6], [3.6, 0.5, 0.5]])
        x, bone = bone_points(Skeleton(C, BE, [-1, 0, 1], "abc"), spacing=0.3)
        V, T = conforming_tetrahedra(V, BLOCK, x[distinct_points(x, 1e-6)])
    inside = np.ones(len(x), dtype=bool)
    known = bone_conditions(V, np.unique(T), x, bone, inside, bones=3, snap=1e-6, reach=1)
    return V, T, known.fixed, known.W_fixed


BE = np.array([[0, 1], [1, 2], [2, 3]])
# Triangles of a block; its corners are counted with the last coordinate fastest.
BLOCK = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


Filled = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def filled(V: np.ndarray, F: np.ndarray, C: np.ndarray, BE: np.ndarray, spacing: float) -> Filled:
    """A shape filled around its bones: V, T, fixed, W_fixed."""
    C, BE = np.asarray(C, dtype=float), np.asarray(BE)
    names = [str(bone) for bone in range(len(BE))]
    x, bone = bone_points(Skeleton(C, BE, np.arange(len(BE)) - 1, names), spacing=spacing)
    points = x[distinct_points(x, 1e-6)]
    fill = conforming_tetrahedra if C.shape[1] == 3 else partial(conforming_triangles, spacing=0.03)
    V, T = fill(V, F, points)
    inside = np.ones(len(x), dtype=bool)
    known = bone_conditions(V, np.unique(T), x, bone, inside, bones=len(BE), snap=1e-6, reach=1)
    return V, T, known.fixed, known.W_fixed


def star() -> Filled:
    """A rectangle with five bones from its middle."""
    C = [[1, 0.5], [0.2, 0.2], [0.2, 0.8], [1.8, 0.2], [1.8, 0.8], [1, 0.9]]
    return filled(*RECTANGLE, C, [[0, i] for i in range(1, 6)], 0.05)


def many() -> Filled:
    """A rectangle with twelve bones in a row."""
    x = np.linspace(0.1, 1.9, 13)
    return filled(*RECTANGLE, np.stack([x, 0.5 + 0.1 * np.sin(9 * x)], axis=1), [[i, i + 1] for i in range(12)], 0.03)


RECTANGLE = np.array([[0, 0], [2, 0], [2, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])


def branching() -> Filled:
    """Three limbs around bones that meet in one joint."""
    C = np.array([[0, 0, 0], [0.9, 0.1, 0], [-0.5, 0.7, 0.1], [-0.4, -0.8, 0.0]])
    grid = Grid.box(C, 14, pad=0.2)
    x, distance = grid.points(), np.full(grid.size, np.inf)
    for tip in C[1:]:
        s = np.clip(x @ tip / (tip @ tip), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(x - s[:, None] * tip, axis=1) - 0.22)
    middle = 0.5 * C
    joints, bones = np.concatenate([C, middle[1:]]), [[0, 4], [0, 5], [0, 6], [4, 1], [5, 2], [6, 3]]
    return filled(*isosurface(distance, grid), joints, bones, 0.1)


def sheet() -> Filled:
    """A thin slab with a fork of bones."""
    grid = Grid([-0.15, -0.15, -0.15], 0.1, (24, 14, 5))
    away = np.abs(grid.points() - [1, 0.5, 0.05]) - [1, 0.5, 0.06]
    C = [[0.2, 0.2, 0.05], [1, 0.5, 0.05], [1.8, 0.2, 0.05], [1.8, 0.8, 0.05]]
    return filled(*isosurface(away.max(axis=1), grid), C, [[0, 1], [1, 2], [1, 3]], 0.1)


def crooked() -> Filled:
    """A block of few elements with bones in any direction."""
    rng = np.random.default_rng(3)
    V, F = np.array([[x, y, z] for x in (0, 3) for y in (0, 1) for z in (0, 2)], dtype=float), BLOCK
    return filled(V, F, rng.uniform(0.1, 0.9, (5, 3)) * V[-1], [[i, i + 1] for i in range(4)], 0.3)


SHAPES: dict[str, Callable[[], Filled]] = {
    "bar2": lambda: bar(2),
    "bar3": lambda: bar(3),
    **{shape.__name__: shape for shape in (star, many, branching, sheet, crooked)},
}


def energy_matrix(V: np.ndarray, T: np.ndarray) -> sparse.csc_matrix:
    """L M^-1 L from scratch, element by element; gradients of hat functions come from inverting each element."""
    n, d = V.shape
    L, mass = np.zeros((n, n)), np.zeros(n)
    for element in T:
        rows = np.concatenate([V[element], np.ones((d + 1, 1))], axis=1)
        gradients = np.linalg.inv(rows)[:d]
        volume = abs(np.linalg.det(rows)) / (2 if d == 2 else 6)
        L[np.ix_(element, element)] -= volume * gradients.T @ gradients
        mass[element] += shares(V[element], volume)
    sparse_L = sparse.csc_matrix(L)
    return sparse_L @ sparse.diags(1 / mass) @ sparse_L


def shares(corners: np.ndarray, volume: float) -> np.ndarray | float:
    """The share of each corner in an element: equal in a tetrahedron, the nearest part of a triangle.

    Where a triangle is obtuse that part leaves it; the obtuse corner then takes a half and the others a quarter each
    (Meyer et al., Discrete differential-geometry operators for triangulated 2-manifolds, 2003).
    """
    if len(corners) == 4:
        return volume / 4
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = (edges**2).sum(axis=1)
    dots = -(edges * np.roll(edges, 1, axis=0)).sum(axis=1)
    if dots.min() < 0:
        return volume * np.where(dots < 0, 0.5, 0.25)
    cotangents = dots / (2 * volume)
    # Corner k lies between edges k and k - 1, which lie opposite corners k + 2 and k + 1.
    return (lengths * np.roll(cotangents, -2) + np.roll(lengths, 1) * np.roll(cotangents, -1)) / 8


def optimum(K: sparse.csc_matrix, fixed: np.ndarray, W_fixed: np.ndarray) -> np.ndarray:
    """All bones together by an interior-point method: every row on the simplex, given rows unchanged."""
    n, b = K.shape[0], W_fixed.shape[1]
    size = abs(K).max()
    P = sparse.block_diag([sparse.triu(K / size)] * b, format="csc")
    sums = sparse.hstack([sparse.identity(n)] * b)
    pick = sparse.csc_matrix((np.ones(len(fixed)), (np.arange(len(fixed)), fixed)), shape=(len(fixed), n))
    A = sparse.vstack([sums, sparse.block_diag([pick] * b), -sparse.identity(n * b)], format="csc")
    rhs = np.concatenate([np.ones(n), W_fixed.T.ravel(), np.zeros(n * b)])
    # The sums of given rows would be constrained twice.
    free = np.setdiff1d(np.arange(n), fixed)
    keep = np.concatenate([free, np.arange(n, len(rhs))])
    cones = [clarabel.ZeroConeT(len(free) + fixed.size * b), clarabel.NonnegativeConeT(n * b)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    solution = clarabel.DefaultSolver(P, np.zeros(n * b), A[keep], rhs[keep], cones, settings).solve()
    assert str(solution.status) in ("Solved", "AlmostSolved")
    return np.array(solution.x).reshape(b, n).T


def assert_on_the_simplex(W: np.ndarray) -> None:
    assert W.min() >= 0
    assert W.max() <= 1
    np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_the_joint_optimum_of_an_interior_point_method(shape: Callable[[], Filled]) -> None:
    V, T, fixed, W_fixed = shape()
    K = energy_matrix(V, T)
    best = optimum(K, fixed, W_fixed)
    least = 0.5 * np.trace(best.T @ (K @ best))
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    assert_on_the_simplex(W)
    np.testing.assert_array_equal(W[fixed], W_fixed)
    assert biharmonic_energy(V, T, W) == pytest.approx(least, rel=1e-3)
    assert np.abs(W - best).max() < 0.01
    # The bounds matter here: without them weights leave [0, 1], so the test above can fail.
    free = np.setdiff1d(np.arange(len(V)), fixed)
    unbounded = sparse.linalg.spsolve(K[free][:, free], -K[free][:, fixed] @ W_fixed)
    assert unbounded.min() < -0.01
    # More iterations come closer.
    more = bounded_biharmonic_weights(V, T, fixed, W_fixed, iterations=100)
    assert np.abs(more - best).max() < 0.005


@pytest.mark.parametrize("d", [2, 3])
def test_no_worse_than_one_bone_at_a_time_clipped(d: int) -> None:
    V, T, fixed, W_fixed = bar(d)
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    reference = bounded_biharmonic_weights(V, T, fixed, W_fixed, method="igl")
    assert_on_the_simplex(reference)
    clipped = np.clip(igl.bbw(V, T, fixed, W_fixed, max_iter=50), 0, 1)
    np.testing.assert_allclose(reference, clipped / clipped.sum(axis=1, keepdims=True), atol=1e-12)
    assert biharmonic_energy(V, T, W) <= biharmonic_energy(V, T, reference)
    # Nearly the same problem: the two differ, but little on the mean.
    assert 1e-4 < np.abs(W - reference).mean() < 0.05


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 100.0)])
def test_neither_unit_nor_place_changes_the_weights(d: int, scale: float, shift: float) -> None:
    V, T, fixed, W_fixed = bar(d)
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    moved = bounded_biharmonic_weights(scale * V + shift, T, fixed, W_fixed)
    np.testing.assert_allclose(moved, W, atol=1e-6)
    np.testing.assert_allclose(
        biharmonic_energy(scale * V + shift, T, W), scale ** (d - 4) * biharmonic_energy(V, T, W), rtol=1e-6
    )


@pytest.mark.parametrize("d", [2, 3])
def test_bones_in_another_order_give_the_columns_in_that_order(d: int) -> None:
    V, T, fixed, W_fixed = bar(d)
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    order = [2, 0, 1]
    np.testing.assert_allclose(bounded_biharmonic_weights(V, T, fixed, W_fixed[:, order]), W[:, order], atol=1e-9)


def test_weights_between_two_ends_fall_all_the_way() -> None:
    # Both ends of a strip are fixed two rows deep, so value and slope are given: the weights fall from one to zero
    # between them, symmetrically.
    x, y = np.meshgrid(np.arange(13.0), np.arange(3.0), indexing="ij")
    V = np.stack([x.ravel(), y.ravel()], axis=1)
    corner = np.array([3 * i + j for i in range(12) for j in (0, 1)])[:, None]
    T = np.concatenate([corner + np.array([0, 3, 4]), corner + np.array([0, 4, 1])])
    fixed = np.concatenate([np.flatnonzero(V[:, 0] <= 1), np.flatnonzero(V[:, 0] >= 11)])
    W_fixed = np.eye(2)[(V[fixed, 0] > 6).astype(int)]
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed, iterations=100)
    np.testing.assert_allclose(W, W[::-1, ::-1], atol=1e-3)
    middle = W[1::3, 0]
    assert (np.diff(middle) <= 1e-6).all()
    assert middle[6] == pytest.approx(0.5, abs=1e-3)


def test_energy_of_a_loop_over_elements() -> None:
    for d in (2, 3):
        V, T, *_ = bar(d)
        W = np.random.default_rng(0).uniform(size=(len(V), 2))
        K = energy_matrix(V, T)
        assert biharmonic_energy(V, T, W) == pytest.approx(0.5 * np.trace(W.T @ (K @ W)), rel=1e-9)
        # A constant has none.
        assert biharmonic_energy(V, T, np.ones((len(V), 1))) == pytest.approx(0, abs=1e-9)


def test_one_bone_and_a_mesh_that_is_all_fixed_need_no_solver() -> None:
    V, T, fixed, _ = bar(2)
    np.testing.assert_array_equal(bounded_biharmonic_weights(V, T, fixed, np.ones((len(fixed), 1))), 1)
    known = np.random.default_rng(0).dirichlet(np.ones(3), len(V))
    np.testing.assert_array_equal(bounded_biharmonic_weights(V, T, np.arange(len(V)), known), known)


@pytest.mark.parametrize("method", ["joint", "igl"])
def test_vertices_without_elements_follow_the_nearest_unless_they_are_fixed(method: str) -> None:
    V, T, fixed, W_fixed = bar(2)
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed, method=method)
    # First, so that every index changes; the second has the place of a fixed vertex and other weights.
    more = np.concatenate([V[[5]] + 1e-3, V[fixed[[0]]], V])
    again = bounded_biharmonic_weights(
        more, T + 2, np.concatenate([[1], fixed + 2]), np.concatenate([[[0.2, 0.3, 0.5]], W_fixed]), method=method
    )
    np.testing.assert_allclose(again[2:], W, atol=1e-9)
    np.testing.assert_array_equal(again[0], again[7])
    np.testing.assert_array_equal(again[1], [0.2, 0.3, 0.5])
    # Only elements have energy.
    assert biharmonic_energy(more, T + 2, again) == pytest.approx(biharmonic_energy(V, T, W), rel=1e-6)


def test_progress_goes_to_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    V, T, fixed, W_fixed = bar(2)
    bounded_biharmonic_weights(V, T, fixed, W_fixed, iterations=1, progress=True)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T": [[0, 1, 6]]}, r"^T\[0\] = \[0, 1, 6\] does not index the 6 vertices$"),
        ({"fixed": [0, 6]}, r"^fixed\[1\] = 6 does not index the 6 vertices$"),
        ({"fixed": [2, 2]}, "^fixed names a vertex twice$"),
        ({"W_fixed": [[1.1, -0.1], [0, 1]]}, "^rows of W_fixed must be non-negative and sum to one$"),
        ({"W_fixed": [[0.5, 0.4], [0, 1]]}, "^rows of W_fixed must be non-negative and sum to one$"),
        ({"W_fixed": [[1, 0]]}, r"^W_fixed must be \(f, b\) = \(2, b\), got \(1, 2\)$"),
        ({"fixed": [0, 5]}, "^bone 1 is held only by vertices that belong to no element$"),
        ({"T": [[0, 1, 2], [3, 4, 5]], "fixed": [0, 1]}, r"^1 of the mesh's 2 separate parts \(one holds vertex 3\)"),
        ({"fixed": np.zeros(0), "W_fixed": np.zeros((0, 2))}, "touch no bone, so their weights are undetermined"),
        ({"V": np.array([[0, 0], [1, 0], [2, 0], [0, 9], [1, 9], [2, 8.0]])}, "touches only elements without volume$"),
        ({"method": "best"}, "^method must be 'joint' or 'igl', got 'best'$"),
    ],
)
def test_wrong_arguments_are_refused(changes: dict, message: str) -> None:
    V = np.array([[0, 0], [1, 0], [0, 1], [3, 3], [4, 3], [3, 4.0]])
    given = {"V": V, "T": [[0, 1, 2]], "fixed": [0, 1], "W_fixed": [[1, 0], [0, 1]]} | changes
    with pytest.raises(ValueError, match=message):
        bounded_biharmonic_weights(**given)


@pytest.mark.parametrize("d", [2, 3])
def test_few_vertices_first_and_single_precision_find_nearly_the_same(d: int, monkeypatch: pytest.MonkeyPatch) -> None:
    V, T, fixed, W_fixed = bar(d)
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    for name, value in {"SMALL": 0, "FEW": 60, "DOUBLE": 0}.items():
        monkeypatch.setattr(f"nilbs.geometry.weights.{name}", value)
    again = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    assert_on_the_simplex(again)
    assert biharmonic_energy(V, T, again) == pytest.approx(biharmonic_energy(V, T, W), rel=1e-3)
    assert 0 < np.abs(again - W).mean() < 0.003


def test_a_projection_that_rounding_could_repeat_for_ever_ends(rng: np.random.Generator) -> None:
    # Entries at exactly the amount that is subtracted.
    W = rng.dirichlet(np.ones(3), 20000)
    W = np.concatenate([W, np.zeros((len(W), 5))], axis=1) - rng.uniform(size=(len(W), 1))
    assert_on_the_simplex(simplex_projection(W))


def test_the_nearest_point_of_a_simplex(rng: np.random.Generator) -> None:
    W = 2 * rng.normal(size=(200, 4))
    projected = simplex_projection(W)
    assert_on_the_simplex(projected)
    # Nearest, because every corner of the simplex, hence all of it, lies on the far side.
    for corner in np.eye(4):
        assert (((W - projected) * (corner - projected)).sum(axis=1) < 1e-12).all()
    np.testing.assert_allclose(simplex_projection(projected), projected, atol=1e-15)
    np.testing.assert_allclose(simplex_projection(W + 5), projected, atol=1e-14)
    np.testing.assert_array_equal(simplex_projection([[1e9, 0, 0]]), [[1, 0, 0]])
    assert simplex_projection(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("d", [2, 3])
def test_a_linear_function_is_its_own_harmonic_extension(d: int) -> None:
    V, T, *_ = bar(d)
    # Only the outline is given: a linear function there is linear inside.
    outer = np.array([*range(6)] if d == 2 else [*range(8)])
    boundary = np.setdiff1d(igl.boundary_facets(T)[0].ravel(), outer)
    order = np.concatenate([outer, boundary, np.setdiff1d(np.arange(len(V)), np.concatenate([outer, boundary]))])
    place = np.argsort(order)
    V, T = V[order], place[T]
    n = len(outer) + len(boundary)
    linear = V[:, 0] / 4
    W = np.stack([linear, 1 - linear], axis=1)
    extended = extend_weights(V, T, W[:n])
    np.testing.assert_array_equal(extended[:n], W[:n])
    np.testing.assert_allclose(extended, W, atol=1e-10)


def test_an_extension_stays_on_the_simplex_and_reaches_loose_vertices(rng: np.random.Generator) -> None:
    V, T, *_ = bar(2)
    loose = np.concatenate([V, V[[9]] + 1e-6])
    W = extend_weights(loose, T, rng.dirichlet(np.ones(3), 6))
    assert_on_the_simplex(W)
    np.testing.assert_array_equal(W[-1], W[9])


def test_an_extension_over_obtuse_triangles_stays_on_the_simplex() -> None:
    V, T = [[-10, 0], [0, -1], [10, 0], [0, 1], [5, 0]], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    known = np.array([[1, 0], [0, 1], [0, 1], [0, 1.0]])
    assert igl.harmonic(np.array(V, dtype=float), np.array(T), np.arange(4), known, 1)[4, 0] < -0.01
    np.testing.assert_array_equal(extend_weights(V, T, known)[4], [0, 1])


def test_an_extension_without_elements_or_with_too_many_rows() -> None:
    V = np.array([[0, 0], [1, 0], [0, 1.0]])
    W = extend_weights(V, np.zeros((0, 3)), [[1, 0], [0, 1], [0.5, 0.5]])
    np.testing.assert_array_equal(W, [[1, 0], [0, 1], [0.5, 0.5]])
    with pytest.raises(ValueError, match=r"^W_known has 4 rows, more than the 3 vertices$"):
        extend_weights(V, [[0, 1, 2]], np.ones((4, 1)))
    with pytest.raises(ValueError, match=r"^T\[0\] = \[0, 1, 3\] does not index the 3 vertices$"):
        extend_weights(V, [[0, 1, 3]], np.ones((1, 1)))
    with pytest.raises(ValueError, match=r"^T\[0\] = \[0, 1, 3\] does not index the 3 vertices$"):
        biharmonic_energy(V, [[0, 1, 3]], np.ones((3, 1)))
