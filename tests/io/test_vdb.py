import numpy as np
import pytest

from nilbs.io.vdb import write_vdb

ORIGIN, SPACING = np.array([1.0, 2.0, -3.0]), 0.25


def read(path) -> tuple[dict, dict, np.ndarray, np.ndarray]:
    """Metadata, transform, active places and their values, as tinyvdb reads them.

    Version 0.9 reads 64 leaves of a node at most, of OpenVDB's own files too; test_blender.py reads more, by OpenVDB.
    """
    tinyvdb = pytest.importorskip("tinyvdb")
    file = tinyvdb.open(str(path))
    assert file.grid_count == 1
    file.read_grids()
    grid = file.grid(0)
    assert grid.type_name == "Tree_float_5_4_3"
    found = grid.to_sparse()
    places = np.frombuffer(found["coords"], np.int32).reshape(-1, 3)
    return dict(grid.metadata), dict(grid.transform), places, np.frombuffer(found["values"], np.float32)


def written(path, values, background=0.0, **options) -> None:
    options = {"name": "found", "metadata": {}} | options
    write_vdb(path, values, origin=ORIGIN, spacing=SPACING, background=background, **options)


@pytest.mark.parametrize("shape", [(8, 8, 8), (1, 20, 3), (130, 9, 7)])
def test_values_that_are_not_background_come_back_in_their_places(shape, rng, tmp_path) -> None:
    values = np.where(rng.random(shape) < 0.3, rng.normal(size=shape), 7.0).astype(np.float32)
    written(tmp_path / "a.vdb", values, background=7.0)
    _, _, places, found = read(tmp_path / "a.vdb")
    assert len(np.unique(places, axis=0)) == len(places) == (values != 7).sum()
    np.testing.assert_array_equal(values[tuple(places.T)], found)


def test_a_grid_larger_than_a_node_has_several(tmp_path) -> None:
    values = np.zeros((4200, 9, 9))
    values[4100, 4, 4], values[5, 5, 8] = 3, 2
    written(tmp_path / "a.vdb", values)
    _, _, places, found = read(tmp_path / "a.vdb")
    assert sorted(zip(places.tolist(), found.tolist(), strict=True)) == [([5, 5, 8], 2.0), ([4100, 4, 4], 3.0)]
    assert (tmp_path / "a.vdb").stat().st_size < 30_000


def test_an_empty_grid_holds_nothing(tmp_path) -> None:
    written(tmp_path / "a.vdb", np.zeros((3, 4, 5)))
    assert len(read(tmp_path / "a.vdb")[2]) == 0


@pytest.mark.parametrize("level_set", [False, True])
def test_place_spacing_and_metadata_are_kept(level_set, tmp_path) -> None:
    about = {"frame": 3, "spacing": 0.25, "character": "Würfel"}
    written(tmp_path / "a.vdb", np.ones((3, 3, 3)), metadata=about, level_set=level_set)
    metadata, transform, _, _ = read(tmp_path / "a.vdb")
    assert metadata == about | {"class": "level set" if level_set else "fog volume", "name": "found"}
    np.testing.assert_array_equal(transform["voxel_size"], [SPACING] * 3)
    np.testing.assert_array_equal(transform["translation"], ORIGIN)


def test_the_same_grid_is_the_same_file(tmp_path) -> None:
    for name in ("a.vdb", "b.vdb"):
        written(tmp_path / name, np.eye(4)[None])
    assert (tmp_path / "a.vdb").read_bytes() == (tmp_path / "b.vdb").read_bytes()


def test_a_flat_grid_is_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match=r"values must be \(nx, ny, nz\), got \(3, 3\)"):
        written(tmp_path / "a.vdb", np.eye(3))
    assert not list(tmp_path.iterdir())
