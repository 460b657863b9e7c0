from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nilbs.io.archive import read_archive, write_archive
from nilbs.io.errors import FileFormatError
from nilbs.models.model import load_model
from nilbs.models.model_file import KIND, KIND_5

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
VERSION_5 = Path(__file__).parent / "version_5"
ANSWERS = ("occupancy", "distance", "weights")


def cut(contents: dict, name: str, end: int = 1) -> None:
    contents[f"field.{name}"] = contents[f"field.{name}"][:end]


def added(contents: dict, name: str, number: int) -> None:
    contents[f"field.{name}"] = contents[f"field.{name}"] + np.int32(number)


def put(contents: dict, name: str, place, value) -> None:
    contents[f"field.{name}"][place] = value


def stored(contents: dict, name: str, kind: type) -> None:
    contents[f"field.{name}"] = contents[f"field.{name}"].astype(kind)


@DIMENSIONS
def test_a_saved_model_is_loaded(d: int, models, saved, queries) -> None:
    model, again = models[d], load_model(saved[d])
    arrays = again.character.arrays()
    assert arrays.keys() == model.character.arrays().keys()
    for name, array in model.character.arrays().items():
        np.testing.assert_array_equal(arrays[name], array)
    assert again.character.name == model.character.name
    assert again.character.skeleton.names == model.character.skeleton.names
    np.testing.assert_array_equal(again.motion.B, model.motion.B)
    np.testing.assert_array_equal(again.motion.frames, model.motion.frames)
    np.testing.assert_array_equal(again.history, model.history)
    assert again.config == model.config
    assert again.config["motion"] == "random, amplitude 0.4 rad rms, 6 frames, seed 0"
    assert again.config["frames"] == 6
    x, pose = queries(model, 200)
    for answer in ANSWERS:
        np.testing.assert_array_equal(getattr(again, answer)(x, pose), getattr(model, answer)(x, pose))


def test_double_precision_survives_a_file(saved, tmp_path: Path, queries) -> None:
    model = load_model(saved[2]).to(dtype=torch.float64)
    with torch.no_grad():
        model.field.inverse.network.layers[0].bias += 1e-12
    model.save(tmp_path / "double.nilbs")
    again = load_model(tmp_path / "double.nilbs")
    x, pose = queries(model, 50)
    np.testing.assert_array_equal(again.occupancy(x, pose), model.occupancy(x, pose))
    assert again.occupancy(x, pose).dtype == np.float64


@DIMENSIONS
def test_a_network_without_numbers_is_refused(d: int, saved, tmp_path: Path) -> None:
    contents, text = read_archive(saved[d], kind=KIND)
    name = "field.inverse.network.layers.0.bias"
    contents[name] = np.full_like(contents[name], np.nan)
    write_archive(tmp_path / "nan.nilbs", contents, text, kind=KIND)
    with pytest.raises(FileFormatError, match=rf"nan\.nilbs: .*{name} has numbers that are not finite$"):
        load_model(tmp_path / "nan.nilbs")


def test_any_flipped_byte_is_noticed(saved, tmp_path: Path, rng: np.random.Generator) -> None:
    data = saved[3].read_bytes()
    path = tmp_path / "damaged.nilbs"
    places = np.concatenate([np.arange(16), rng.integers(0, len(data), 200)])
    for place in [*places.tolist(), len(data) - 1]:
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError):
            load_model(path)


def test_any_truncation_and_any_addition_is_noticed(saved, tmp_path: Path, rng: np.random.Generator) -> None:
    data = saved[3].read_bytes()
    path = tmp_path / "cut.nilbs"
    for length in [0, 1, 7, 8, 9, len(data) - 1, *rng.integers(0, len(data), 30).tolist()]:
        path.write_bytes(data[:length])
        with pytest.raises(FileFormatError):
            load_model(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(FileFormatError):
        load_model(path)


def test_another_version_is_named(saved, tmp_path: Path) -> None:
    contents, text = read_archive(saved[2], kind=KIND)
    write_archive(tmp_path / "old.nilbs", contents, text, kind="nilbs model 0")
    with pytest.raises(FileFormatError, match=r"is 'nilbs model 0', not 'nilbs model 7', which this version of nilbs"):
        load_model(tmp_path / "old.nilbs")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c, t: c.pop("character.V"), "V"),
        (lambda c, t: c.pop("motion.frames"), "motion.frames"),
        (lambda c, t: c.pop("field.inverse.network.layers.1.weight"), "layers.1.weight"),
        (lambda c, t: c.update({"character.W": c["character.W"][:-1]}), r"W must be"),
        (lambda c, t: c.update({"character.F": c["character.F"] + 10**6}), "F\\[0\\] = .* does not index"),
        (
            lambda c, t: c.update({"character.P": np.full_like(c["character.P"], 99)}),
            "does not index",
        ),
        (lambda c, t: c.update({"character.colour": c["character.V"]}), "colour"),
        (lambda c, t: c.update({"motion.B": c["motion.B"][:, :1]}), "the motion has shape"),
        (lambda c, t: cut(c, "rest.distance.values"), r"nodes and the bricks \d+ cells, not 1 and"),
        (lambda c, t: cut(c, "rest.distance.brick", 0), "the grid of rest distances has shape"),
        (lambda c, t: added(c, "rest.distance.brick", 1), "the grid and its bricks have"),
        (lambda c, t: added(c, "rest.distance.finer", -1), "a brick of the rest distances has a number below -1"),
        (lambda c, t: cut(c, "rest.distance.finer", -1), "the grid and its bricks have"),
        (lambda c, t: c.pop("field.rest.distance.finer"), "finer"),
        (lambda c, t: c.update({"field.rest.distance.origin": np.zeros(7)}), "origin must be"),
        (lambda c, t: c.update({"history": np.zeros((2, 2))}), "history must be"),
        (
            lambda c, t: c.update({"character.BE": c["character.BE"].astype(float)}),
            "must be stored as integers",
        ),
        (lambda c, t: c.update({"character.V": 0 * c["character.V"]}), "all vertices lie in one place"),
        (lambda c, t: t.pop("spacing"), "spacing"),
        (lambda c, t: t["spacing"].pop("distance"), "distance"),
        (lambda c, t: t["spacing"].update({"weights": "wide"}), "cells of grids must have an edge"),
        (lambda c, t: t["spacing"].update({"weights": "0.1"}), "cells of grids must have an edge"),
        (lambda c, t: t["spacing"].update({"distance": 10**400}), "too large"),
        (lambda c, t: t["spacing"].update({"distance": 0}), "cells of grids must have an edge"),
        (lambda c, t: t["spacing"].update({"distance": 1e-30}), "cells of grids must have an edge"),
        (lambda c, t: t["spacing"].update({"weights": -1}), "cells of grids must have an edge"),
        (lambda c, t: t["spacing"].update({"weights": 1e7}), "cells of grids must have an edge"),
        (lambda c, t: t.update(spacing=None), "not subscriptable"),
        (lambda c, t: t.pop("parts"), "parts"),
        (lambda c, t: t.update(parts=[4]), r"unit must be \(2,\), got"),
        (lambda c, t: t.update(parts=[2, 2, 2]), "the grid and its bricks have"),
        (lambda c, t: t.update(parts=[4, 2, 1]), "cells must be divided at most 8 times in 2 to"),
        (lambda c, t: t.update(parts=[4, 2, 2.0]), "cells must be divided at most 8 times in 2 to"),
        (lambda c, t: t.update(parts=[4, 10**9]), "cells must be divided at most 8 times in 2 to"),
        (lambda c, t: t.update(parts="42"), "cells must be divided at most 8 times in 2 to"),
        (lambda c, t: t.update(parts=[2] * 9), "cells must be divided at most 8 times in 2 to"),
        (lambda c, t: put(c, "rest.distance.unit", 0, 0), "units of rest distances must lie between"),
        (lambda c, t: put(c, "rest.distance.unit", 1, -1), "units of rest distances must lie between"),
        (lambda c, t: put(c, "rest.distance.unit", 1, 1e30), "units of rest distances must lie between"),
        (lambda c, t: put(c, "rest.distance.brick", 0, 2**30), "the grid and its bricks have"),
        (lambda c, t: put(c, "rest.distance.finer", 5, 2**30), "the grid and its bricks have"),
        (lambda c, t: stored(c, "rest.distance.values", np.float32), "values must be stored as int16, not as float32"),
        (lambda c, t: stored(c, "rest.distance.brick", np.int64), "brick must be stored as int32, not as int64"),
        (lambda c, t: c.update({"field.rest.distance.extra": np.zeros(3)}), "rest.distance.extra is no array"),
        (lambda c, t: put(c, "rest.distance.origin", 0, 1e300), "the grid of rest distance begins very far away"),
        (lambda c, t: put(c, "rest.weights.origin", 1, -1e6), "the grid of rest weights begins very far away"),
        (lambda c, t: put(c, "rest.weights.place", (0, 0), 10**6), "a block of rest weights lies outside the grid"),
        (lambda c, t: put(c, "rest.weights.place", (0, 0), 2**30), "a block of rest weights lies outside the grid"),
        (lambda c, t: put(c, "rest.weights.place", (0, 1), -1), "a block of rest weights lies outside the grid"),
        (
            lambda c, t: put(c, "rest.weights.place", 0, c["field.rest.weights.place"][1]),
            "two blocks of rest weights lie at the same place",
        ),
        (lambda c, t: cut(c, "rest.weights.place", 0), "the blocks of rest weights have places"),
        (lambda c, t: added(c, "rest.weights.bone", 99), "a bone of the rest weights does not exist"),
        (lambda c, t: put(c, "rest.weights.bone", 0, -1), "a bone of the rest weights does not exist"),
        (lambda c, t: c.update({"field.rest.weights.first": -c["field.rest.weights.first"]}), "do not follow"),
        (lambda c, t: put(c, "rest.weights.first", 1, 10**12), "do not follow"),
        (lambda c, t: put(c, "rest.weights.first", -1, 10**12), "do not follow"),
        (lambda c, t: cut(c, "rest.weights.first", -1), "the blocks of rest weights have places"),
        (lambda c, t: cut(c, "rest.weights.weight", -1), "rest weights must be"),
        (lambda c, t: put(c, "rest.weights.weight", 0, 30_000), "the rest weights of a node do not sum to one"),
        (lambda c, t: put(c, "rest.weights.shape", 0, 1), "the grid of rest weights has shape"),
        (lambda c, t: put(c, "rest.weights.shape", 0, 5), "a block of rest weights lies outside the grid"),
        (lambda c, t: put(c, "rest.weights.shape", 0, 2**30), "the grid of rest weights has shape"),
        (lambda c, t: c["field.rest.weights.shape"].fill(2**19), "the grid of rest weights has shape"),
        (lambda c, t: c.update({"field.rest.weights.shape": c["history"]}), "shape must be stored as int32"),
        (lambda c, t: c.update({"field.rest.weights.bone": c["history"]}), "bone must be stored as int32"),
        (
            lambda c, t: c.update({"field.rest.weights.bone": c["field.rest.weights.bone"][:, None]}),
            "the bones of blocks of rest weights do not follow",
        ),
        (lambda c, t: t.update(bones=["a"]), "names must be"),
        (lambda c, t: t["settings"].update(steps="many"), "steps must be of type int"),
        (lambda c, t: t.update(method="magic"), "no method 'magic'"),
        (lambda c, t: t["settings"].pop("steps"), "settings are"),
        (lambda c, t: t["settings"].update(width=4000), "no layer is as wide as its settings, 4000"),
        (lambda c, t: t["settings"].update(depth=4000), "there are fewer layers than in its settings"),
        (
            lambda c, t: (
                t["settings"].update(width=4096, depth=50),
                c.update({f"field.{k}": np.zeros((0, 4096)) for k in range(50)}),
            ),
            "it holds less than 50 layers of width 4096",
        ),
        (lambda c, t: t["settings"].update(width=15), r"layers.0.bias must be \(15,\)"),
        (lambda c, t: t["settings"].update(depth=2), "layers.1.bias must be"),
        (lambda c, t: t["settings"].update(encoding="parameters"), "encoding.centers are no parameters"),
        (lambda c, t: t["settings"].update(ghost=False), r"layers.2.bias must be \(13,\)"),
        (lambda c, t: t["settings"].update(forward_map="network"), "forward_network.layers.0.bias are missing"),
        (lambda c, t: t["settings"].update(steps=0), "encoding.centers are no parameters"),
        (lambda c, t: c.update({"field.inverse.more": np.zeros(3)}), "inverse.more are no parameters"),
        (
            lambda c, t: stored(c, "inverse.network.layers.0.bias", np.int64),
            r"layers.0.bias must be \(16,\) floating-point numbers, got int64 \(16,\)",
        ),
        (
            lambda c, t: c.update({"field.rest.distance.origin": np.zeros(2, dtype=bool)}),
            "rest.distance.origin must be stored as float64, not as bool",
        ),
    ],
)
def test_an_archive_without_a_complete_model_is_refused(change, message: str, saved, tmp_path: Path) -> None:
    contents, text = read_archive(saved[2], kind=KIND)
    change(contents, text)
    write_archive(tmp_path / "odd.nilbs", contents, text, kind=KIND)
    with pytest.raises(FileFormatError, match=rf"odd\.nilbs: is not a complete nilbs model: .*{message}") as caught:
        load_model(tmp_path / "odd.nilbs")
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_written_keeps_its_old_content(models, saved, tmp_path: Path, monkeypatch) -> None:
    before = saved[2].read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        models[3].save(saved[2])
    assert saved[2].read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2.nilbs", "3.nilbs"]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("nasa", lambda c: c.pop("field.biases.0"), "biases.0"),
        ("nasa", lambda c: c.update({"field.more": np.zeros(3)}), "more"),
        ("nasa", lambda c: put_parameters(c, "last_weight", (2, 1, 7)), r"last_weight.*\[2, 1, 7\]"),
        ("nasa", lambda c: c.update({"field.rest.distance.unit": np.ones(4)}), "the method nasa has no grids"),
        ("nearest", lambda c: c.update({"field.bias": np.zeros(3)}), "the method nearest has no parameters"),
        ("nearest", lambda c: c.update({"field.rest.distance.unit": np.ones(4)}), "the method nearest has no grids"),
    ],
)
def test_parameters_of_another_field_are_refused(name: str, change, message: str, tmp_path: Path) -> None:
    contents, text = read_archive(VERSION_5 / f"{name}.nilbs", kind=KIND_5)
    change(contents)
    write_archive(tmp_path / "odd.nilbs", contents, text, kind=KIND_5)
    with pytest.raises(FileFormatError, match=rf"odd\.nilbs: is not a complete nilbs model: .*{message}") as caught:
        load_model(tmp_path / "odd.nilbs")
    assert "\n" not in str(caught.value)


def put_parameters(contents: dict, name: str, shape: tuple[int, ...]) -> None:
    contents[f"field.{name}"] = np.zeros(shape, dtype=np.float32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["field.forward_field.node"].fill(10**9), "a node of the rest weights does not exist"),
        (lambda c: c["field.forward_field.bone"].fill(99), "a bone of the rest weights does not exist"),
        (lambda c: c["field.forward_field.first"].fill(0), "the rows of rest weights do not follow each other"),
        (lambda c: c["field.forward_field.weight"].fill(1e38), "the rest weights of a node do not sum to one"),
        (lambda c: stored(c, "forward_field.row", np.int64), "must be stored as 32-bit integers"),
        (lambda c: stored(c, "inverse.cache.values", np.int64), "values must be stored as floating-point numbers"),
        (lambda c: c.pop("field.forward_field.row"), "row"),
        (lambda c: cut(c, "inverse.cache.values", 5), "the grid and its bricks have"),
        (lambda c: c["field.inverse.cache.brick"].fill(10**6), "the grid and its bricks have"),
    ],
)
def test_broken_grids_of_the_last_version_are_refused(change, message: str, tmp_path: Path) -> None:
    contents, text = read_archive(VERSION_5 / "nilbs.nilbs", kind=KIND_5)
    change(contents)
    write_archive(tmp_path / "odd.nilbs", contents, text, kind=KIND_5)
    with pytest.raises(FileFormatError, match=rf"odd\.nilbs: is not a complete nilbs model: .*{message}"):
        load_model(tmp_path / "odd.nilbs")


@DIMENSIONS
@pytest.mark.parametrize("encoding", ["distances", "local", "parameters"])
@pytest.mark.parametrize("ghost", [False, True])
@pytest.mark.parametrize("forward", ["grid", "network"])
def test_the_shapes_that_files_are_checked_by_are_those_of_the_field(
    d: int, encoding: str, ghost: bool, forward: str, models
) -> None:
    model = models[d]
    method = replace(model.method, encoding=encoding, ghost=ghost, forward_map=forward, width=5, depth=4)
    state = method.field_around(model.character, model.rest).state_dict()
    assert method.parameter_shapes(model.character) == {name: tuple(tensor.shape) for name, tensor in state.items()}


@DIMENSIONS
def test_a_model_is_read_and_queried_by_its_arrays_alone(d: int, saved, models, queries) -> None:
    model = load_model(saved[d])
    x, pose = queries(models[d], 200)
    model.occupancy(x, pose), model.distance(x, pose), model.rest_points(x, pose), model.posed_points(x, pose)
    assert "field" not in vars(model)
    assert model.parameters.keys() == models[d].parameters.keys()
    for name, array in models[d].rest.arrays.items():
        np.testing.assert_array_equal(model.rest.arrays[name], array)
    assert model.rest.header == models[d].rest.header


def test_what_a_field_learns_after_it_was_loaded_is_saved(saved, tmp_path: Path, queries) -> None:
    model = load_model(saved[2])
    with torch.no_grad():
        model.field.inverse.network.layers[0].bias += 0.5
    model.save(tmp_path / "more.nilbs")
    x, pose = queries(model, 50)
    before, after = (load_model(path).weights(x, pose) for path in (saved[2], tmp_path / "more.nilbs"))
    np.testing.assert_array_equal(after, model.weights(x, pose))
    assert np.abs(after - before).max() > 0.01


@pytest.mark.parametrize("mapping", ["parts", "search"])
def test_files_with_the_mapping_of_another_name_are_read(mapping: str, saved, tmp_path: Path, queries) -> None:
    contents, text = read_archive(saved[2], kind=KIND)
    text["settings"]["mapping"] = mapping
    write_archive(tmp_path / "parts.nilbs", contents, text, kind=KIND)
    model, again = load_model(saved[2]), load_model(tmp_path / "parts.nilbs")
    assert again.method == model.method
    assert again.method.mapping == "search"
    x, pose = queries(model, 50)
    np.testing.assert_array_equal(again.occupancy(x, pose), model.occupancy(x, pose))


@pytest.mark.parametrize("name", ["nilbs", "paper", "nasa", "nearest"])
def test_models_of_the_last_file_version_are_read(name: str, tmp_path: Path) -> None:
    # Files of the last version, with the occupancies that it computed.
    model, known = load_model(VERSION_5 / f"{name}.nilbs"), np.load(VERSION_5 / "occupancy.npz")
    assert model.method.name == name
    # Distances on grids are rounded to 16 bits since, which moves the surface by some 1e-6 L.
    atol = 2e-4 if model.rest.arrays else 1e-5
    np.testing.assert_allclose(model.occupancy(known["x"], known["pose"]), known[name], atol=atol)
    model.save(tmp_path / "again.nilbs")
    again = load_model(tmp_path / "again.nilbs")
    assert again.method == model.method
    np.testing.assert_array_equal(
        again.occupancy(known["x"], known["pose"]), model.occupancy(known["x"], known["pose"])
    )
