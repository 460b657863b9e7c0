import errno
import os
from pathlib import Path

import numpy as np
import pytest

from nilbs.characters.bundle import load_character
from nilbs.characters.motion import random_motion
from nilbs.characters.saving import save_character, write_bundle
from nilbs.geometry.facets import is_watertight
from nilbs.io import read_mesh, read_npy, read_weights, write_motion_json, write_transforms
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.models.model import load_model


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.fixture
def motion_file(tmp_path, d):
    """Two frames: at rest, and moved by one unit along x."""
    path = tmp_path / "motion.json"
    translation = np.zeros((2, d))
    translation[1, 0] = 1
    write_motion_json(path, ["bone0", "bone1"], np.zeros((2, 2, 1 if d == 2 else 3)), translation)
    return path


@pytest.mark.parametrize("suffix", [".npz", ".dmat"])
def test_weights(assets, succeeds, out, d, suffix):
    mesh, rig, path = assets / f"bar{d}.obj", assets / "bar.tgf", out / f"w{suffix}"
    values = succeeds("weights", mesh, rig, "-o", path)
    assert {"min", "max", "row_sum_error", "energy", "seconds", "method"} <= values.keys()
    assert values["min"] >= 0
    assert values["max"] <= 1
    assert values["row_sum_error"] <= 1e-9
    assert values["method"] == "joint"
    W = read_weights(path)
    V, _ = read_mesh(mesh)
    assert W.shape == (len(V), 2)
    assert (W[V[:, 0] < 1, 0] > 0.9).all()
    assert (W[V[:, 0] > 3.5, 1] > 0.9).all()


def test_weights_by_the_reference_are_no_better(assets, succeeds, out, d):
    files = (assets / f"bar{d}.obj", assets / "bar.tgf")
    reference = succeeds("weights", *files, "--method", "igl")
    assert reference["method"] == "igl"
    assert succeeds("weights", *files)["energy"] <= reference["energy"] * (1 + 1e-3)
    assert os.listdir(out) == []


def test_weights_as_a_table(assets, nilbs):
    status, text, _ = nilbs("weights", assets / "bar2.obj", assets / "bar.tgf")
    assert status == 0
    assert any(line.split() == ["method", "joint"] for line in text.splitlines())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["weights", "no.obj", "bar.tgf"], "no.obj: No such file or directory"),
        (["weights", "bar2.obj", "no.tgf"], "no.tgf: No such file or directory"),
        (["weights", "bar2.obj", "bar.tgf", "-o", "out/no/w.npz"], "out/no: the folder does not exist"),
        (["weights", "bar2.obj", "bar.tgf", "-o", "out/w.csv"], "out/w.csv: the file name must end in .npz or .dmat"),
        (["weights", "bar2.obj", "bar.tgf", "-o", "out"], "out: the file name must end in"),
        (["weights", "bar2.obj", "bar3.obj"], "bar2.obj and {}/bar3.obj both hold a mesh: leave one out"),
        (["weights", "bar3-weights.npz", "-o", "bar3-weights.npz"], "bar3-weights.npz: this file is read too"),
        (["weights", "bar.tgf"], "bar.tgf: there is no mesh: give its file too"),
        (["weights", "bar2.obj"], "bar2.obj: there is no rig: give its file too"),
        (
            ["weights", "bar2.obj", "bar.tgf", "bar2-weights.npz"],
            "solved for or read from {}/bar2-weights.npz, not both",
        ),
        (["weights", "bar2.obj", "far.tgf"], "bar2.obj with {}/far.tgf: the rig is "),
        (["weights", "bar2.obj", "bar.tgf", "--group", "arm"], "bar2.obj: the mesh has no group 'arm'"),
        (["train", "bar2.obj", "bar.tgf", "-o", "out/m.npz"], "out/m.npz: the file name must end in .nilbs"),
        (["train", "bar2.obj", "bar.tgf", "-o", "out/no/m.nilbs"], "out/no: the folder does not exist"),
        (["train", "bar2.obj", "bar.tgf", "--device", "abacus", "-o", "out/m.nilbs"], "torch cannot use the device"),
        (
            ["train", "bar2.obj", "bar.tgf", "--weights", "bar3-weights.npz", "-o", "out/m.nilbs"],
            "bar2.obj with {}/bar.tgf and {}/bar3-weights.npz: the weights have 54 rows",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--motion", "one.dmat", "-o", "out/m.nilbs"],
            "one.dmat: moves 1 bones, but the rig has 2",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--motion", "one.dmat", "--amplitude", "1", "-o", "out/m.nilbs"],
            "--amplitude is of random motion",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--motion", "one.dmat", "--map", "m.json", "-o", "out/m.nilbs"],
            "one.dmat: a .dmat file moves the character's own bones: there is no bone map to choose",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--clip", "walk", "-o", "out/m.nilbs"],
            "--clip is for the motion of a file, and no file",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "one.json", "--clip", "walk", "-o", "out/m.nilbs"],
            "no motion 'walk', but 'one'",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "one.json", "--amplitude", "1", "-o", "out/m.nilbs"],
            "--amplitude is of random",
        ),
        (["train", "bar2.obj", "bar.tgf", "--random", "--motion", "one.json", "-o", "out/m.nilbs"], "leave one out"),
        (
            ["train", "bar2.obj", "bar.tgf", "one.json", "--random", "--clip", "one", "-o", "out/m.nilbs"],
            "--clip is for the motion of a file, and the motion is random",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--weights", "bar2-weights.npz", "--solve", "-o", "out/m.nilbs"],
            "weights are solved for or read from {}/bar2-weights.npz, not both",
        ),
        (["train", "bar2.obj", "bar.tgf", "--motion", "bar2.obj", "-o", "out/m.nilbs"], "the file name must end in"),
        (
            ["train", "bar2.obj", "bar.tgf", "--method", "nasa", "--mapping", "inverse", "-o", "out/m.nilbs"],
            "--mapping: the method nasa",
        ),
        (
            ["train", "bar2.obj", "bar.tgf", "--method", "nearest", "--width", "8", "-o", "out/m.nilbs"],
            "--width: the method nearest",
        ),
        (["train", "bar2.obj", "bar.tgf", "--noise", "-1", "-o", "out/m.nilbs"], "noise must lie between 0 and"),
        (["query", "bar2.nilbs", "x3.npy", "--frame", "0", "-o", "out/v.npy"], "x3.npy: points must be (n, 2)"),
        (
            ["query", "bar2.nilbs", "x2.npy", "--frame", "3", "-o", "out/v.npy"],
            "the motion of the model: there is no",
        ),
        (
            ["query", "bar2.nilbs", "x2.npy", "--frame", "0", "--map", "m.json", "-o", "out/v.npy"],
            "--map is for the motion of a file",
        ),
        (["query", "bar2.nilbs", "x2.npy", "--frame", "0", "-o", "x2.npy"], "x2.npy: this file is read too"),
        (["query", "bar2.nilbs", "no.npy", "--frame", "0", "-o", "out/v.npy"], "no.npy: No such file or directory"),
        (["query", "bar2.obj", "x2.npy", "--frame", "0", "-o", "out/v.npy"], "bar2.obj: "),
        (["query", "cut.nilbs", "x2.npy", "--frame", "0", "-o", "out/v.npy"], "cut.nilbs: "),
        (["extract", "flipped.nilbs", "--frame", "0", "-o", "out/v.obj"], "flipped.nilbs: "),
        (["extract", "bar2.nilbs", "--frame", "0", "-o", "out/v.stl"], "out/v.stl: the file name must end in .obj or"),
        (
            ["extract", "bar2.nilbs", "--motion", "one.dmat", "--frame", "0", "-o", "out/v.obj"],
            "one.dmat: moves 1 bones, but the rig has 2",
        ),
        (["evaluate", "empty.nilbs"], "empty.nilbs: the file is empty"),
        (
            ["extract", "bar2.nilbs", "--frame", "0", "--resolution", "99999", "-o", "out/v.obj"],
            "resolution must be a whole number from 1 to 46340 in 2 dimensions",
        ),
    ],
)
def test_a_mistake_is_named_before_anything_is_written(assets, fails, tmp_path, monkeypatch, words, message):
    for name in os.listdir(assets):
        os.symlink(assets / name, tmp_path / name)
    (tmp_path / "out").mkdir()
    (tmp_path / "empty.nilbs").touch()
    model = bytearray((assets / "bar2.nilbs").read_bytes())
    (tmp_path / "cut.nilbs").write_bytes(model[: len(model) // 2])
    model[len(model) // 2] ^= 1
    (tmp_path / "flipped.nilbs").write_bytes(model)
    (tmp_path / "far.tgf").write_text("1 0.25 0.5 0\n2 2.1 0.5 0\n3 375 0.5 0\n#\n1 2\n2 3\n#\n")
    (tmp_path / "one.json").write_text('{"frames": [{"bone0": 3}]}')
    np.save(tmp_path / "x2.npy", np.zeros((4, 2)))
    np.save(tmp_path / "x3.npy", np.zeros((4, 3)))
    write_transforms(tmp_path / "one.dmat", np.eye(4)[None, None])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nilbs.models.fitting.fit", None)
    words = [words[0], *(word if word.startswith("-") or "." not in word else tmp_path / word for word in words[1:])]
    line = fails(*words)
    assert message.replace("{}", str(tmp_path)) in line
    assert os.listdir("out") == []


def test_train(assets, succeeds, nilbs, out, d, quick_training):
    mesh, rig, path = assets / f"bar{d}.obj", assets / "bar.tgf", out / "m.nilbs"
    weights = assets / f"bar{d}-weights.npz"
    options = ("--weights", weights, "--frames", 4, "--amplitude", 0.3, "--seed", 5, "--steps", 3, "-o", path)
    values = succeeds("train", mesh, rig, *options)
    assert {"seconds", "model", "peak_memory_mib", "loss"} <= values.keys()
    assert values["steps"] == 3
    assert values["peak_memory_mib"] > 10
    assert os.listdir(out) == ["m.nilbs"]
    status, text, _ = nilbs("info", path)
    assert status == 0
    assert "random, amplitude 0.3 rad rms, 4 frames, seed 5" in text
    again = succeeds("train", mesh, rig, *options[:-1], out / "again.nilbs")
    assert again["loss"] == values["loss"]


def test_train_as_in_the_paper(assets, succeeds, out, d, quick_training):
    files = (assets / f"bar{d}.obj", assets / "bar.tgf", "--weights", assets / f"bar{d}-weights.npz", "--frames", 2)
    losses = {}
    for method in ("paper", "nilbs"):
        path = out / f"{method}.nilbs"
        values = succeeds("train", *files, "--method", method, "--steps", 3, "-o", path)
        model = load_model(path)
        assert model.method.name == method
        assert values["steps"] == len(model.history) == 3
        losses[method] = values["loss"]
    assert losses["paper"] != losses["nilbs"]


@pytest.mark.parametrize("method", ["nasa", "snarf", "mlp", "nearest"])
def test_baselines_are_trained_scored_and_extracted_as_the_method_is(assets, succeeds, out, d, method, quick_training):
    path = out / "baseline.nilbs"
    files = (assets / f"bar{d}.obj", assets / "bar.tgf", "--weights", assets / f"bar{d}-weights.npz")
    values = succeeds("train", *files, "--frames", 3, "--method", method, "-o", path)
    assert values["method"] == method
    assert values["steps"] == (0 if method == "nearest" else 2)
    assert load_model(path).method.name == method
    scores = succeeds("evaluate", path, "--points", 50, "--resolution", 8, "--rows", "nearest", "rigid-parts")
    assert set(scores["rows"]) == {"nearest", "rigid-parts"}
    assert scores["training"]["method"] == method
    if method == "nearest":
        for name, iou in scores["poses"]["far"]["iou_bbox"].items():
            assert iou == scores["rows"]["nearest"]["far"]["iou_bbox"][name]
    assert succeeds("extract", path, "--frame", 0, "--resolution", 8, "-o", out / "m.obj")["vertices"] >= 0


def test_train_takes_any_setting_and_a_time(assets, succeeds, out, quick_settings):
    files = (assets / "bar2.obj", assets / "bar.tgf", "--weights", assets / "bar2-weights.npz", "--frames", 2)
    chosen = ("--no-ghost", "--encoding", "parameters", "--random-pose-std", 0, "--width", 12)
    values = succeeds("train", *files, *chosen, "--minutes", 0.005, "-o", out / "m.nilbs")
    method = load_model(out / "m.nilbs").method
    assert (method.ghost, method.encoding, method.random_pose_std) == (False, "parameters", 0)
    assert method.width == 12
    assert method.steps == values["steps"] > 0


def test_train_for_nothing_is_refused(assets, nilbs, out, quick_training):
    files = (assets / "bar2.obj", assets / "bar.tgf", "--weights", assets / "bar2-weights.npz", "--frames", 2)
    off = [word for name in ("occupancy", "weight", "position") for word in (f"--{name}-loss", "0")]
    for forward in ("grid", "network"):
        status, _, error = nilbs("train", *files, *off, "--forward-map", forward, "-o", out / "m.nilbs")
        assert status == 2
        assert "every loss of the weight network is off: there is nothing to train for" in error
    assert os.listdir(out) == []


def test_train_solves_for_weights_where_none_are_given(assets, succeeds, out, quick_training):
    assert (
        succeeds("train", assets / "bar2.obj", assets / "bar.tgf", "--frames", 2, "-o", out / "m.nilbs")["frames"] == 2
    )


def test_train_takes_evenly_spaced_frames_of_a_motion(assets, succeeds, out, tmp_path, quick_training):
    motion = tmp_path / "motion.json"
    write_motion_json(motion, ["bone0", "bone1"], np.linspace(0, 1, 9)[:, None, None] * [[0], [1]], np.zeros((9, 2)))
    files = (assets / "bar2.obj", assets / "bar.tgf", "--weights", assets / "bar2-weights.npz")
    values = succeeds("train", *files, "--motion", motion, "--frames", 3, "-o", out / "m.nilbs")
    assert (values["frames"], values["motion"]) == (3, "motion.json")
    assert succeeds("info", out / "m.nilbs")["files"][0]["motion"]["original_frames"] == [0, 8]


def test_train_moves_as_the_files_do(assets, succeeds, nilbs, out, tmp_path, quick_training):
    """By all clips of the file that holds everything, by one, or by random motion on request."""
    c = load_character(assets / "bar3.obj", assets / "bar.tgf", assets / "bar3-weights.npz")
    clips = tuple(
        Clip(name, c.skeleton, np.linspace(0, seconds, 5), random_motion(c, frames=5, seed=int(seconds)).B)
        for name, seconds in (("walk", 1.0), ("run", 2.0))
    )
    write_bundle(Bundle(Mesh(c.V, c.F), c.skeleton, Influences.of_matrix(c.W), clips), [tmp_path / "bar.glb"])
    values = succeeds("train", tmp_path / "bar.glb", "-o", out / "m.nilbs")
    assert (values["motion"], values["frames"]) == ("bar.glb, walk, run", 10)
    assert load_model(out / "m.nilbs").motion.clips == (("walk", 0), ("run", 5))
    values = succeeds("train", tmp_path / "bar.glb", "--frames", 4, "-o", out / "m.nilbs")
    assert load_model(out / "m.nilbs").motion.frames.tolist() == [0, 5, 7, 9]
    values = succeeds("train", tmp_path / "bar.glb", "--clip", "run", "-o", out / "m.nilbs")
    assert (values["motion"], values["frames"]) == ("bar.glb, run", 5)
    values = succeeds("train", tmp_path / "bar.glb", "--random", "--frames", 3, "-o", out / "m.nilbs")
    assert (values["motion"].split(",")[0], values["frames"]) == ("random", 3)
    status, _, err = nilbs("train", tmp_path / "bar.glb", "--clip", "swim", "-o", out / "m.nilbs")
    assert status == 2
    assert err.endswith("bar.glb: there is no motion 'swim', but 'walk', 'run'\n")


@pytest.mark.parametrize("saved", [True, False])
def test_an_interrupted_training_reports_how_to_continue(assets, nilbs, out, monkeypatch, saved):
    def interrupted(*args, checkpoint, **options):
        if saved:
            Path(checkpoint).touch()
        raise KeyboardInterrupt

    monkeypatch.setattr("nilbs.models.fitting.fit", interrupted)
    files = (assets / "bar2.obj", assets / "bar.tgf", "--weights", assets / "bar2-weights.npz")
    status, text, err = nilbs("train", *files, "-o", out / "m.nilbs")
    assert (status, text) == (130, "")
    how = "; the same command with --resume goes on from the last checkpoint" if saved else ""
    assert err.splitlines()[-1] == f"nilbs: interrupted{how}"


def test_resume(assets, nilbs, succeeds, out, monkeypatch, quick_training):
    from nilbs.fields import training

    # A training is saved, and continues, where it refreshes its errors.
    monkeypatch.setattr("nilbs.fields.objective.REFRESH", 4)
    files = (
        assets / "bar2.obj",
        assets / "bar.tgf",
        "--weights",
        assets / "bar2-weights.npz",
        "--steps",
        8,
        "--occupancy-loss",
        1,
    )
    alone = succeeds("train", *files, "-o", out / "alone.nilbs")
    one_cycle = training.one_cycle

    def interrupted(step, *args):
        if step == 5:
            raise KeyboardInterrupt
        return one_cycle(step, *args)

    monkeypatch.setattr(training, "one_cycle", interrupted)
    assert nilbs("train", *files, "-o", out / "m.nilbs")[0] == 130
    assert sorted(os.listdir(out)) == ["alone.nilbs", "m.nilbs.checkpoint"]
    monkeypatch.setattr(training, "one_cycle", one_cycle)
    status, _, err = nilbs("train", *files, "--seed", 1, "-o", out / "m.nilbs", "--resume")
    assert status == 2
    assert "m.nilbs.checkpoint: belongs to a training with other files or settings" in err
    status, _, err = nilbs("train", *files, "-o", out / "m.nilbs")
    assert status == 2
    assert "m.nilbs.checkpoint holds a training that was stopped: go on with --resume, or remove it" in err
    continued = succeeds("train", *files, "-o", out / "m.nilbs", "--resume")
    assert continued["loss"] == pytest.approx(alone["loss"], rel=1e-6)
    assert sorted(os.listdir(out)) == ["alone.nilbs", "m.nilbs"]


def test_a_full_disk_names_the_model(assets, fails, out, quick_training):
    (out / "m.nilbs").symlink_to("/dev/full")
    files = (assets / "bar2.obj", assets / "bar.tgf", "--weights", assets / "bar2-weights.npz")
    assert fails("train", *files, "-o", out / "m.nilbs") == f"{out}/m.nilbs: {os.strerror(errno.ENOSPC)}"
    assert os.listdir(out) == ["m.nilbs"]


@pytest.mark.parametrize("quantity", ["occupancy", "distance"])
def test_query(assets, succeeds, out, d, rng, motion_file, quantity):
    model, points = assets / f"bar{d}.nilbs", out / "x.npy"
    x = rng.uniform([-1] * d, [5] + [2] * (d - 1), size=(50, d))
    np.save(points, x)
    option = ["--distance"] if quantity == "distance" else []
    values = succeeds("query", model, points, "--motion", motion_file, "--frame", 0, *option, "-o", out / "v.npy")
    v = read_npy(out / "v.npy")
    trained = load_model(model)
    rest = np.tile(np.eye(d + 1), (2, 1, 1))
    assert np.allclose(v, getattr(trained, quantity)(x, rest), atol=1e-6)
    assert (values["points"], values["quantity"]) == (50, quantity)
    inside = v < 0 if quantity == "distance" else v > 0.5
    assert values["inside"] == inside.sum()
    # The same points, moved with the character, get the same answers.
    x[:, 0] += 1
    np.save(points, x)
    succeeds("query", model, points, "--motion", motion_file, "--frame", 1, *option, "-o", out / "u.npy")
    assert np.allclose(read_npy(out / "u.npy"), v, atol=1e-5)


def test_query_of_no_point(assets, succeeds, out):
    np.save(out / "x.npy", np.zeros((0, 2)))
    assert succeeds("query", assets / "bar2.nilbs", out / "x.npy", "--frame", 2, "-o", out / "v.npy")["inside"] == 0
    assert read_npy(out / "v.npy").shape == (0,)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off", ".stl", ".3mf"])
def test_extract(assets, succeeds, out, d, motion_file, suffix):
    if d == 2 and suffix not in (".obj", ".ply"):
        pytest.skip("holds no outline")
    path = out / f"posed{suffix}"
    options = ("--motion", motion_file, "--frame", 1, "--resolution", 24, "-o", path)
    values = succeeds("extract", assets / f"bar{d}.nilbs", *options)
    U, F = read_mesh(path)
    assert (values["vertices"], values["facets"]) == (len(U), len(F))
    assert values["watertight"]
    assert U.shape[1] == F.shape[1] == d
    assert is_watertight(F)


def test_nothing_is_written_where_nothing_is_inside(assets, fails, out, monkeypatch):
    nothing = (np.zeros((0, 2)), np.zeros((0, 2), int))
    monkeypatch.setattr("nilbs.models.model.Model.extract", lambda *args, **options: nothing)
    line = fails("extract", assets / "bar2.nilbs", "--frame", 0, "-o", out / "v.obj")
    assert line.endswith("bar2.nilbs: nothing is inside in this pose on a grid of 128 cells: no surface")
    assert not os.listdir(out)


def test_extract_a_frame_of_the_training_motion(assets, nilbs, out):
    status, text, _ = nilbs("extract", assets / "bar2.nilbs", "--frame", 2, "-o", out / "a.obj")
    assert status == 0
    assert "watertight" in text


def test_evaluate(assets, succeeds, nilbs, out, d, monkeypatch):
    drawn = []
    monkeypatch.setattr("nilbs.figures.write_figures", lambda model, folder, **options: drawn.append(folder) or [])
    options = ("--points", 200, "--resolution", 8, "--seed", 3)
    scores = succeeds("evaluate", assets / f"bar{d}.nilbs", *options, "--out", out / "deep" / "er")
    assert (scores["schema"], scores["points"], scores["resolution"], scores["seed"]) == (1, 200, 8, 3)
    assert {"seen", "interpolated", "unseen", "far"} == scores["poses"].keys()
    assert sorted(os.listdir(out / "deep" / "er")) == ["report.html", "scores.json", "scores.txt", "worst.png"]
    assert drawn == [str(out / "deep" / "er")]
    status, text, _ = nilbs("evaluate", assets / f"bar{d}.nilbs", *options)
    assert status == 0
    assert text == (out / "deep" / "er" / "scores.txt").read_text()


def test_evaluate_reports_files_that_it_cannot_write_before_it_starts(assets, nilbs, out, monkeypatch):
    monkeypatch.setattr("nilbs.models.evaluation.evaluate", lambda *_, **__: pytest.fail("worked"))
    (out / "ghost.png").mkdir(parents=True)
    status, _, error = nilbs("evaluate", assets / "bar2.nilbs", "--out", out)
    assert status == 2
    assert "ghost.png" in error
    assert "folder" in error


def test_evaluate_scores_the_floor_beside_the_model(assets, succeeds, nilbs):
    options = ("--points", 100, "--resolution", 8, "--rows", "floor")
    scores = succeeds("evaluate", assets / "bar2.nilbs", *options)
    assert scores["rows"]["floor"].keys() == scores["poses"].keys()
    assert scores["rows"]["floor"]["seen"]["iou_bbox"]["mean"] == 1
    assert "floor seen" in nilbs("evaluate", assets / "bar2.nilbs", *options)[1]


@pytest.fixture
def whole(assets, tmp_path, d):
    """One file with the bar, its rig, its weights and a motion of four frames in a tenth of a second each."""
    from nilbs.characters.motion import Motion, random_motion

    c = load_character(assets / f"bar{d}.obj", assets / "bar.tgf", assets / f"bar{d}-weights.npz")
    moved = random_motion(c, frames=4, seed=3)
    motion = Motion(moved.B, moved.frames, "wave.bvh", np.arange(4) / 10, c.skeleton)
    path = tmp_path / "whole.glb"
    save_character(c, path, motion=motion)
    return path, motion


def test_train_on_one_file_that_holds_everything(whole, nilbs, out, quick_training):
    path, motion = whole
    status, _, err = nilbs("train", path, "--motion", path, "--frames", 3, "-o", out / "m.nilbs", "--json")
    assert status == 0, err
    assert f"{path}: its painted weights are used" in err
    model = load_model(out / "m.nilbs")
    assert np.abs(model.motion.B - motion.take(3).B).max() <= 1e-5
    assert np.abs(model.motion.times - [0, 0.2, 0.3]).max() <= 1e-6


def test_a_motion_is_read_before_weights_are_solved(assets, fails, out, tmp_path, monkeypatch):
    monkeypatch.setattr("nilbs.characters.character.solve_weights", None)
    (tmp_path / "bad.json").write_text('{"frames": [{"wing": [0, 0, 1]}]}')
    files = (assets / "bar2.obj", assets / "bar.tgf")
    line = fails("train", *files, "--motion", tmp_path / "bad.json", "-o", out / "m.nilbs")
    assert line == f"{tmp_path}/bad.json: frame 0: the rig has no bone 'wing'"


def test_extract_at_a_time_between_frames(assets, succeeds, whole, out, d):
    path, motion = whole
    files = (assets / f"bar{d}.nilbs", "--motion", path, "--resolution", 16)
    for seconds in (0.1, 0.15):
        succeeds("extract", *files, "--time", seconds, "-o", out / f"{seconds}.obj")
        U, _ = load_model(assets / f"bar{d}.nilbs").extract(motion.at(seconds=seconds), resolution=16)
        assert np.abs(read_mesh(out / f"{seconds}.obj")[0] - U).max() <= 1e-4
    succeeds("extract", *files, "--frame", 1, "-o", out / "frame.obj")
    assert np.abs(read_mesh(out / "frame.obj")[0] - read_mesh(out / "0.1.obj")[0]).max() <= 1e-4


def test_after_the_last_frame_the_pose_stays_and_a_line_reports_it(assets, nilbs, out):
    np.save(out / "x.npy", np.random.default_rng(0).uniform(-1, 2, (200, 2)))
    line = "nilbs: the motion of the model lasts from 0 to 0.0833333 s: the pose is that of its end\n"
    for option, value, printed in (("frame", 2, ""), ("time", 9, line)):
        words = ("query", assets / "bar2.nilbs", out / "x.npy", f"--{option}", value, "-o", out / f"{option}.npy")
        status, _, err = nilbs(*words)
        assert (status, err) == (0, printed)
    inside = np.load(out / "time.npy")
    np.testing.assert_array_equal(inside, np.load(out / "frame.npy"))
    assert 0 < (inside > 0.5).sum() < 200


def test_weights_of_a_group_of_one_file(assets, succeeds, out, bar):
    V, E, _, _ = bar(3)
    lines = ["o block", *(f"v {x} {y} {z + 9}" for x, y, z in V), *("f {} {} {}".format(*(row + 1)) for row in E)]
    lines += ["o bar", *(f"v {x} {y} {z}" for x, y, z in V), *("f {} {} {}".format(*(row + 55)) for row in E)]
    (out / "two.obj").write_text("\n".join(lines) + "\n")
    values = succeeds("weights", out / "two.obj", assets / "bar.tgf", "--group", "bar", "-o", out / "w.npz")
    assert values["vertices"] == 54
    alone = succeeds("weights", assets / "bar3.obj", assets / "bar.tgf", "-o", out / "alone.npz")
    assert np.abs(read_weights(out / "w.npz") - read_weights(out / "alone.npz")).max() <= 1e-12
    assert alone["notes"] == []


def test_weights_report_decisions(assets, nilbs, succeeds, out):
    lines = (assets / "bar3.obj").read_text().splitlines(keepends=True)
    (out / "open.obj").write_text("".join(lines[:-3]))
    values = succeeds("weights", out / "open.obj", assets / "bar.tgf")
    assert values["notes"]
    status, text, err = nilbs("weights", out / "open.obj", assets / "bar.tgf")
    assert status == 0
    assert all(f"nilbs: {note}" in err and note not in text for note in values["notes"])
