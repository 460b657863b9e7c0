"""`nilbs weights NEW --from HERO`: the weights, and the rig, of a mesh that fits."""

import numpy as np
import pytest

from nilbs.characters.bundle import load_bundle
from nilbs.io import read_mesh, read_weights, write_mesh, write_weights


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.fixture
def hero(assets, out, succeeds):
    """The bar in d dimensions with its rig and weights in one file."""

    def write(d):
        files = [assets / name for name in (f"bar{d}.obj", "bar.tgf", f"bar{d}-weights.npz")]
        succeeds("convert", *files, "-o", out / "hero.glb")
        return out / "hero.glb"

    return write


@pytest.mark.parametrize("suffix", [".npz", ".dmat", ".glb"])
def test_a_mesh_that_fits_takes_weights_and_rig(assets, hero, succeeds, out, d, suffix):
    V, E = read_mesh(assets / f"bar{d}.obj")
    W = read_weights(assets / f"bar{d}-weights.npz")
    # The same bar with its vertices in another order, and far away a triangle that nothing matches.
    stray = np.eye(3)[:, :d] + 50 * np.eye(3)[1, :d]
    write_mesh(out / "new.obj", np.concatenate([V[::-1], stray]), np.vstack([len(V) - 1 - E, len(V) + np.arange(3)]))
    path = out / f"new{suffix}"
    values = succeeds("weights", out / "new.obj", "--from", hero(d), "-o", path)
    assert (values["vertices"], values["matched"], values["filled"], values["closest"]) == (len(V) + 3, len(V), 0, 3)
    assert (values["bones"], values["output"]) == (2, str(path))
    (note,) = (note for note in values["notes"] if "no match" in note)
    assert f"3 of {len(V) + 3} vertices, with 1 of 2 pieces," in note
    if suffix == ".glb":
        written = load_bundle([path])
        found = written.influences.dense(*written.influences.shape, path)
        assert written.skeleton.names == load_bundle([out / "hero.glb"]).skeleton.names
        np.testing.assert_allclose(written.mesh.V[: len(V)], V[::-1], atol=1e-6)
    else:
        found = read_weights(path)
    assert found.shape == (len(V) + 3, 2)
    np.testing.assert_allclose(found[: len(V)], W[::-1], atol=1e-6)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)


def test_separate_files_and_groups(assets, succeeds, out):
    V, E = read_mesh(assets / "bar3.obj")
    lines = [f"v {x} {y} {z}" for x, y, z in np.concatenate([V, V + np.eye(3)[2]])]
    for group, first in (("body", 1), ("cloth", 1 + len(V))):
        lines += [f"g {group}", *(f"f {a} {b} {c}" for a, b, c in E + first)]
    (out / "both.obj").write_text("\n".join(lines) + "\n")
    W = read_weights(assets / "bar3-weights.npz")
    write_weights(out / "w.npz", np.concatenate([W, W[:, ::-1]]))
    source = ("--from", out / "both.obj", assets / "bar.tgf", out / "w.npz", "--from-group", "body")
    values = succeeds("weights", out / "both.obj", "--group", "body", *source, "-o", out / "new.npz")
    assert values["matched"] == len(V)
    np.testing.assert_allclose(read_weights(out / "new.npz"), W, atol=1e-9)
    cloth = succeeds("weights", out / "both.obj", "--group", "cloth", *source)
    assert cloth["matched"] < cloth["vertices"] == len(V)


def test_a_mesh_that_is_inside_out(assets, hero, succeeds, out):
    V, E = read_mesh(assets / "bar3.obj")
    write_mesh(out / "inner.obj", V, E[:, ::-1])
    files = (out / "inner.obj", "--from", hero(3))
    assert succeeds("weights", *files)["matched"] == 0
    assert succeeds("weights", *files, "--both-sides")["matched"] == len(V)


def test_what_the_new_mesh_s_file_also_holds_is_left_out(hero, succeeds):
    path = hero(3)
    values = succeeds("weights", path, "--from", path)
    assert f"{path}: only its mesh is used" in values["notes"]


def test_a_flat_cloth_of_a_solid_body(hero, succeeds, out):
    write_mesh(out / "flat.obj", np.array([[1.0, 0.2], [3, 0.2], [2, 0.8]]), np.array([[0, 1, 2]]))
    assert succeeds("weights", out / "flat.obj", "--from", hero(3), "-o", out / "w.npz")["vertices"] == 3
    np.testing.assert_allclose(read_weights(out / "w.npz")[:2], np.eye(2), atol=1e-6)


def test_solved_weights_go_into_a_rigged_file(assets, succeeds, out):
    succeeds("weights", assets / "bar3.obj", assets / "bar.tgf", "-o", out / "bar.glb")
    solved = load_bundle([out / "bar.glb"]).influences
    assert solved.shape == (len(read_mesh(assets / "bar3.obj")[0]), 2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bar3.obj", "--from", "no.glb"], "no.glb: No such file or directory"),
        (["no.obj", "--from", "bar3.obj"], "no.obj: No such file or directory"),
        (["bar.tgf", "--from", "bar3.obj", "bar.tgf"], "bar.tgf: there is no mesh: give its file too"),
        (["bar3.obj", "--from", "bar3.obj"], "bar3.obj: there is no rig: give its file too"),
        (["bar3.obj", "--from", "bar3.obj", "bar.tgf"], "bar.tgf: there are no weights: give their file too"),
        (
            ["bar3.obj", "--from", "bar2.obj", "bar.tgf", "bar2-weights.npz"],
            "the mesh has 3 dimensions but the rig has 2",
        ),
        (["bar3.obj", "--from", "bar3.obj", "bar.tgf", "bar2-weights.npz"], "the weights have 27 rows"),
        (["curve.obj", "--from", "bar2.obj", "bar.tgf", "bar2-weights.npz"], "E must be (m, 3)"),
        (["bar3.obj", "--from", "bar3.obj", "--method", "igl"], "--method is for solving"),
        (["bar3.obj", "bar.tgf", "--both-sides"], "--both-sides is for the weights of another mesh"),
        (["bar3.obj", "bar.tgf", "--from-group", "body"], "--from-group is for the weights of another mesh"),
        (["bar3.obj", "--from", "w.npz", "-o", "w.npz"], "w.npz: this file is read too"),
        (["bar3.obj", "--from", "bar.tgf", "-o", "w.csv"], "w.csv: the file name must end in .npz or .dmat or .glb"),
    ],
)
def test_a_mistake_is_named(assets, fails, tmp_path, monkeypatch, words, message):
    for path in assets.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "w.npz").touch()
    (tmp_path / "curve.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3\n")
    monkeypatch.chdir(tmp_path)
    assert message in fails("weights", *words)
