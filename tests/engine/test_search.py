import numpy as np
import pytest

from nilbs.engine import winding
from nilbs.engine.blocks import near
from nilbs.engine.compiled import set_threads
from nilbs.engine.lattice import Lattice
from nilbs.engine.search import SearchEngine
from nilbs.engine.sorted_points import BEYOND, SortedPoints
from nilbs.geometry.grids import Grid

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


@pytest.fixture
def case(models, queries):
    def made(d: int, n: int):
        x, B = queries(models[d], n)
        return models[d].engine(), models[d].posed(B).frame, x

    return made


@DIMENSIONS
def test_an_answer_depends_on_its_point_and_pose_alone(d: int, case, rng: np.random.Generator) -> None:
    engine, frame, x = case(d, 5000)
    posed, order = engine(frame.B), rng.permutation(len(x))
    whole = posed(x, frame.to_unit)
    assert 0 < (whole.level < 0).sum() < len(x)
    try:
        for count in (1, 2, 3):
            set_threads(count)
            shuffled = posed(x[order], frame.to_unit)
            np.testing.assert_array_equal(shuffled.level, whole.level[order])
            np.testing.assert_array_equal(shuffled.x_rest, whole.x_rest[order])
    finally:
        set_threads(None)
    for size in (1, 7, 300):
        parts = [posed(part, frame.to_unit) for part in np.split(x[:600], range(size, 600, size))]
        np.testing.assert_array_equal(np.concatenate([part.level for part in parts]), whole.level[:600])


@DIMENSIONS
def test_a_root_is_mapped_to_its_point(d: int, case) -> None:
    engine, frame, x = case(d, 2000)
    posed = engine(frame.B)
    x_rest = posed(x, frame.to_unit).x_rest
    rooted = np.isfinite(x_rest[:, 0])
    missed = np.linalg.norm(posed.images(x_rest[rooted]) - frame.points(x[rooted]), axis=1)
    assert rooted.sum() > 300
    assert np.quantile(missed, 0.99) < 1e-5
    assert missed.max() < 1e-3


def test_without_cells_near_the_body_all_is_outside(case) -> None:
    engine, frame, x = case(3, 50)
    none = Lattice(*(array[:0] for array in engine.lattice))
    answer = SearchEngine(engine.weights, engine.distances, none, 3, engine.width)(frame.B)(x, frame.to_unit)
    assert np.isposinf(answer.level).all()
    assert np.isnan(answer.x_rest).all()


@pytest.mark.parametrize("n", [0, 1, 40, 3000])
@pytest.mark.parametrize("flat", [False, True])
def test_points_are_sorted_by_cells(n: int, flat: bool, rng: np.random.Generator) -> None:
    x = rng.uniform(-1, 1, (n, 3)) * (1, 1, 0 if flat else 1)
    low, high = np.array([-0.5, -0.9, -0.4], dtype=np.float32), np.array([0.7, 0.8, 0.4], dtype=np.float32)
    points = SortedPoints.of(x, np.eye(3, 4), low, high)
    assert len(points.x) == n + BEYOND
    there = np.flatnonzero(((x > low) & (x < high)).all(axis=1))
    assert set(there) <= set(points.number.tolist())
    place = np.stack([points.x, points.y, points.z], axis=1)[: len(points.number)]
    np.testing.assert_allclose(place, x[points.number], atol=1e-7)
    cell = ((place - low) * points.scale).astype(int)
    flat_cell = np.ravel_multi_index(tuple(cell.T), points.shape)
    assert (np.diff(flat_cell) >= 0).all()
    np.testing.assert_array_equal(np.bincount(flat_cell, minlength=len(points.first) - 1), np.diff(points.first))


def test_a_surface_of_long_triangles_is_counted_otherwise(monkeypatch) -> None:
    V, F = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    x = np.array([[0.2, 0.2, 0.2], [0.9, 0.9, 0.9]])
    counted = winding.winding_number(V, F, x)
    monkeypatch.setattr(winding, "MOST", 0)
    asked = []
    monkeypatch.setattr(winding, "generalized", lambda V, F, x: asked.append(len(x)) or counted)
    np.testing.assert_array_equal(winding.winding_number(V, F, x), counted)
    assert asked == [2]


def test_blocks_near_a_facet_without_area_are_those_near_its_longest_edge() -> None:
    U = np.array([[0.1, 0.2, 0.1], [0.9, 0.6, 0.4], [0.5, 0.4, 0.25]])
    grid = Grid.box(np.array([[0.0] * 3, [1.0] * 3]), 40)
    found = near(U, np.array([[0, 2, 1]]), grid, 0.05)
    center = grid.origin + grid.spacing * found  # the first node of the grid is that of the layer around it but one
    along = U[1] - U[0]
    t = np.clip((center - U[0]) @ along / (along @ along), 0, 1)[:, None]
    away = np.linalg.norm(center - U[0] - t * along, axis=1)
    reached = {tuple(c) for c in found.tolist()}
    everywhere = 2 * np.argwhere(np.ones((22, 22, 22)))
    places = grid.origin + grid.spacing * everywhere
    t = np.clip((places - U[0]) @ along / (along @ along), 0, 1)[:, None]
    close = np.linalg.norm(places - U[0] - t * along, axis=1) < 0.05
    assert {tuple(c) for c in everywhere[close].tolist()} <= reached
    assert away.max() < 3 * 0.05
