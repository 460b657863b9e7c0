import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from nilbs.geometry.copyleft import tetrahedra
from nilbs.geometry.copyleft.tetrahedra import conforming_tetrahedra
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.winding import occupancy

CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
CUBE_F = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
     [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)  # fmt: skip
POINTS = np.array([[0.2, 0.5, 0.5], [0.5, 0.5, 0.5], [0.8, 0.6, 0.5], [0.51, 0.5, 0.5]])
NO_POINTS = np.zeros((0, 3))


def turned(F: np.ndarray) -> set[tuple[int, ...]]:
    """Facets with the smallest index first, so that only their direction is left."""
    return {tuple(np.roll(facet, -int(np.argmin(facet))).tolist()) for facet in F}


def test_a_cube_is_filled_and_its_surface_and_the_points_are_kept() -> None:
    V, T = conforming_tetrahedra(CUBE, CUBE_F, POINTS)
    np.testing.assert_array_equal(V[:8], CUBE)
    np.testing.assert_allclose(V[8:12], POINTS, atol=1e-12)
    assert set(range(12)) <= set(T.ravel().tolist())
    volumes = element_volumes(V, T)
    assert volumes.min() > 0
    np.testing.assert_allclose(volumes.sum(), 1)
    assert turned(boundary_facets(T)) == turned(CUBE_F)


@pytest.mark.parametrize(("scale", "shift"), [(2.0**-13, 0.0), (2.0**13, 0.0), (1.0, 1e4)])
def test_neither_unit_nor_place_changes_the_mesh(scale: float, shift: float) -> None:
    _, T = conforming_tetrahedra(CUBE, CUBE_F, POINTS)
    V2, T2 = conforming_tetrahedra(scale * CUBE + shift, CUBE_F, scale * POINTS + shift)
    np.testing.assert_array_equal(V2[:8], scale * CUBE + shift)
    np.testing.assert_allclose(V2[8:12], scale * POINTS + shift, atol=1e-11 * scale)
    np.testing.assert_allclose(element_volumes((V2 - shift) / scale, T2).sum(), 1)
    if shift == 0:  # powers of two round nothing
        np.testing.assert_array_equal(T2, T)


def test_a_ball_is_filled_up_to_its_facets() -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 12)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)
    V2, T = conforming_tetrahedra(V, F, POINTS - 0.5)
    cones = np.concatenate([F[:, ::-1], np.full((len(F), 1), len(V))], axis=1)
    inside = element_volumes(np.concatenate([V, [[0.1, 0.2, 0.3]]]), cones).sum()
    np.testing.assert_allclose(element_volumes(V2, T).sum(), inside)


def test_an_inner_surface_is_kept_and_its_inside_is_filled() -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 12)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)
    whole = element_volumes(*conforming_tetrahedra(V, F, NO_POINTS)).sum()
    V2, T = conforming_tetrahedra(np.concatenate([V, V / 2]), np.concatenate([F, F[:, ::-1] + len(V)]), NO_POINTS)
    volumes = element_volumes(V2, T)
    assert volumes.min() > 0
    np.testing.assert_allclose(volumes.sum(), whole)
    # No tetrahedron lies on both sides of it.
    inner = occupancy(V / 2, F, V2[T].mean(axis=1))
    np.testing.assert_allclose(volumes[inner].sum(), whole / 8)


def test_an_open_surface_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"must be closed and must not cross itself$"):
        conforming_tetrahedra(CUBE, CUBE_F[2:], POINTS)
    assert not list(tmp_path.iterdir())


def test_a_surface_that_crosses_itself_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    V, F = np.concatenate([CUBE, CUBE + np.array([0.5, 0.31, 0.42])]), np.concatenate([CUBE_F, CUBE_F + 8])
    with pytest.raises(ValueError, match=r"^TetGen could not fill the surface with tetrahedra \(.*\): it must"):
        conforming_tetrahedra(V, F, POINTS)
    assert not list(tmp_path.iterdir())


def test_a_surface_in_which_tetgen_finds_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tetrahedra, "_tetgen", lambda V, F, flags: (V, np.zeros((0, 4), dtype=np.int64)))
    with pytest.raises(ValueError, match=r"^TetGen found no volume inside the surface$"):
        conforming_tetrahedra(CUBE, CUBE_F, POINTS)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_crash_is_refused_like_a_bad_surface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "crash.py"
    program.write_text("import os; os.abort()")
    monkeypatch.setattr(tetrahedra, "PROGRAM", program)
    with pytest.raises(ValueError, match=rf"crashed with code -{signal.SIGABRT.value}"):
        conforming_tetrahedra(CUBE, CUBE_F, POINTS)


def test_an_error_of_python_is_reported_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "missing.py"
    program.write_text("import no_such_library")
    monkeypatch.setattr(tetrahedra, "PROGRAM", program)
    with pytest.raises(ChildProcessError, match="No module named 'no_such_library'"):
        conforming_tetrahedra(CUBE, CUBE_F, POINTS)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_ends_both_processes(tmp_path: Path) -> None:
    program, started = tmp_path / "wait.py", tmp_path / "started"
    program.write_text(
        f"import os, pathlib, time; pathlib.Path({str(started)!r}).write_text(str(os.getpid())); time.sleep(60)"
    )
    code = (
        "import pathlib; from nilbs.geometry.copyleft import tetrahedra; "
        f"tetrahedra.PROGRAM = pathlib.Path({str(program)!r}); tetrahedra._tetgen([[0.0] * 3], [[0] * 3], '')"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    while not (started.exists() and started.read_text()):
        assert parent.poll() is None
        time.sleep(0.02)
    parent.send_signal(signal.SIGINT)
    assert "KeyboardInterrupt" in parent.communicate(timeout=30)[1]
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)


def test_several_threads_fill_without_changing_the_process(capfd: pytest.CaptureFixture[str]) -> None:
    folder = Path.cwd()
    V, T = conforming_tetrahedra(CUBE, CUBE_F, POINTS)
    with ThreadPoolExecutor(4) as pool:
        results = [pool.submit(conforming_tetrahedra, CUBE, CUBE_F, POINTS) for _ in range(4)]
        seen = set()
        while not all(result.done() for result in results):
            seen.add(Path.cwd())
            time.sleep(0.01)
    assert seen <= {folder}
    for result in results:
        np.testing.assert_array_equal(result.result()[0], V)
        np.testing.assert_array_equal(result.result()[1], T)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("spacing", [0.1, 0.06])
def test_tetrahedra_inside_are_as_large_as_the_spacing(spacing: float) -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 16)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)
    V2, T = conforming_tetrahedra(V, F, NO_POINTS, spacing=spacing)
    # A regular tetrahedron of edge a has the volume a^3 / sqrt(72).
    largest = (spacing * np.linalg.norm(np.ptp(V, axis=0))) ** 3 / 72**0.5
    inside = (len(V) <= T).all(axis=1)
    assert 0.4 * largest < np.quantile(element_volumes(V2, T[inside]), 0.99) <= largest


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    conforming_tetrahedra(CUBE, CUBE_F, POINTS)
    with pytest.raises(ValueError, match="must be closed"):
        conforming_tetrahedra(CUBE, CUBE_F[2:], POINTS)
    os.write(1, b"out")
    os.write(2, b"err")
    assert capfd.readouterr() == ("out", "err")


def test_nothing_to_fill_is_refused() -> None:
    for V, F in ((np.zeros((0, 3)), np.zeros((0, 3))), (np.ones((4, 3)), [[0, 1, 2]]), (CUBE, np.zeros((0, 3)))):
        with pytest.raises(ValueError, match=r"^the surface has no extent, so there is nothing to fill"):
            conforming_tetrahedra(V, F, POINTS)


def test_sizes_that_disagree_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^V must be \(n, 3\).*got \(4, 2\)$"):
        conforming_tetrahedra(np.zeros((4, 2)), [[0, 1, 2]], POINTS)
    with pytest.raises(ValueError, match=r"^F\[0\] = \[0, 1, 8\] does not index the 8 vertices$"):
        conforming_tetrahedra(CUBE, [[0, 1, 8]], POINTS)
    with pytest.raises(ValueError, match=r"^points must be \(s, 3\).*got \(4, 2\)$"):
        conforming_tetrahedra(CUBE, CUBE_F, POINTS[:, :2])
