from pathlib import Path

import numpy as np
import pytest
import torch

from nilbs.io.archive import read_archive, write_archive
from nilbs.io.errors import FileFormatError
from nilbs.models.model import load_model
from nilbs.models.model_file import KIND

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
VERSION_5 = Path(__file__).parent / "version_5"
ANSWERS = ("occupancy", "distance", "weights")


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
    header = 8 + int.from_bytes(data[:8], "little")
    places = np.concatenate([np.arange(16), rng.integers(0, header, 150), rng.integers(header, len(data), 50)])
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
    with pytest.raises(FileFormatError, match=r"is 'nilbs model 0', not 'nilbs model 6', which this version of nilbs"):
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
        (
            lambda c, t: c.update({"field.inverse.cache.values": c["field.inverse.cache.values"][:1]}),
            r"nodes and the bricks \d+ cells, not 1 and",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.brick": c["field.inverse.cache.brick"][:0]}),
            "the rest cache has shape",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.brick": c["field.inverse.cache.brick"] + 1}),
            "the grid and its bricks have",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.finer": c["field.inverse.cache.finer"] - 1}),
            "a brick of the rest cache has a number below -1",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.finer": c["field.inverse.cache.finer"][:-1]}),
            "the grid and its bricks have",
        ),
        (lambda c, t: c.pop("field.inverse.cache.finer"), "finer"),
        (lambda c, t: c.update({"field.inverse.cache.origin": np.zeros(7, dtype=np.float32)}), "origin must be"),
        (lambda c, t: c.update({"history": np.zeros((2, 2))}), "history must be"),
        (
            lambda c, t: c.update({"character.BE": c["character.BE"].astype(float)}),
            "must be stored as integers",
        ),
        (lambda c, t: c.update({"character.V": 0 * c["character.V"]}), "all vertices lie in one place"),
        (lambda c, t: t.pop("spacing"), "spacing"),
        (lambda c, t: t["spacing"].update({"forward_field": "wide"}), "could not convert"),
        (lambda c, t: t["spacing"].update({"inverse.cache": 10**400}), "too large"),
        (lambda c, t: t["spacing"].update({"inverse.cache": 0}), "cells of grids must have an edge above zero"),
        (lambda c, t: t["spacing"].update({"forward_field": -1}), "cells of grids must have an edge above"),
        (lambda c, t: c.update({"field.forward_field.row": c["field.forward_field.row"] + 10**6}), "does not exist"),
        (lambda c, t: c.update({"field.forward_field.bone": c["field.forward_field.bone"] + 99}), "does not exist"),
        (lambda c, t: c.update({"field.forward_field.first": -c["field.forward_field.first"]}), "do not follow"),
        (lambda c, t: c.update({"field.forward_field.row": c["history"]}), "the grid of rest weights has shape"),
        (lambda c, t: c.update({"field.forward_field.bone": c["history"]}), "32-bit"),
        (lambda c, t: t.update(bones=["a"]), "names must be"),
        (lambda c, t: t["settings"].update(steps="many"), "steps must be of type int"),
        (lambda c, t: t.update(method="magic"), "no method 'magic'"),
        (lambda c, t: t["settings"].pop("steps"), "settings are"),
        (
            lambda c, t: (
                t["settings"].update(width=4000),
                c.update({"field.inverse.cache.values": c["field.inverse.cache.values"][:9]}),
                c.update({"field.inverse.cache.finer": c["field.inverse.cache.finer"][:9]}),
            ),
            "no layer is as wide as its settings, 4000",
        ),
        (lambda c, t: t["settings"].update(depth=4000), "there are fewer layers than in its settings"),
        (
            lambda c, t: (
                t["settings"].update(width=4096, depth=50),
                c.update({f"field.{k}": np.zeros((0, 4096)) for k in range(50)}),
            ),
            "it holds less than 50 layers of width 4096",
        ),
        (
            lambda c, t: c.update({"field.forward_field.weight": 0 * c["field.forward_field.weight"] + 1e38}),
            "a rest weight is 100 or more",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.origin": np.zeros(2, dtype=bool)}),
            "inverse.cache.origin must be stored as floating-point numbers",
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


@pytest.mark.parametrize("name", ["nilbs", "paper", "nasa", "nearest"])
def test_models_of_the_last_file_version_are_read(name: str, tmp_path: Path) -> None:
    # Files of the last version, with the occupancies that it computed.
    model, known = load_model(VERSION_5 / f"{name}.nilbs"), np.load(VERSION_5 / "occupancy.npz")
    assert model.method.name == name
    np.testing.assert_allclose(model.occupancy(known["x"], known["pose"]), known[name], atol=1e-5)
    model.save(tmp_path / "again.nilbs")
    again = load_model(tmp_path / "again.nilbs")
    assert again.method == model.method
    np.testing.assert_array_equal(
        again.occupancy(known["x"], known["pose"]), model.occupancy(known["x"], known["pose"])
    )
