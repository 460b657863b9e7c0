"""Characters from files of every kind: whose weights are used, which vertices stay, and what is said about it."""

import json

import numpy as np
import pytest

import nilbs
from nilbs.characters.loading import fit_together, load_character, read_rigged_mesh
from nilbs.characters.saving import write_files
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io import FileFormatError, write_mesh, write_tgf, write_weights
from nilbs.io.bundle import Bundle, Influences, Mesh

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
ASIDE = np.array([3.0, 0, 0])
RIG = skeleton_of_joints([[0.5, 0.5, 0.2], [0.5, 0.5, 0.6]], [-1, 0], ["low", "high"], ends={1: [0.5, 0.5, 0.9]})


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
    write_files([tmp_path / "rig.txt"], skeleton=RIG, W=W)
    write_tgf(tmp_path / "rig.tgf", RIG.C, RIG.BE)
    write_weights(tmp_path / "all.npz", W[:, ::-1])
    write_weights(tmp_path / "left.dmat", W[:8, ::-1])
    return tmp_path


@pytest.fixture
def said():
    return []


def test_painted_weights_are_used(folder, W, said):
    rigged = read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", report=said.append)
    assert np.abs(rigged.W - W).max() <= 1e-15
    assert rigged.skeleton.names == ("low", "high")
    assert rigged.name == "cubes"
    assert said == [f"{folder}/rig.txt: its painted weights are used"]


def test_solving_leaves_painted_weights_out(folder):
    assert read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", solve=True).W is None
    assert read_rigged_mesh(folder / "cubes.obj", folder / "rig.tgf").W is None


def test_a_file_of_weights_replaces_painted_ones(folder, W):
    rigged = read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", folder / "all.npz")
    assert np.abs(rigged.W - W[:, ::-1]).max() <= 1e-15


def test_weights_are_not_both_read_and_solved(folder):
    with pytest.raises(ValueError, match=r"solved for or read from .*, not both"):
        read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", folder / "all.npz", solve=True)


@pytest.mark.parametrize("weights", [None, "all.npz", "left.dmat"])
def test_a_group_keeps_its_vertices_and_their_weights(folder, W, weights):
    given = None if weights is None else folder / weights
    rigged = read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", given, group="left")
    assert (rigged.V == CUBE).all()
    assert rigged.E.shape == (12, 3)
    assert np.abs(rigged.W - (W[:8] if weights is None else W[:8, ::-1])).max() <= 1e-15


def test_a_group_in_the_middle_of_the_file(folder, W):
    rigged = read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", group="right")
    assert (rigged.V == CUBE + ASIDE).all()
    assert sorted(np.unique(rigged.E)) == list(range(8))
    assert np.abs(rigged.W - W[8:]).max() <= 1e-15


def test_an_unknown_group_names_those_there_are(folder):
    with pytest.raises(ValueError, match=r"cubes\.obj with .*: the mesh has no group 'body'; .*'left', 'right'"):
        read_rigged_mesh(folder / "cubes.obj", folder / "rig.tgf", group="body")


@pytest.mark.parametrize(("group", "counted"), [(None, "16 vertices and"), ("left", r"16 vertices \(8 in the group\)")])
def test_weights_of_another_mesh(folder, group, counted):
    write_weights(folder / "nine.dmat", np.ones((9, 2)))
    with pytest.raises(ValueError, match=f"the weights have 9 rows and 2 columns, but the mesh has {counted}"):
        read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt", folder / "nine.dmat", group=group)


def test_what_was_painted_badly_is_mended_and_told(folder, W, said):
    W = W * 2
    W[3], W[8] = 0, [-0.5, 1.5]
    write_weights(folder / "all.npz", W)
    rigged = read_rigged_mesh(folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz", report=said.append)
    assert np.abs(rigged.W.sum(axis=1) - 1).max() <= 1e-15
    assert rigged.W[8].tolist() == [0, 1]
    assert any((rigged.W[3] == rigged.W[near]).all() for near in (1, 2, 7))
    assert ["below zero" in line for line in said] == [True, False, False]
    assert "15 of 16 vertices have weights that do not sum to one" in said[1]
    assert "vertex 3 first" in said[2]


def test_messages_count_vertices_as_the_file_does(folder, W, said):
    W[10] = 0
    write_weights(folder / "all.npz", W)
    read_rigged_mesh(folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz", group="right", report=said.append)
    assert len(said) == 1
    assert "1 of 8 vertices have no weight, vertex 10 first" in said[0]


def test_weights_that_are_all_zero(folder):
    write_weights(folder / "all.npz", np.zeros((16, 2)))
    with pytest.raises(ValueError, match=r"cubes\.obj with .*rig\.tgf and .*all\.npz: no vertex has any weight"):
        read_rigged_mesh(folder / "cubes.obj", folder / "rig.tgf", folder / "all.npz")


def test_a_weight_of_a_vertex_that_does_not_exist(folder):
    (folder / "rig.txt").write_text("joints low 0 0 0\nroot low\nskin 16 low 1\n")
    with pytest.raises(FileFormatError, match=r"rig\.txt: a weight of vertex 16, but there are only 16"):
        read_rigged_mesh(folder / "cubes.obj", folder / "rig.txt")


def test_one_file_that_holds_both(tmp_path, W, characters):
    c = characters[3]
    write_files([tmp_path / "c.glb"], mesh=Mesh(c.V, c.F), skeleton=c.skeleton, W=c.W)
    read = nilbs.load_character(tmp_path / "c.glb")
    assert np.abs(read.V - c.V).max() <= 1e-6
    assert np.abs(read.W - c.W).max() <= 1e-6
    assert read.skeleton.names == c.skeleton.names
    assert read.skeleton.P.tolist() == c.skeleton.P.tolist()


def test_weights_of_another_mesh_of_the_rigs_file_are_left_out(W, said):
    mesh = Mesh(CUBE, np.array([[0, 1, 2]]))
    influences = Influences(np.arange(8), np.zeros(8, int), np.ones(8))
    own = Bundle(Mesh(CUBE + 1e-6, mesh.E), RIG, influences)
    rigged = fit_together("a.obj", Bundle(mesh), "b.glb", own)
    assert (rigged.W == [1, 0]).all()
    other = Bundle(Mesh(CUBE[::-1], mesh.E), RIG, influences)
    assert fit_together("a.obj", Bundle(mesh), "b.glb", other, report=said.append).W is None
    assert "b.glb: its painted weights are of its own mesh, which is not the one given" in said[0]


def test_notes_of_readers_are_told_with_their_file(said):
    mesh, rig = Bundle(Mesh(CUBE, np.array([[0, 1, 2]])), notes=("odd",)), Bundle(skeleton=RIG, notes=("bent",))
    fit_together("a.obj", mesh, "b.txt", rig, report=said.append)
    assert said == ["a.obj: odd", "b.txt: bent"]


@pytest.mark.parametrize(
    ("mesh", "rig", "message"),
    [
        ("cubes.obj", None, r"cubes\.obj: the file holds no rig: give its file after the mesh"),
        ("rig.txt", "rig.txt", r"rig\.txt: the file holds no mesh"),
        ("rig.txt", None, r"rig\.txt: the file holds no mesh"),
        ("cubes.obj", "cubes.obj", r"cubes\.obj: the file holds no rig"),
        ("cubes.obj", "all.npz", r"all\.npz: the file holds weights of vertices and no mesh or rig"),
        ("all.npz", "rig.txt", r"all\.npz: the file holds weights of vertices and no mesh or rig"),
        ("curve.obj", "rig.txt", r"curve\.obj: the file holds a curve of edges: a character's mesh is of triangles"),
        ("flat.obj", "rig.txt", r"flat\.obj with .*rig\.txt: the mesh is flat \(z = 0\) but joint"),
    ],
)
def test_files_that_do_not_make_a_character(folder, mesh, rig, message):
    write_mesh(folder / "flat.obj", [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    (folder / "curve.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 2 3\nl 3 1\n")
    with pytest.raises(ValueError, match=message):
        read_rigged_mesh(folder / mesh, None if rig is None else folder / rig)


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


def test_joints_are_means_of_the_whole_mesh(makehuman, W, said):
    rigged = read_rigged_mesh(makehuman / "cubes.obj", makehuman / "rig.mhskel", group="left", report=said.append)
    columns = [rigged.skeleton.names.index(name) for name in ("low", "high")]
    V = np.concatenate([CUBE, CUBE + ASIDE])
    a, b, c = V[[0, 7]].mean(axis=0), V[[0, 15]].mean(axis=0), V[[8, 15]].mean(axis=0)
    assert np.abs(rigged.skeleton.C[rigged.skeleton.BE[columns]] - [[a, b], [b, c]]).max() <= 1e-9
    assert np.abs(rigged.W[:, columns] - W[:8]).max() <= 1e-9
    assert any("rig.mhw, which lies beside it" in line for line in said)


def test_weights_by_the_names_of_bones(makehuman, W):
    (makehuman / "rig.mhw").rename(makehuman / "other.mhw")
    files = (makehuman / "cubes.obj", makehuman / "rig.mhskel")
    assert read_rigged_mesh(*files, group="right").W is None
    rigged = read_rigged_mesh(*files, makehuman / "other.mhw", group="right")
    columns = [rigged.skeleton.names.index(name) for name in ("low", "high")]
    assert np.abs(rigged.W[:, columns] - W[8:]).max() <= 1e-9


def test_errors_of_solving_name_the_files(folder):
    write_tgf(folder / "far.tgf", RIG.C * 1000 + 1e6, RIG.BE)
    with pytest.raises(ValueError, match=r"cubes\.obj with .*far\.tgf: "):
        load_character(folder / "cubes.obj", folder / "far.tgf")
