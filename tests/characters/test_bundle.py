"""Characters from files of every kind: whose parts are used, which vertices stay, and what is reported of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

import nilbs
from nilbs.characters.bundle import character_of, fit_together, load_animated, load_bundle, load_character
from nilbs.characters.character import Character, in_dimension
from nilbs.characters.motion import random_motion
from nilbs.characters.saving import save_character, write_bundle
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io import FileFormatError, read_bundle, write_mesh, write_tgf, write_weights
from nilbs.io.bundle import Bundle, Influences, Mesh

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
ASIDE = np.array([3.0, 0, 0])
RIG = skeleton_of_joints([[0.5, 0.5, 0.2], [0.5, 0.5, 0.6]], [-1, 0], ["low", "high"], ends={1: [0.5, 0.5, 0.9]})


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Volumes that are solved in a moment."""
    monkeypatch.setattr("nilbs.geometry.domain.SPACING", 0.06)
    monkeypatch.setattr("nilbs.geometry.domain.ELEMENTS", 3000)
    monkeypatch.setattr("nilbs.geometry.domain.RESOLUTIONS", (48,))


@pytest.fixture
def W(rng):
    return rng.dirichlet([1, 1], size=16)


@pytest.fixture
def folder(tmp_path, W):
    """Two cubes in groups of one file, `left` with the first eight vertices; a rig in `left`; a weight file of all."""
    lines = [f"v {x} {y} {z}" for x, y, z in [*CUBE, *(CUBE + ASIDE)]]
    for name, first in (("left", 1), ("right", 9)):
        lines += [f"g {name}", *("f " + " ".join(str(corner + first) for corner in quad) for quad in QUADS)]
    (tmp_path / "cubes.obj").write_text("\n".join(lines) + "\n")
    write_bundle(Bundle(skeleton=RIG, influences=Influences.of_matrix(W)), [tmp_path / "rig.txt"])
    write_tgf(tmp_path / "rig.tgf", RIG.C, RIG.BE)
    write_weights(tmp_path / "all.npz", W[:, ::-1])
    write_weights(tmp_path / "left.dmat", W[:8, ::-1])
    return tmp_path


@pytest.fixture
def lines():
    return []


def weights_of(bundle):
    """The matrix of a bundle's weights."""
    return bundle.influences.dense(*bundle.influences.shape, "a bundle")


def test_painted_weights_are_used(folder, W, lines):
    bundle = load_bundle([folder / "cubes.obj", folder / "rig.txt"], report=lines.append)
    assert np.abs(weights_of(bundle) - W).max() <= 1e-15
    assert bundle.skeleton.names == ("low", "high")
    assert lines == [f"{folder}/rig.txt: its painted weights are used"]


def test_solving_leaves_painted_weights_out(folder):
    assert load_bundle([folder / "cubes.obj", folder / "rig.txt"], solve=True).influences is None
    assert load_bundle([folder / "cubes.obj", folder / "rig.tgf"]).influences is None


def test_a_file_of_weights_replaces_painted_ones(folder, W):
    bundle = load_bundle([folder / "cubes.obj", folder / "rig.txt", folder / "all.npz"])
    assert np.abs(weights_of(bundle) - W[:, ::-1]).max() <= 1e-15


def test_weights_are_not_both_read_and_solved(folder):
    with pytest.raises(ValueError, match=r"solved for or read from .*, not both"):
        load_bundle([folder / "cubes.obj", folder / "rig.txt", folder / "all.npz"], solve=True)


@pytest.mark.parametrize("weights", [None, "all.npz", "left.dmat"])
def test_a_group_keeps_its_vertices_and_their_weights(folder, W, weights):
    given = None if weights is None else folder / weights
    bundle = load_bundle([folder / "cubes.obj", folder / "rig.txt"], weights=given, group="left")
    assert (bundle.mesh.V == CUBE).all()
    assert bundle.mesh.E.shape == (12, 3)
    assert np.abs(weights_of(bundle) - (W[:8] if weights is None else W[:8, ::-1])).max() <= 1e-15


def test_a_group_in_the_middle_of_the_file(folder, W):
    bundle = load_bundle([folder / "cubes.obj", folder / "rig.txt"], group="right")
    assert (bundle.mesh.V == CUBE + ASIDE).all()
    assert sorted(np.unique(bundle.mesh.E)) == list(range(8))
    assert np.abs(weights_of(bundle) - W[8:]).max() <= 1e-15


def test_a_flat_group_is_planar(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\ng floor\nf 2 3 4\n")
    assert load_bundle([tmp_path / "a.obj"]).mesh.V.shape == (4, 3)
    floor = load_bundle([tmp_path / "a.obj"], group="floor").mesh
    assert (floor.V.tolist(), floor.E.tolist()) == ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])


def test_an_unknown_group_names_those_there_are(folder):
    with pytest.raises(ValueError, match=r"cubes\.obj: the mesh has no group 'body'; .*'left', 'right'"):
        load_bundle([folder / "cubes.obj", folder / "rig.tgf"], group="body")


@pytest.mark.parametrize(("group", "counted"), [(None, "16 vertices and"), ("left", r"16 vertices \(8 in the group\)")])
def test_weights_of_another_mesh(folder, group, counted):
    write_weights(folder / "nine.dmat", np.ones((9, 2)))
    with pytest.raises(ValueError, match=f"the weights have 9 rows and 2 columns, but the mesh has {counted}"):
        load_bundle([folder / "cubes.obj", folder / "rig.txt", folder / "nine.dmat"], group=group)


def test_badly_painted_weights_are_repaired_with_a_note(folder, W, lines):
    W = W * 2
    W[3], W[8] = 0, [-0.5, 1.5]
    write_weights(folder / "all.npz", W)
    bundle = load_bundle([folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz"], report=lines.append)
    assert np.abs(weights_of(bundle).sum(axis=1) - 1).max() <= 1e-15
    assert weights_of(bundle)[8].tolist() == [0, 1]
    assert any((weights_of(bundle)[3] == weights_of(bundle)[near]).all() for near in (1, 2, 7))
    assert ["below zero" in line for line in lines] == [True, False, False]
    assert "15 of 16 vertices have weights that do not sum to one" in lines[1]
    assert "vertex 3 first" in lines[2]


def test_messages_count_vertices_as_the_file_does(folder, W, lines):
    W[10] = 0
    write_weights(folder / "all.npz", W)
    load_bundle([folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz"], group="right", report=lines.append)
    assert len(lines) == 1
    assert "1 of 8 vertices have no weight, vertex 10 first" in lines[0]


def test_weights_that_are_all_zero(folder):
    write_weights(folder / "all.npz", np.zeros((16, 2)))
    with pytest.raises(ValueError, match=r"cubes\.obj with .*rig\.tgf and .*all\.npz: no vertex has any weight"):
        load_bundle([folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz"])


def test_a_weight_of_a_vertex_that_does_not_exist(folder):
    (folder / "rig.txt").write_text("joints low 0 0 0\nroot low\nskin 16 low 1\n")
    with pytest.raises(FileFormatError, match=r"rig\.txt: a weight of vertex 16, but there are only 16"):
        load_bundle([folder / "cubes.obj", folder / "rig.txt"])


def test_one_file_that_holds_everything_is_read_once(tmp_path, characters, monkeypatch):
    c = characters[3]
    motion = random_motion(c, frames=4)
    save_character(c, tmp_path / "c.glb", motion=motion)
    calls = []
    monkeypatch.setattr("nilbs.characters.bundle.read_bundle", lambda *a, **k: calls.append(a) or read_bundle(*a, **k))
    read, moved = nilbs.load_animated(tmp_path / "c.glb", tmp_path / "c.glb")
    assert len(calls) == 1
    assert np.abs(read.V - c.V).max() <= 1e-6
    assert np.abs(read.W - c.W).max() <= 1e-6
    assert read.skeleton.names == c.skeleton.names
    assert read.skeleton.P.tolist() == c.skeleton.P.tolist()
    assert np.abs(moved.B - motion.B).max() <= 1e-5
    assert moved.source == "c.glb"


def test_the_order_of_files_does_not_matter(folder):
    names = ["cubes.obj", "rig.tgf", "all.npz"]
    expected = nilbs.load_character(*(folder / name for name in names)).arrays()
    for order in ([2, 0, 1], [1, 2, 0]):
        arrays = nilbs.load_character(*(folder / names[k] for k in order)).arrays()
        assert all((arrays[name] == expected[name]).all() for name in expected)


def test_weights_that_look_like_a_motion_are_given_by_name(folder, rng):
    W = rng.uniform(1, 2, (24, 2))  # 24 rows, none of which sums to one: transforms of two bones
    write_weights(folder / "odd.dmat", W)
    lines = [f"v {x} {y} {z}" for x, y, z in [*CUBE, *(CUBE + ASIDE), *(CUBE - ASIDE)]]
    (folder / "three.obj").write_text("\n".join([*lines, "f 1 2 4"]))
    files = [folder / "three.obj", folder / "rig.tgf"]
    assert load_bundle([*files, folder / "odd.dmat"]).taken[f"{folder}/odd.dmat"] == ["motion"]
    bundle = load_bundle(files, weights=folder / "odd.dmat")
    assert bundle.taken[f"{folder}/odd.dmat"] == ["weights"]
    assert np.abs(weights_of(bundle) - W / W.sum(axis=1, keepdims=True)).max() <= 1e-15


def test_files_that_bring_no_motion(folder):
    with pytest.raises(ValueError, match=r"cubes\.obj and .*rig\.tgf: there is no motion"):
        load_animated(folder / "cubes.obj", folder / "rig.tgf")


def test_weights_of_another_mesh_of_the_rigs_file_are_left_out(W, lines):
    mesh = Mesh(CUBE, np.array([[0, 1, 2]]))
    influences = Influences(np.arange(8), np.zeros(8, int), np.ones(8))
    own = Bundle(Mesh(CUBE + 1e-6, mesh.E), RIG, influences)
    bundle = fit_together({"a.obj": Bundle(mesh), "b.glb": own})
    assert (weights_of(bundle) == [1, 0]).all()
    assert bundle.taken == {"a.obj": ["mesh"], "b.glb": ["rig", "weights"]}
    other = Bundle(Mesh(CUBE[::-1], mesh.E), RIG, influences)
    assert fit_together({"a.obj": Bundle(mesh), "b.glb": other}, report=lines.append).influences is None
    assert "b.glb: its painted weights are of its own mesh, which is not the one given" in lines[0]


def test_notes_of_readers_are_reported_with_their_file(lines):
    mesh, rig = Bundle(Mesh(CUBE, np.array([[0, 1, 2]])), notes=("odd",)), Bundle(skeleton=RIG, notes=("bent",))
    fit_together({"a.obj": mesh, "b.txt": rig}, report=lines.append)
    assert lines == ["a.obj: odd", "b.txt: bent"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["cubes.obj"], r"cubes\.obj: there is no rig: give its file too"),
        (["rig.txt"], r"rig\.txt: there is no mesh: give its file too"),
        (["rig.txt", "all.npz"], r"rig\.txt and .*all\.npz: there is no mesh"),
        (["cubes.obj", "all.npz"], r"cubes\.obj and .*all\.npz: there is no rig"),
        (["cubes.obj", "flat.obj", "rig.txt"], r"cubes\.obj and .*flat\.obj both hold a mesh: leave one out"),
        (["curve.obj", "rig.txt"], r"curve\.obj: the file holds a curve of edges: a character's mesh is of triangles"),
        (["flat.obj", "rig.txt"], r"flat\.obj with .*rig\.txt: the mesh is flat \(z = 0\) but joint"),
    ],
)
def test_files_that_do_not_make_a_character(folder, names, message):
    write_mesh(folder / "flat.obj", [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    (folder / "curve.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 2 3\nl 3 1\n")
    with pytest.raises(ValueError, match=message):
        load_character(*(folder / name for name in names))


@pytest.mark.usefixtures("coarse_volumes")
def test_weights_solved_from_a_characters_skeleton_are_those_of_the_files(characters, tmp_path):
    """A rig with forks: the root leads to three bones at once."""
    c = characters[3]
    joints = [[-0.6, 0, 0], [0.6, 0, 0.1], [0.5, 0.1, -0.1], [0.4, -0.1, 0]]
    skeleton = skeleton_of_joints(joints, [-1, 0, 0, 0], ["root", "a", "b", "c"])
    ones = Influences.of_matrix(np.ones((len(c.V), 4)) / 4)
    write_bundle(Bundle(Mesh(c.V, c.F), skeleton, ones), [tmp_path / "c.obj", tmp_path / "c.txt"])
    bundle = load_bundle([tmp_path / "c.obj", tmp_path / "c.txt"])
    assert len(bundle.skeleton.forks) == 2
    expected = nilbs.solve_weights(c.V, c.F, bundle.skeleton).W
    character = character_of(bundle)
    np.testing.assert_array_equal(nilbs.solve_weights(c.V, c.F, character.skeleton).W, expected)
    # They do count.
    without = replace(bundle.skeleton, forks=np.zeros((0, 2), int))
    assert np.abs(nilbs.solve_weights(c.V, c.F, without).W - expected).max() > 0.1
    again = Character.of_arrays(character.arrays(), name="c", bones=character.skeleton.names).skeleton
    flat = in_dimension(replace(skeleton, C=skeleton.C * [1, 1, 0]), 2)
    for other in (again, skeleton.in_space(), flat, flat.in_space()):
        np.testing.assert_array_equal(other.forks, skeleton.forks)


@pytest.fixture
def makehuman(folder, W):
    """A rig whose joints are means of vertices of both groups, with the weights that it names."""
    joints = {"a": [0, 7], "b": [0, 15], "c": [8, 15]}
    bones = {
        "low": {"head": "a", "tail": "b", "parent": None},
        "high": {"head": "b", "tail": "c", "parent": "low"},
        "bare": {"head": "c", "tail": "a", "parent": "high"},
    }
    rig = {"name": "r", "bones": bones, "joints": joints, "weights_file": "rig.mhw"}
    (folder / "rig.mhskel").write_text(json.dumps(rig))
    weights = {name: [[v, float(W[v, b])] for v in range(16)] for b, name in enumerate(("low", "high"))}
    (folder / "rig.mhw").write_text(json.dumps({"name": "w", "weights": weights}))
    return folder


def test_joints_are_means_of_the_whole_mesh(makehuman, W, lines):
    bundle = load_bundle([makehuman / "cubes.obj", makehuman / "rig.mhskel"], group="left", report=lines.append)
    columns = [bundle.skeleton.names.index(name) for name in ("low", "high")]
    V = np.concatenate([CUBE, CUBE + ASIDE])
    a, b, c = V[[0, 7]].mean(axis=0), V[[0, 15]].mean(axis=0), V[[8, 15]].mean(axis=0)
    assert np.abs(bundle.skeleton.C[bundle.skeleton.BE[columns]] - [[a, b], [b, c]]).max() <= 1e-9
    assert np.abs(weights_of(bundle)[:, columns] - W[:8]).max() <= 1e-9
    assert any("rig.mhw, which lies beside it" in line for line in lines)


def test_weights_by_the_names_of_bones(makehuman, W, monkeypatch):
    (makehuman / "rig.mhw").rename(makehuman / "other.mhw")
    files = (makehuman / "cubes.obj", makehuman / "rig.mhskel")
    assert load_bundle(files, group="right").influences is None
    bundle = load_bundle([makehuman / "other.mhw", *files], group="right")
    columns = [bundle.skeleton.names.index(name) for name in ("low", "high")]
    assert np.abs(weights_of(bundle)[:, columns] - W[8:]).max() <= 1e-9
    calls = []
    monkeypatch.setattr("nilbs.characters.bundle.read_bundle", lambda *a, **k: calls.append(a) or read_bundle(*a, **k))
    by_option = load_bundle(files, weights=makehuman / "other.mhw", group="right")
    assert (weights_of(by_option) == weights_of(bundle)).all()
    assert len(calls) == 3


def test_errors_of_solving_name_the_files(folder):
    write_tgf(folder / "far.tgf", RIG.C * 1000 + 1e6, RIG.BE)
    with pytest.raises(ValueError, match=r"cubes\.obj with .*far\.tgf: "):
        load_character(folder / "cubes.obj", folder / "far.tgf")
