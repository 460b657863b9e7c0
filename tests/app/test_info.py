import json

import numpy as np
import pytest

from nilbs.io import write_dmat, write_mesh, write_motion_json, write_tgf, write_transforms, write_weights

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_F = np.array([triangle for a, b, c, e in SIDES for triangle in ([a, b, c], [a, c, e])])


@pytest.fixture
def mesh(tmp_path, succeeds):
    def report(V, F):
        write_mesh(tmp_path / "a.obj", V, F)
        values = succeeds("info", tmp_path / "a.obj")
        assert values["problems"] == []
        return values["files"][0]

    return report


def test_a_sound_cube(mesh):
    report = mesh(2 * CUBE, CUBE_F)
    expected = {"kind": "mesh", "d": 3, "vertices": 8, "facets": 12, "L": 2, "watertight": True, "components": 1}
    expected |= {"isolated_vertices": 0, "degenerate_facets": 0, "duplicate_facets": 0, "coincident_vertices": 0}
    expected |= {"lower": [0, 0, 0], "upper": [2, 2, 2], "orientation": "outward", "problems": []}
    assert report["volume"] == pytest.approx(8)
    assert {name: report[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("V", "F", "problem"),
    [
        (CUBE, CUBE_F[:, ::-1], "the surface is inside out"),
        (CUBE, CUBE_F[1:], "the surface is not closed: 3 of its edges belong to one facet only"),
        (CUBE, np.concatenate([CUBE_F[:1, ::-1], CUBE_F[1:]]), "the surface is not consistently oriented"),
        (CUBE, np.concatenate([CUBE_F, CUBE_F[:1]]), "1 of 13 triangles repeat another"),
        (CUBE, np.concatenate([CUBE_F, CUBE_F[:1]]), "the surface is not manifold: 3 of its edges"),
        (
            np.concatenate([CUBE, [[0, 0, 0.5]]]),
            np.concatenate([CUBE_F, [[0, 1, 8]]]),
            "1 of 13 triangles are degenerate, number 12 first",
        ),
        (np.concatenate([CUBE, [[5, 5, 5]]]), CUBE_F, "1 of 9 vertices belong to no facet, number 8 first"),
        (np.concatenate([CUBE, CUBE[:1]]), CUBE_F, "1 vertices lie exactly on another"),
        (CUBE * [1, 1, 0] + [0, 0, 1], CUBE_F, "no extent along axis 2"),
    ],
)
def test_what_is_wrong_with_a_cube(mesh, V, F, problem):
    assert any(found.startswith(problem) for found in mesh(V, F)["problems"])


def test_two_pieces(mesh):
    assert mesh(np.concatenate([CUBE, CUBE + 3]), np.concatenate([CUBE_F, CUBE_F + 8]))["components"] == 2


def test_a_flat_mesh(mesh, bar):
    V, T, _, _ = bar(2)
    report = mesh(V, np.concatenate([T, [[0, 1, 2]]]))
    assert (report["d"], report["triangles"], report["facets"]) == (2, 33, 20)
    assert (report["watertight"], report["orientation"], report["area"]) == (True, "outward", pytest.approx(4))
    assert report["problems"] == ["1 of 33 triangles have no area"]


def test_a_curve(mesh):
    report = mesh(CUBE[::2, :2] + [[0, 0], [0, 0], [0, 0], [1, 0]], [[0, 1], [1, 3], [3, 2]])
    assert (report["d"], report["facets"], report["watertight"]) == (2, 3, False)
    assert report["problems"][0] == "the surface is not closed: 2 of its ends belong to one facet only"


def test_a_rig(tmp_path, succeeds):
    C = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 1], [5, 5, 5], [6, 5, 5], [6.001, 5, 5], [9, 9, 9], [9, 9, 9.0]])
    write_tgf(tmp_path / "a.tgf", C, [[0, 1], [1, 2], [3, 4], [4, 5]])
    report = succeeds("info", tmp_path / "a.tgf")["files"][0]
    assert (report["kind"], report["d"], report["joints"], report["bones"], report["roots"]) == ("rig", 3, 8, 4, 2)
    assert report["shortest_bone"] == pytest.approx(0.001)
    assert report["longest_bone"] == pytest.approx(5**0.5)
    assert report["problems"] == [
        "2 joints belong to no bone, joint 6 first",
        "the rig is 2 separate skeletons",
        "bone 3 is very short: 0.001",
        "1 joints lie exactly on another joint",
    ]


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_weights(tmp_path, succeeds, suffix):
    W = np.full((24, 2), 0.5)  # 24 rows: a motion of two bones, if the numbers did not tell otherwise
    W = np.hstack([W, np.zeros((24, 1))])
    path = tmp_path / f"a{suffix}"
    write_weights(path, W)
    report = succeeds("info", path)["files"][0]
    assert (report["kind"], report["shape"], report["row_sums"]) == ("weights", [24, 3], [1, 1])
    assert report["problems"] == ["1 bones move no vertex, bone 2 first"]
    W[3] = 0
    W[5] = [1.5, -0.25, 0]
    write_weights(path, W)
    report = succeeds("info", path)["files"][0]
    assert (report["min"], report["max"], report["zero_rows"], report["row_sum_error"]) == (-0.25, 1.5, 1, 1)
    assert report["problems"][:3] == [
        "weights leave 0 to 1: they run from -0.25 to 1.5",
        "2 of 24 rows do not sum to one; row 3 sums to 0",
        "1 rows are all zero, row 3 first",
    ]


@pytest.fixture
def turning(tmp_path, bar):
    """Files of a rig of two bones and of a motion of its second bone by 0.5 rad, as transforms and by name."""
    from nilbs.geometry.kinematics import forward_kinematics

    _, _, C, BE = bar(2)
    theta = np.zeros((4, 2, 3))
    theta[1:, 1, 2] = 0.5
    write_tgf(tmp_path / "rig.tgf", C, BE)
    write_transforms(tmp_path / "motion.dmat", forward_kinematics(C, BE, np.array([-1, 0]), theta))
    write_motion_json(tmp_path / "motion.json", ["bone0", "bone1"], theta, np.zeros((4, 3)))
    return tmp_path


@pytest.mark.parametrize("name", ["motion.dmat", "motion.json"])
def test_a_motion(turning, succeeds, name):
    report = succeeds("info", turning / name)["files"][0]
    assert (report["kind"], report["frames"], report["bones"]) == ("motion", 4, 2)
    assert report["rms_local_rotation"] is None
    assert report["problems"] == []
    values = succeeds("info", turning / name, turning / "rig.tgf")
    assert values["files"][0]["rms_local_rotation"] == pytest.approx(0.5 * (3 / 4) ** 0.5)
    assert values["problems"] == []


def test_a_motion_that_is_not_rigid(turning, succeeds):
    B = np.tile(np.eye(4), (3, 2, 1, 1))
    B[1, 1, 0, 0] = 2
    B[2, 0, 1, 1] = -1
    write_transforms(turning / "motion.dmat", B)
    report = succeeds("info", turning / "motion.dmat", turning / "rig.tgf")["files"][0]
    assert (report["rotation_error"], report["rest_frames"], report["rms_local_rotation"]) == (3, 1, None)
    assert report["problems"] == [
        "not a rotation: bone 1 in frame 1 scales or shears, by 3",
        "bone 0 in frame 2 is mirrored",
    ]


def test_points(tmp_path, succeeds):
    np.save(tmp_path / "x.npy", np.zeros((5, 3)))
    assert succeeds("info", tmp_path / "x.npy")["files"][0] == {
        "file": str(tmp_path / "x.npy"),
        "kind": "points",
        "shape": [5, 3],
        "problems": [],
    }
    np.save(tmp_path / "x.npy", np.zeros(5))
    assert succeeds("info", tmp_path / "x.npy")["files"][0]["problems"] == ["points are rows of 2 or 3 coordinates"]


def test_a_model(assets, succeeds, d):
    report = succeeds("info", assets / f"bar{d}.nilbs")["files"][0]
    assert (report["kind"], report["d"], report["mesh"]["vertices"]) == ("model", d, {2: 27, 3: 54}[d])
    assert report["rig"]["bones"] == 2
    assert report["weights"]["shape"] == [{2: 27, 3: 54}[d], 2]
    assert (report["motion"]["frames"], report["motion"]["original_frames"]) == (3, [0, 2])
    assert report["motion"]["rms_local_rotation"] == pytest.approx(0.4)
    assert report["training"]["steps"] == 2
    assert report["problems"] == []


def test_files_that_belong_together(assets, succeeds, d):
    files = (assets / f"bar{d}.obj", assets / "bar.tgf", assets / f"bar{d}-weights.npz")
    values = succeeds("info", *files)
    assert [report["kind"] for report in values["files"]] == ["mesh", "rig", "weights"]
    assert [report["problems"] for report in values["files"]] == [[], [], []]
    assert values["problems"] == []


def test_files_that_do_not_belong_together(turning, succeeds, bar):
    a = {name: turning / name for name in ("a.obj", "rig.tgf", "far.tgf", "w.npz", "one.dmat", "named.json", "x.npy")}
    V, T, C, BE = bar(2)
    write_mesh(a["a.obj"], V, T)
    write_tgf(a["rig.tgf"], C + np.array([0, 0.6, 0]), BE)
    write_tgf(a["far.tgf"], C * [100, 1, 1], BE)
    write_weights(a["w.npz"], np.full((9, 4), 0.25))
    write_transforms(a["one.dmat"], np.eye(4)[None, None])
    write_motion_json(a["named.json"], ["head"], np.zeros((1, 1, 3)), np.zeros((1, 3)))
    np.save(a["x.npy"], np.zeros((1, 3)))
    problems = [p.replace(f"{turning}/", "") for p in succeeds("info", *a.values())["problems"]]
    for expected in [
        "w.npz and a.obj: weights of 9 vertices, but the mesh has 27",
        "w.npz and rig.tgf: weights of 4 bones, but the rig has 2",
        "rig.tgf and a.obj: 3 joints lie outside the mesh's box, joint 0 first",
        "far.tgf and a.obj: the rig lies outside the mesh",
        "one.dmat and rig.tgf: a motion of 1 bones, but the rig has 2",
        "named.json and rig.tgf: the rig has no bone 'head'",
        "named.json and a.obj: a motion in 3 dimensions, but the mesh has 2",
        "x.npy and a.obj: points of shape (1, 3), but the mesh has d = 2",
    ]:
        assert any(problem.startswith(expected) for problem in problems), (expected, problems)


def test_as_a_table(assets, nilbs, tmp_path):
    write_mesh(tmp_path / "open.obj", CUBE, CUBE_F[1:])
    status, text, err = nilbs("info", tmp_path / "open.obj", assets / "bar.tgf")
    assert (status, err) == (0, "")
    lines = text.splitlines()
    assert lines[0] == str(tmp_path / "open.obj")
    assert "  problem: the surface is not closed: 3 of its edges belong to one facet only" in lines
    assert "  no problem found" in lines
    assert lines[-2] == "together"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "v 0 0 1\nv 0 nan 0\n", "a.obj:2: 'nan' is not a finite number"),
        ("a.tgf", "1 0 0 0\n#\n", "a.tgf: the rig has no bone"),
        ("a.dmat", "3 100000000\n1\n", "a.dmat:1: 100000000 rows of 3 columns do not fit in"),
        ("a.npz", "hello", "a.npz: damaged .npz file"),
        ("a.json", "[" * 100_000, "a.json: the JSON is nested too deep"),
        ("a.nilbs", "hello", "a.nilbs: "),
        ("a.txt", "hello", "a.txt: the file name must end in"),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path, fails, name, content, message):
    (tmp_path / name).write_text(content)
    assert message in fails("info", tmp_path / name)


def test_a_matrix_that_is_neither_weights_nor_a_motion(tmp_path, succeeds):
    write_dmat(tmp_path / "a.dmat", np.ones((5, 5)))
    report = succeeds("info", tmp_path / "a.dmat")["files"][0]
    assert report["kind"] == "weights"
    assert report["problems"] == ["5 of 5 rows do not sum to one; row 0 sums to 5"]
    assert json.dumps(report)
