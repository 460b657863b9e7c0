from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import nilbs.posed_model
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning
from nilbs.io.archive import read_archive, write_archive
from nilbs.io.errors import FileFormatError
from nilbs.model import Model, torch_device
from nilbs.model_file import KIND, check_character, load_model
from nilbs.settings import MAPPINGS, METHODS, Settings
from nilbs.unit_frame import in_unit_frame, rest_center

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
ANSWERS = ("occupancy", "distance", "weights")


def rigid(d: int, rng: np.random.Generator, *, far: float = 1.0) -> np.ndarray:
    return rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), far * rng.normal(size=d))


def queries(model: Model, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points around a posed character, and the pose."""
    c, pose = model.character, model.motion[3]
    U = linear_blend_skinning(c.V, c.W, pose)
    cube = Grid.cube(U, 1)
    return rng.uniform(cube.lower, cube.upper, (n, c.d)), pose


@pytest.fixture
def saved(models, tmp_path: Path) -> dict[int, Path]:
    for d, model in models.items():
        model.save(tmp_path / f"{d}.nilbs")
    return {d: tmp_path / f"{d}.nilbs" for d in models}


@DIMENSIONS
def test_answers_have_their_shapes_and_ranges(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 500, rng)
    occupancy, W = model.occupancy(x, pose, mapping="inverse"), model.weights(x, pose)
    assert occupancy.shape == (500,)
    assert 0 <= occupancy.min() < 0.5 < occupancy.max() <= 1
    assert W.shape == (500, len(model.character.BE) + 1)
    assert W.min() >= 0
    np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-5)
    # Occupancy by eq. 7 and 8, from the other answers.
    x_rest = (model.rest_points(x, pose, mapping="inverse") - rest_center(model.character)) / model.character.L
    cached = model.field.inverse.cache.distance(torch.as_tensor(x_rest, dtype=torch.float32)).numpy()
    inside = 1 / (1 + np.exp(np.clip(cached / model.settings.cache_width, -50, 50)))
    np.testing.assert_allclose(model.occupancy(x, pose, mapping="inverse", ghost=False), inside, atol=1e-4)
    np.testing.assert_allclose(occupancy, (1 - W[:, -1]) * inside, atol=1e-4)
    # Distance is the cached one, but for points inside that the ghost bone rules out.
    distance = model.distance(x, pose, mapping="inverse") / model.character.L
    overruled = (cached < 0) & (occupancy < 0.5)
    np.testing.assert_allclose(distance[~overruled], cached[~overruled], atol=1e-6)
    np.testing.assert_array_equal(distance < 0, occupancy > 0.5)


@DIMENSIONS
def test_rest_points_invert_the_blend_of_the_weights_answered(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 200, rng)
    W = model.weights(x, pose).astype(np.float64)
    bones = W[:, :-1].copy()
    bones[:, model.root] += W[:, -1]
    x_rest = inverse_linear_blend_skinning(x, bones / bones.sum(axis=1, keepdims=True), pose)
    near = np.linalg.norm(x_rest - x, axis=1) < 2  # a blend that is nearly singular loses digits
    assert near.mean() > 0.9
    np.testing.assert_allclose(model.rest_points(x, pose, mapping="inverse")[near], x_rest[near], atol=1e-3)


@DIMENSIONS
@pytest.mark.parametrize("far", [1.0, 1e4])
def test_a_rigidly_moved_query_is_answered_as_at_rest(d: int, far: float, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 300, rng)
    rest = np.broadcast_to(np.eye(d + 1), pose.shape)
    world = rigid(d, rng, far=far)
    for B in (rest, pose):
        moved = transform_points(world, x), world @ B
        for answer in ANSWERS:
            np.testing.assert_allclose(getattr(model, answer)(*moved), getattr(model, answer)(x, B), atol=1e-5)
        np.testing.assert_allclose(model.rest_points(*moved), model.rest_points(x, B), atol=1e-4)


@DIMENSIONS
def test_in_double_precision_a_rigid_motion_leaves_nothing(d: int, saved, rng: np.random.Generator) -> None:
    model = load_model(saved[d]).to(dtype=torch.float64)
    x, pose = queries(model, 300, rng)
    world = rigid(d, rng)
    for answer in ANSWERS:
        values = getattr(model, answer)(x, pose)
        assert values.dtype == np.float64
        moved = getattr(model, answer)(transform_points(world, x), world @ pose)
        np.testing.assert_allclose(moved, values, atol=1e-9)


@DIMENSIONS
def test_a_character_in_another_unit_is_the_same_to_the_field(d: int, characters, rng: np.random.Generator) -> None:
    c, s, shift = characters[d], 250.0, 31.0
    large = replace(c, V=s * c.V + shift, C=s * c.C + shift)
    to = rigid_transforms(s * np.eye(d), np.full(d, shift))
    back = np.linalg.inv(to)
    x, B = rng.normal(size=(20, d)), np.stack([rigid(d, rng) for _ in c.BE])
    for given, scaled in zip(in_unit_frame(c, x, B), in_unit_frame(large, s * x + shift, to @ B @ back), strict=True):
        np.testing.assert_allclose(scaled, given, atol=1e-10)
    np.testing.assert_allclose(in_unit_frame(c, x, B)[1][np.flatnonzero(c.P < 0)[0]], np.eye(d + 1), atol=1e-12)


@DIMENSIONS
def test_tensors_are_answered_as_arrays_are(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 200, rng)
    for mapping in ("search", "inverse"):
        answer = model.answer(*map(torch.as_tensor, (x, pose)), mapping=mapping)
        np.testing.assert_allclose(
            answer.distance.numpy(force=True), model.distance(x, pose, mapping=mapping), atol=1e-5
        )
        np.testing.assert_allclose(
            answer.x_rest.numpy(force=True), model.rest_points(x, pose, mapping=mapping), atol=1e-4
        )
        occupancy = torch.sigmoid(answer.logit).numpy(force=True)
        np.testing.assert_allclose(occupancy, model.occupancy(x, pose, mapping=mapping), atol=1e-3)


@DIMENSIONS
def test_rest_points_are_posed_where_they_were_asked(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    c, pose = model.character, model.motion[3]
    inner = rng.dirichlet(np.ones(d + 1), 300)
    element = c.T[rng.integers(0, len(c.T), 300)]
    x_rest, W = (np.einsum("nc,nci->ni", inner, values[element]) for values in (c.V_volume, c.W_volume))
    x = linear_blend_skinning(x_rest, W, pose)
    assert (model.occupancy(x, pose) > 0.5).mean() > 0.97
    # Each is posed from where it is found, as far as the coarse grid of weights tells.
    missed = np.linalg.norm(model.rest_points(x, pose) - x_rest, axis=1)
    assert np.quantile(missed, 0.9) < 0.03 * c.L


@DIMENSIONS
def test_a_body_twice_as_large_has_distances_twice_as_large(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    c = model.character
    rest = np.broadcast_to(np.eye(d + 1), model.motion[0].shape).copy()
    x = c.V + 0.01 * c.L * rng.normal(size=c.V.shape)
    larger = np.diag([2.0] * d + [1.0]) @ rest
    np.testing.assert_allclose(model.distance(2 * x, larger), model.distance(x, rest), atol=1e-4 * c.L)
    posed = model.posed_distance(2 * x, larger)
    np.testing.assert_allclose(posed, 2 * model.posed_distance(x, rest), atol=1e-4 * c.L)
    np.testing.assert_array_equal(posed < 0, model.distance(2 * x, larger) < 0)


@DIMENSIONS
def test_where_skinning_stretches_the_posed_distance_is_nearer_the_truth(d: int, models, rng) -> None:
    model = models[d]
    c = model.character
    # Wider by half across the first axis, and every bone alike, so that truth is the posed mesh's own distance.
    wide = np.repeat(np.diag([1.0, *[1.5] * (d - 1), 1.0])[None], len(c.BE), axis=0)
    U = linear_blend_skinning(c.V, c.W, wide)
    x = U + 0.01 * c.L * rng.normal(size=U.shape)
    true = signed_distance(U, c.F, x)
    missed = [np.abs(found - true).mean() for found in (model.posed_distance(x, wide), model.distance(x, wide))]
    assert missed[0] < 0.7 * missed[1]


@DIMENSIONS
def test_chunks_do_not_change_the_answers(d: int, models, rng: np.random.Generator, monkeypatch) -> None:
    model = models[d]
    x, pose = queries(model, 100, rng)
    whole = {answer: getattr(model, answer)(x, pose) for answer in ANSWERS}
    monkeypatch.setattr(nilbs.posed_model, "CHUNK", 7)
    for answer in ANSWERS:
        np.testing.assert_allclose(getattr(model, answer)(x, pose), whole[answer], atol=1e-5)


@DIMENSIONS
def test_no_points(d: int, models) -> None:
    model = models[d]
    pose, x = model.motion[0], np.zeros((0, d))
    assert model.occupancy(x, pose).shape == (0,)
    assert model.distance(x, pose).shape == (0,)
    assert model.weights(x, pose).shape == (0, len(model.character.BE) + 1)
    assert model.rest_points(x, pose).shape == (0, d)


@DIMENSIONS
def test_what_is_no_query_is_refused(d: int, models) -> None:
    model = models[d]
    b, pose = len(model.character.BE), model.motion[0]
    with pytest.raises(ValueError, match=rf"^pose must be \(b, d\+1, d\+1\) = \({b}, {d + 1}, {d + 1}\), got \(1,"):
        model.occupancy(np.zeros((4, d)), pose[:1])
    with pytest.raises(ValueError, match=rf"^x must be \(n, {d}\)"):
        model.distance(np.zeros((4, 5 - d)), pose)
    with pytest.raises(ValueError, match=r"^x\[0, 0\] is nan"):
        model.weights(np.full((1, d), np.nan), pose)
    singular = pose.copy()
    singular[model.root, :d, :d] = 0
    with pytest.raises(ValueError, match=r"^bone 0, the root, has a singular transform$"):
        model.rest_points(np.zeros((4, d)), singular)
    with pytest.raises(ValueError, match=r"^mapping must be one of search, .*, got 'forward'$"):
        model.occupancy(np.zeros((4, d)), pose, mapping="forward")


@DIMENSIONS
def test_the_surface_is_closed_and_occupancy_is_one_half_on_it(d: int, models) -> None:
    model = models[d]
    pose = model.motion[2]
    U, F = model.extract(pose, resolution=40)
    assert is_watertight(F)
    # Linear interpolation between nodes misses the level by less than a cell, and by less on a finer grid.
    missed = np.median(np.abs(model.distance(U, pose)))
    assert missed < 0.25 * model.character.L / 40
    assert np.median(np.abs(model.distance(model.extract(pose, resolution=120)[0], pose))) < 0.5 * missed
    # Asking coarsely first saves work and changes nothing.
    grid = Grid.cube(linear_blend_skinning(model.character.V, model.character.W, pose), 40)
    everywhere = model.posed(pose).extract_on(grid, stride=1)
    np.testing.assert_allclose(U, everywhere[0], atol=1e-6)
    np.testing.assert_array_equal(F, everywhere[1])


@DIMENSIONS
def test_what_was_saved_is_loaded(d: int, models, saved, rng: np.random.Generator) -> None:
    model, again = models[d], load_model(saved[d])
    for name in ("V", "F", "C", "BE", "P", "W", "V_volume", "T", "W_volume"):
        np.testing.assert_array_equal(getattr(again.character, name), getattr(model.character, name))
    assert again.character.name == model.character.name
    assert again.character.names == model.character.names
    np.testing.assert_array_equal(again.motion.B, model.motion.B)
    np.testing.assert_array_equal(again.motion.frames, model.motion.frames)
    np.testing.assert_array_equal(again.history, model.history)
    assert again.config == model.config
    assert again.config["motion"] == "random, amplitude 0.4 rad rms, 6 frames, seed 0"
    assert again.config["frames"] == 6
    x, pose = queries(model, 200, rng)
    for answer in ANSWERS:
        np.testing.assert_array_equal(getattr(again, answer)(x, pose), getattr(model, answer)(x, pose))


def test_double_precision_survives_a_file(saved, tmp_path: Path, rng: np.random.Generator) -> None:
    model = load_model(saved[2]).to(dtype=torch.float64)
    with torch.no_grad():
        model.field.inverse.network.layers[0].bias += 1e-12
    model.save(tmp_path / "double.nilbs")
    again = load_model(tmp_path / "double.nilbs")
    x, pose = queries(model, 50, rng)
    np.testing.assert_array_equal(again.occupancy(x, pose), model.occupancy(x, pose))
    assert again.occupancy(x, pose).dtype == np.float64


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
    with pytest.raises(FileFormatError, match=r"is 'nilbs model 0', not 'nilbs model 3', which this version of nilbs"):
        load_model(tmp_path / "old.nilbs")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c, t: c.pop("character.V"), "V"),
        (lambda c, t: c.pop("motion.frames"), "motion.frames"),
        (lambda c, t: c.pop("field.inverse.network.layers.1.weight"), "layers.1.weight"),
        (lambda c, t: c.update({"character.W": c["character.W"][:-1]}), r"W must be"),
        (lambda c, t: c.update({"character.F": c["character.F"] + 10**6}), "F has an index outside"),
        (lambda c, t: c.update({"character.P": np.full_like(c["character.P"], 99)}), "does not index"),
        (lambda c, t: c.update({"character.colour": c["character.V"]}), "colour"),
        (lambda c, t: c.update({"motion.B": c["motion.B"][:, :1]}), "the motion has shape"),
        (
            lambda c, t: c.update({"field.inverse.cache.values": c["field.inverse.cache.values"][:1]}),
            "a node of the rest cache does not exist",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.brick": c["field.inverse.cache.brick"][:0]}),
            "the rest cache has shape",
        ),
        (
            lambda c, t: c.update({"field.inverse.cache.brick": c["field.inverse.cache.brick"] + 1}),
            "a node of the rest cache does not exist",
        ),
        (lambda c, t: c.update({"field.inverse.cache.origin": np.zeros(7, dtype=np.float32)}), "origin must be"),
        (lambda c, t: c.update({"history": np.zeros((2, 2))}), "history must be"),
        (lambda c, t: c.update({"character.BE": c["character.BE"].astype(float)}), "must be stored as integers"),
        (lambda c, t: c.update({"character.V": 0 * c["character.V"]}), "all vertices lie in one place"),
        (lambda c, t: t.pop("spacing"), "spacing"),
        (lambda c, t: t["spacing"].update({"forward_field": "wide"}), "could not convert"),
        (lambda c, t: t["spacing"].update({"inverse.cache": 10**400}), "too large"),
        (lambda c, t: c.update({"field.forward_field.row": c["field.forward_field.row"] + 10**6}), "does not exist"),
        (lambda c, t: c.update({"field.forward_field.bone": c["field.forward_field.bone"] + 99}), "does not exist"),
        (lambda c, t: c.update({"field.forward_field.first": -c["field.forward_field.first"]}), "do not follow"),
        (lambda c, t: c.update({"field.forward_field.row": c["history"]}), "the grid of rest weights has shape"),
        (lambda c, t: c.update({"field.forward_field.bone": c["history"]}), "32-bit"),
        (lambda c, t: t.update(bones=["a"]), "names or parents of bones do not fit the bones"),
        (lambda c, t: t["settings"].update(steps="many"), "steps must be of type int"),
        (lambda c, t: t["settings"].pop("steps"), "settings are"),
        (lambda c, t: t["settings"].update(width=4000), "no layer is as wide as the settings say, 4000"),
        (lambda c, t: t["settings"].update(depth=4000), "there are fewer layers than the settings say"),
    ],
)
def test_an_archive_that_is_no_complete_model_is_refused(change, message: str, saved, tmp_path: Path) -> None:
    contents, text = read_archive(saved[2], kind=KIND)
    change(contents, text)
    write_archive(tmp_path / "odd.nilbs", contents, text, kind=KIND)
    with pytest.raises(FileFormatError, match=rf"odd\.nilbs: is not a complete nilbs model: .*{message}") as caught:
        load_model(tmp_path / "odd.nilbs")
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_written_leaves_what_was_there(models, saved, tmp_path: Path, monkeypatch) -> None:
    before = saved[2].read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        models[3].save(saved[2])
    assert saved[2].read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2.nilbs", "3.nilbs"]


def test_devices_are_checked_by_name() -> None:
    assert torch_device("cpu") == "cpu"
    assert torch_device("auto") == ("cuda" if torch.cuda.is_available() else "cpu")
    with pytest.raises(ValueError, match=r"^torch cannot use the device 'abacus': "):
        torch_device("abacus")


@DIMENSIONS
def test_the_characters_of_models_are_sound(d: int, models) -> None:
    check_character(models[d].character)


@DIMENSIONS
@pytest.mark.parametrize("mapping", MAPPINGS)
def test_every_mapping_answers(d: int, mapping: str, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 300, rng)
    posed = model.posed(pose, mapping=mapping)
    occupancy = posed.occupancy(x)
    assert occupancy.shape == (300,)
    np.testing.assert_array_equal(posed.distance(x) < 0, occupancy > 0.5)
    assert (posed.lookups is None) == (mapping in ("inverse", "reverse"))
    np.testing.assert_array_equal(model.occupancy(x, pose, mapping=mapping), occupancy)


@DIMENSIONS
def test_the_forward_map_poses_the_vertices(d: int, models) -> None:
    model = models[d]
    c, pose = model.character, rigid(d, np.random.default_rng(3)) @ model.motion[2]
    missed = np.linalg.norm(model.posed_points(c.V, pose) - c.skin(pose), axis=1)
    assert np.median(missed) < 0.01 * c.L
    assert model.posed_points(np.zeros((0, d)), pose).shape == (0, d)


@DIMENSIONS
def test_any_field_known_at_rest_is_read_at_the_rest_images(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    x, pose = queries(model, 400, rng)
    inside, images = model.occupancy(x, pose) > 0.5, model.rest_points(x, pose)
    colour = model.values(lambda x_rest: x_rest**2, x, pose)
    np.testing.assert_allclose(colour[inside], images[inside] ** 2)
    assert np.isnan(colour[~inside]).all()
    density = model.values(lambda x_rest: x_rest[:, 0], x, pose, outside=-5.0)
    np.testing.assert_allclose(density, np.where(inside, images[:, 0], -5))
    with pytest.raises(ValueError, match=r"^the rest field must answer 400 points, got an array of shape \(3,\)$"):
        model.values(lambda x_rest: np.zeros(3), x, pose)


RIVALS = [method for method in METHODS if method != "nilbs"]


@pytest.fixture(scope="module")
def rivals(characters) -> dict[tuple[str, int], Model]:
    """Every other method, after a moment's training."""
    from nilbs.fitting import fit
    from nilbs.motion import random_motion

    sizes = {"width": 8, "depth": 3, "poses_per_step": 2, "points_per_pose": 32, "samples_per_frame": 200}
    return {
        (method, d): fit(c, random_motion(c, frames=4), device="cpu", method=method, steps=3, **sizes)
        for method in RIVALS
        for d, c in characters.items()
    }


@DIMENSIONS
@pytest.mark.parametrize("method", RIVALS)
def test_rivals_answer_the_same_interface(
    method: str, d: int, rivals, tmp_path: Path, rng: np.random.Generator
) -> None:
    model = rivals[method, d]
    x, pose = queries(model, 200, rng)
    occupancy = model.occupancy(x, pose)
    assert occupancy.shape == (200,)
    assert ((occupancy >= 0) & (occupancy <= 1)).all()
    model.save(tmp_path / "rival.nilbs")
    again = load_model(tmp_path / "rival.nilbs")
    np.testing.assert_array_equal(again.occupancy(x, pose), occupancy)
    assert again.settings == model.settings
    U, F = model.extract(pose, resolution=12)
    assert U.shape[1] == F.shape[1] == d
    # The world moves and the answer stays; and nobody but the paper's method has a choice of maps.
    world = rigid(d, rng)
    moved = model.occupancy(transform_points(world, x), world @ pose)
    np.testing.assert_allclose(moved, occupancy, atol=1e-3)
    with pytest.raises(ValueError, match=r"use 'nilbs'$"):
        model.occupancy(x, pose, mapping="inverse")


@pytest.mark.parametrize("method", ["nasa", "mlp", "snarf"])
def test_what_knows_no_distance_says_so(method: str, rivals, rng: np.random.Generator) -> None:
    model = rivals[method, 2]
    x, pose = queries(model, 20, rng)
    with pytest.raises(ValueError, match=r"knows no distance, only occupancy$"):
        model.distance(x, pose)
    if method != "snarf":
        with pytest.raises(ValueError, match=r"knows no rest images of posed points$"):
            model.rest_points(x, pose)
    assert model.answer(*map(torch.as_tensor, (x, pose))).distance.isnan().all()


def test_mesh_skinning_as_a_method_is_the_truth(rivals, rng: np.random.Generator) -> None:
    model = rivals["mesh-lbs", 3]
    x, pose = queries(model, 500, rng)
    truth = signed_distance(model.character.skin(pose), model.character.F, x)
    np.testing.assert_allclose(model.distance(x, pose), truth, atol=1e-5 * model.character.L)


def test_a_network_may_keep_the_forward_weights(characters, tmp_path: Path, rng: np.random.Generator) -> None:
    from nilbs.fitting import fit
    from nilbs.motion import random_motion

    c = characters[2]
    small = {"width": 32, "depth": 3, "poses_per_step": 8, "samples_per_frame": 500, "cache_resolution": 64}
    model = fit(
        c, random_motion(c, frames=4), device="cpu", forward="network", encoding="parameters", steps=150, **small
    )
    x, pose = queries(model, 2000, rng)
    missed = np.linalg.norm(model.posed_points(c.V, pose) - c.skin(pose), axis=1)
    assert np.median(missed) < 0.05 * c.L
    model.save(tmp_path / "network.nilbs")
    np.testing.assert_array_equal(load_model(tmp_path / "network.nilbs").distance(x, pose), model.distance(x, pose))
    assert model.settings == Settings.from_mapping(
        {key: value for key, value in model.config.items() if key not in ("motion", "frames")}
    )
