from itertools import groupby

import pytest

from nilbs.race.plan import LARGE, TRIANGLES, Cell, levels, quick, whole


def test_levels_end_at_the_largest_mesh():
    assert levels(12_064, most=TRIANGLES) == [0, 1, 2, 3]
    assert levels(12_064, most=LARGE) == [0, 1, 2, 3, 4]
    assert levels(10**7, most=TRIANGLES) == [0]


def test_the_quick_run_has_its_four_lines():
    cells = quick([0, 1, 2, 3], threads=2)
    lines = {(c.quantity, c.kind, c.points, c.level) for c in cells if c.poses == 1}
    assert lines == {
        *(("occupancy", kind, 10**5, level) for kind in ("near", "uniform") for level in (0, 3)),
        *(("distance", "near", 10**5, level) for level in (0, 3)),
    }
    (stream,) = (c for c in cells if c.poses > 1)
    assert (stream.points, stream.poses * stream.repeats) == (1000, 1000)


def test_one_mesh_is_measured_once():
    assert len(quick([0], threads=2)) == 4


@pytest.mark.parametrize("full", [False, True])
def test_the_finest_mesh_is_measured_at_two_sizes_unless_all_are_wanted(full):
    finest = [c for c in whole([0, 1, 2, 3], threads=2, full=full) if c.level == 3 and c.poses == 1]
    sizes = {(c.points, c.threads) for c in finest}
    assert sizes == ({(10**k, t) for k in range(2, 8) for t in (1, 2)} if full else {(10**3, 2), (10**5, 2)})


def test_every_cell_is_there_once_and_processes_are_few():
    cells = whole([0, 1], threads=2)
    assert len(set(cells)) == len(cells)
    assert {c.points for c in cells} == {10**k for k in range(2, 8)}
    runs = [key for key, _ in groupby(cells, key=lambda c: (c.points > 10**5, c.threads, c.level))]
    assert len(runs) == len(set(runs))
    assert [large for large, _, _ in runs] == sorted(large for large, _, _ in runs)


def test_one_core_is_not_measured_twice():
    cells = whole([0], threads=1)
    assert len(set(cells)) == len(cells)


def test_cost_grows_with_everything():
    cell = Cell("occupancy", 0, 1000, "near", 2)
    for other in (
        Cell("distance", 0, 1000, "near", 2),
        Cell("occupancy", 1, 1000, "near", 2),
        Cell("occupancy", 0, 10_000, "near", 2),
        Cell("occupancy", 0, 1000, "near", 2, poses=2),
    ):
        assert other.cost(500) > cell.cost(500)
