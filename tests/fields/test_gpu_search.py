import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from nilbs.characters.capsule import capsule
from nilbs.characters.motion import random_motion
from nilbs.engine.compiled import announce
from nilbs.engine.lattice import Images
from nilbs.engine.weights import transforms
from nilbs.fields import gpu_kernel
from nilbs.fields.gpu_search import GpuSearch
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.models import torch_field
from nilbs.models.fitting import fit
from nilbs.models.model import Model, load_model

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
TRITON = pytest.mark.skipif(find_spec("triton") is None, reason="triton is not installed: make test-gpu")
CASES = ("flat.few", "flat.folded", "flat.decoys", "solid.many", "solid.folded", "thin.many")


def child(*words: object, **variables: str) -> str:
    script = Path(__file__).parent / "gpu_answers.py"
    done = subprocess.run(
        [sys.executable, script, *map(str, words)], capture_output=True, text=True, env={**os.environ, **variables}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def thin() -> Model:
    character = capsule(bones=3, radius=0.02, resolution=8)
    return fit(character, random_motion(character, frames=3), steps=0, cache_resolution=64, weight_resolution=64)


@pytest.fixture(scope="module")
def exchange(models, thin, tmp_path_factory) -> tuple[dict, dict, dict]:
    """Models, questions, and a GPU's answers."""
    folder, rng = tmp_path_factory.mktemp("gpu"), np.random.default_rng(3)
    asked, questions = {"flat": models[2], "solid": models[3], "thin": thin}, {}
    for name, model in asked.items():
        model.save(folder / f"{name}.nilbs")
        asked[name] = load_model(folder / f"{name}.nilbs")
    for case in CASES:
        model = asked[case.partition(".")[0]]
        c, pose = model.character, model.motion[2]
        if case.endswith("folded"):
            # A half turn of the last bone, so that some blends of transforms are singular.
            theta = np.zeros((1, len(c.skeleton.BE), 1 if c.d == 2 else 3))
            theta[:, -1, 0] = np.pi
            pose = forward_kinematics(c.skeleton.C, c.skeleton.BE, c.skeleton.P, theta)[0]
        U, n = c.skin(pose), {"few": 20, "folded": 15, "decoys": 15, "many": 150}[case.partition(".")[2]]
        cube = Grid.cube(U, 1)
        uniform = rng.uniform(cube.lower, cube.upper, (n, c.d))
        near = U[rng.integers(len(U), size=n)] + rng.normal(size=(n, c.d)) * 0.006 * c.L
        questions |= {f"{case}.x": np.concatenate([uniform, near, 1e4 * uniform[:3] + 1]), f"{case}.pose": pose}
    np.savez(folder / "questions.npz", **questions)
    child(folder, **({} if torch.cuda.is_available() else {"TRITON_INTERPRET": "1"}))
    with np.load(folder / "answers.npz") as answers:
        return asked, questions, dict(answers)


@TRITON
@pytest.mark.parametrize("case", CASES)
def test_a_gpu_answers_as_the_engine(case: str, exchange) -> None:
    models, questions, answers = exchange
    model, x, pose = models[case.partition(".")[0]], questions[f"{case}.x"], questions[f"{case}.pose"]
    frame, L = model.posed(pose).frame, model.character.L
    expected = model.engine()(frame.B)(x, frame.to_unit)
    expected = expected._replace(level=answers.get(f"{case}.expected", expected.level))
    level, x_rest = answers[f"{case}.level"] / L, answers[f"{case}.x_rest"]
    inside = expected.level < 0
    assert 0 < inside.sum() < len(x)
    assert np.isposinf(level[-3:]).all()
    assert not ((level < 0) != inside)[np.abs(expected.level) > 1e-4].any()
    same = np.isclose(level, expected.level, rtol=0, atol=1e-5)
    assert same.mean() > 0.99
    rooted = same & np.isfinite(level)
    np.testing.assert_array_equal(np.isnan(x_rest).all(axis=1), np.isinf(level))
    missed = np.linalg.norm(x_rest - model.character.center - L * expected.x_rest, axis=1)[rooted]
    assert np.quantile(missed, 0.99) < 1e-5 * L


@TRITON
def test_distances_are_completed_by_the_processor(exchange) -> None:
    models, questions, answers = exchange
    x, pose = questions["flat.few.x"], questions["flat.few.pose"]
    np.testing.assert_allclose(
        answers["flat.few.distance"], models["flat"].distance(x, pose), atol=1e-5 * models["flat"].character.L
    )


@TRITON
@DIMENSIONS
def test_lanes_read_whole_records_and_exchange_nothing(d: int) -> None:
    code = child(d)
    assert code.count("ld.global.v4") + code.count("ld.global.L1::evict_first.v4") >= {2: 8, 3: 24}[d]
    assert "ld.shared" not in code


@DIMENSIONS
def test_the_list_of_a_voxel_has_all_cells_whose_boxes_hold_a_point(d: int, models, rng: np.random.Generator) -> None:
    engine, B = models[d].engine(), models[d].posed(models[d].motion[3]).frame.B
    images = Images.of(engine.lattice, transforms(B))
    frame, first, cells, _ = (tensor.numpy() for tensor in GpuSearch(engine, "cpu").voxels(images))
    low, shape = frame[:3], frame[4:].astype(int)
    boxes = images.cell[:, :6].reshape(-1, 2, 3)
    x = rng.uniform(images.low, images.high, (500, 3)).astype(np.float32)
    x = np.concatenate([x, boxes.reshape(-1, 3)])
    number = np.ravel_multi_index(tuple(((x - low) * frame[3]).astype(int).T), shape)
    held = [np.flatnonzero(((boxes[:, 0] <= p) & (p <= boxes[:, 1])).all(axis=1)) for p in x]
    listed = [cells[first[v] : first[v + 1]] for v in number]
    assert all((np.diff(some) > 0).all() for some in listed)
    assert all(set(some) <= set(more) for some, more in zip(held, listed, strict=True))
    assert sum(map(len, listed)) < 4 * sum(map(len, held))
    assert first[0] == 0
    assert first[-1] == len(cells)


@DIMENSIONS
def test_blended_transforms_move_nodes_as_the_engine(d: int, models, rng: np.random.Generator) -> None:
    engine, B = models[d].engine(), models[d].posed(models[d].motion[3]).frame.B
    w, nodes = engine.weights, np.array(engine.weights.cells) + 1
    row = GpuSearch(engine, "cpu").blends(transforms(B)).row.numpy().reshape(-1, nodes.prod(), d, 4)
    assert len(row) == len(w.place)
    block = rng.integers(len(row), size=50)
    node = rng.integers(nodes - 1, size=(50, 3)) * (1, 1, d - 2)
    place = (w.origin + w.spacing * (w.place[block] + node))[:, :d]
    found = row[block, np.ravel_multi_index(tuple(node.T), nodes)]
    moved = np.einsum("nij,nj->ni", found[:, :, :d], place) + found[:, :, 3]
    np.testing.assert_allclose(moved, engine(B).images(place), atol=1e-5)


@pytest.fixture
def on_gpu(models, monkeypatch) -> Model:
    """A model whose tables lie where a kernel would find them."""
    monkeypatch.setattr(torch_field, "gpu_engine", lambda engine, device: GpuSearch(engine, "cpu"))
    m = models[3]
    return Model(m.character, m.motion, m.method, m.history, m.parameters, m.rest).to(device="cuda")


def test_no_points_and_points_that_are_no_numbers(on_gpu: Model) -> None:
    pose = on_gpu.motion[1]
    assert on_gpu.occupancy(np.empty((0, 3)), pose).shape == (0,)
    assert on_gpu.answer(torch.empty(0, 3), torch.as_tensor(pose)).x_rest.shape == (0, 3)
    bad = np.full((2, 3), np.nan)
    with pytest.raises(ValueError, match="x"):
        on_gpu.occupancy(bad, pose)
    with pytest.raises(ValueError, match="x has numbers that are not finite"):
        on_gpu.answer(torch.as_tensor(bad), torch.as_tensor(pose))
    with pytest.raises(ValueError, match=r"x\[0\] = .* is 1e\+06 times the character's size away"):
        on_gpu.answer(torch.full((2, 3), 1e9), torch.as_tensor(pose))


def test_without_triton_the_field_answers_and_a_line_reports_it(models, monkeypatch, capsys) -> None:
    monkeypatch.setattr(gpu_kernel, "PROBLEM", "No module named 'triton'")
    announce.cache_clear()
    assert torch_field.gpu_engine(models[3].engine(), "cuda") is None
    assert "triton cannot be imported (No module named 'triton'): the GPU answers by torch" in capsys.readouterr().err
    assert torch_field.gpu_engine(models[3].engine(), "mps") is None
    assert torch_field.gpu_engine(None, "cuda") is None
    assert not capsys.readouterr().err
