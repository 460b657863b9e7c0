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
    expected |= {
        "isolated_vertices": 0,
        "degenerate_facets": 0,
        "duplicate_facets": 0,
        "seam_vertices": 0,
        "welded_vertices": 8,
    }
    expected |= {"boundary_edges": 0, "nonmanifold_edges": 0}
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
        (CUBE * [1, 1, 0] + [0, 0, 1], CUBE_F, "no extent along axis 2"),
        (
            np.concatenate([CUBE, [[0, 0, 0.5]]]),
            np.concatenate([[[0, 8, 3], [8, 1, 3]], CUBE_F[1:]]),
            "1 vertices lie on the edge of a neighbour (T-junctions), number 8 first",
        ),
        (
            np.concatenate([CUBE, CUBE + 0.5]),
            np.concatenate([CUBE_F, CUBE_F + 8]),
            "the surface runs into itself: 18 pairs of triangles touch or cross, numbers ",
        ),
        (
            np.concatenate([CUBE, CUBE + 1]),
            np.array([*range(8), 7, *range(9, 16)])[np.concatenate([CUBE_F, CUBE_F + 8])],
            "1 vertices are where parts only touch, number 7 first",
        ),
        (
            np.concatenate([CUBE, CUBE + 3]),
            np.concatenate([CUBE_F[:, ::-1], CUBE_F + 8]),
            "1 closed parts are inside out",
        ),
    ],
)
def test_defects_of_a_cube(mesh, V, F, problem):
    assert any(found.startswith(problem) for found in mesh(V, F)["problems"])


def test_a_seam_is_no_problem(mesh):
    """Two quads that meet along an edge whose vertices stand in the file twice, for a texture's seam."""
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0], [2, 0, 1], [2, 1, 1], [1, 1, 0.0]])
    report = mesh(V, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    assert (report["vertices"], report["welded_vertices"], report["seam_vertices"]) == (8, 6, 4)
    assert (report["components"], report["boundary_edges"], report["holes"]) == (1, 6, 1)
    assert report["problems"] == ["the surface is not closed: 6 of its edges belong to one facet only"]


def test_a_tangle(mesh, monkeypatch):
    monkeypatch.setattr("nilbs.geometry.intersections._ENOUGH", 1)
    V, F = np.concatenate([CUBE, CUBE + 0.5]), np.concatenate([CUBE_F, CUBE_F + 8])
    assert mesh(V, F)["problems"][0].startswith("the surface runs into itself: more than ")
    monkeypatch.setattr("nilbs.geometry.intersections._PAIRS_PER_FACET", 0)
    assert mesh(CUBE, CUBE_F)["problems"][0].startswith("too many triangles lie in one place")


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
    assert report["point_handles"] == 2
    assert report["names"] == ["point0", "point1", "bone0", "bone1", "bone2", "bone3"]
    assert report["notes"] == [
        "joints of no bone are point handles, with weights of their own (2): point0 (joint 7), point1 (joint 8)"
    ]
    assert report["problems"] == [
        "the rig is 2 separate skeletons",
        "bone 5 (bone3) is very short: 0.001",
        "1 joints lie on another joint, joint 7 first",
    ]


def test_tips_that_exporters_add_are_no_problem(tmp_path, succeeds, bar):
    """Joints that only mark where bones end: outside the mesh, on one another, without weights."""
    V, F, C, _ = bar(3)
    write_mesh(tmp_path / "a.obj", V, F)
    joints = {"hip": C[0], "arm": C[1], "arm_end": [9, 9, 9], "arm_end_tip": [9, 9, 9], "HipNub": C[0]}
    parents = {"arm": "hip", "arm_end": "arm", "arm_end_tip": "arm_end", "HipNub": "hip"}
    lines = [f"joints {name} {x} {y} {z}" for name, (x, y, z) in joints.items()]
    lines += ["root hip", *(f"hier {parent} {child}" for child, parent in parents.items())]
    lines += [f"skin {v} {'hip' if x < 2 else 'arm'} 1" for v, x in enumerate(V[:, 0])]
    (tmp_path / "a_rig.txt").write_text("\n".join(lines).replace("arm_end", "Arm_end"))
    values = succeeds("info", tmp_path / "a.obj", tmp_path / "a_rig.txt")
    assert values["files"][1]["names"] == ["hip", "arm", "Arm_end", "Arm_end_tip", "HipNub"]
    assert [report["problems"] for report in values["files"]] == [[], [], []]
    assert values["problems"] == []
    # Other joints are.
    (tmp_path / "a_rig.txt").write_text("\n".join(lines).replace("arm_end", "Tail").replace("HipNub", "hat"))
    values = succeeds("info", tmp_path / "a.obj", tmp_path / "a_rig.txt")
    assert values["files"][1]["problems"] == [
        "bone 2 (Tail) is very short: 0",
        "1 joints lie on another joint, joint 4 first",
    ]
    assert values["files"][2]["problems"] == ["2 bones move no vertex, bone 2 first"]
    assert len(values["problems"]) == 2


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_weights(tmp_path, succeeds, suffix):
    W = np.full((24, 2), 0.5)  # 24 rows could be a motion of two bones; the numbers show weights
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
    assert (report["min"], report["max"], report["zero_rows"], report["row_sum_error"]) == (-0.25, 1.5, 1, 0.25)
    assert report["problems"][:3] == [
        "weights leave 0 to 1: they run from -0.25 to 1.5",
        "1 of 23 vertices have weights that do not sum to one; those of vertex 5 sum to 1.25",
        "1 of 24 vertices have no weight, vertex 3 first",
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
        "rig.tgf and a.obj: the rig's box lies beside the mesh's: moved by (0, -0.6) its joints would meet it",
        "far.tgf and a.obj: the rig lies outside the mesh",
        "one.dmat and rig.tgf: a motion of 1 bones, but the rig has 2",
        "named.json and rig.tgf: the rig has no bone 'head'",
        "named.json and a.obj: a motion in 3 dimensions, but the mesh has 2",
        "x.npy and a.obj: points of shape (1, 3), but the mesh has d = 2",
    ]:
        assert any(problem.startswith(expected) for problem in problems), (expected, problems)


def test_a_rig_in_another_unit(turning, succeeds, bar):
    V, F, C, BE = bar(3)
    write_mesh(turning / "a.off.obj", V, F)
    write_tgf(turning / "cm.tgf", C * 100, BE)
    problems = succeeds("info", turning / "a.off.obj", turning / "cm.tgf")["problems"]
    assert len(problems) == 2
    assert problems[0].endswith("bring both to the same unit and frame")
    assert problems[1].endswith("with its joints divided by 100, 3 of 3 lie inside the mesh instead of 0")


def test_a_rig_that_partly_lies_outside(turning, succeeds, bar):
    V, F, C, BE = bar(3)
    write_mesh(turning / "a.obj", V, F)
    write_tgf(turning / "rig.tgf", np.concatenate([C, [[2, 0.5, 0.7], [2, 0.5, 0.9]]]), [*BE, [3, 4]])
    assert [p.split(": ", 1)[1] for p in succeeds("info", turning / "a.obj", turning / "rig.tgf")["problems"]] == [
        "2 of 5 joints lie outside the mesh, joint 3 first",
        "1 of 3 bones have no part inside the mesh: bone2",
    ]


@pytest.mark.parametrize("suffix", [".off", ".stl", ".obj"])
def test_a_group_of_a_mesh_in_other_formats(tmp_path, succeeds, fails, suffix):
    path = tmp_path / f"a{suffix}"
    if suffix == ".obj":
        write_mesh(path, CUBE, CUBE_F)
        path.write_text(path.read_text().replace("f", "o cube\nf", 1) + "g open\nf 1 2 4\n")
    elif suffix == ".off":
        rows = [" ".join(map(str, row)) for row in (*CUBE.tolist(), *([3, *row] for row in CUBE_F.tolist()))]
        path.write_text("\n".join(["OFF", "8 12 0", *rows]))
    else:
        rows = [f"vertex {x} {y} {z}" for x, y, z in CUBE[CUBE_F].reshape(-1, 3).tolist()]
        loops = ["\n".join(["outer loop", *rows[i : i + 3], "endloop"]) for i in range(0, 36, 3)]
        path.write_text("\n".join(["solid cube", *loops, "endsolid"]))
    report = succeeds("info", path)["files"][0]
    assert report["watertight"] == (suffix != ".obj")
    assert report.get("groups", []) == {".off": [], ".stl": ["cube"], ".obj": ["cube", "open"]}[suffix]
    if suffix != ".off":
        report = succeeds("info", path, "--group", "open" if suffix == ".obj" else "cube")["files"][0]
        assert report["facets"] == (1 if suffix == ".obj" else 12)
        assert "groups" not in report
    known = {".off": "none", ".stl": "'cube'", ".obj": "'cube', 'open'"}[suffix]
    assert fails("info", path, "--group", "nose").endswith(f"the mesh has no group 'nose'; its groups are: {known}")


@pytest.mark.parametrize(
    ("V", "F", "expected"),
    [
        (CUBE, CUBE_F, "clean solid: used as it is"),
        (
            CUBE[CUBE_F].reshape(-1, 3),
            np.arange(36).reshape(12, 3),
            "clean solid once vertices at one place are joined",
        ),
        (CUBE, np.concatenate([CUBE_F[:1, ::-1], CUBE_F[1:]]), "clean solid once vertices at one place are joined"),
        (CUBE, CUBE_F[1:], "not a clean solid (1 hole): weights will be solved in a wrapped volume"),
        (CUBE, np.concatenate([CUBE_F[:1], CUBE_F[:1, ::-1]]), "not a clean solid (1 hole): weights will be solved"),
        (CUBE[[7, 7, 7]], [[0, 1, 2]], "not a clean solid (no facet encloses anything)"),
        (CUBE[:, :2] + CUBE[:, 2:] * [5, 0], [[0, 2, 4]], "flat: its own triangles are the domain of the weights"),
    ],
)
def test_the_verdict(tmp_path, succeeds, V, F, expected):
    write_mesh(tmp_path / "a.obj", V, F)
    assert succeeds("info", tmp_path / "a.obj")["files"][0]["verdict"].startswith(expected)


def test_notes_on_a_mesh(tmp_path, nilbs):
    write_mesh(tmp_path / "a.obj", CUBE, np.concatenate([CUBE_F, [[0, 0, 1]]]))
    status, text, _ = nilbs("info", tmp_path / "a.obj")
    assert status == 0
    assert "  note: 1 of 13 faces have fewer than three different corners and are left out" in text.splitlines()


RIGNET = """joints hip 0.5 0.5 0.2
joints head 0.5 0.5 0.8
root hip
skin 0 hip 1
skin 1 hip 0.25 head 0.5
hier hip head
"""


def test_a_rig_with_painted_weights(tmp_path, succeeds):
    (tmp_path / "a.txt").write_text(RIGNET)
    write_mesh(tmp_path / "a.obj", CUBE, CUBE_F)
    values = succeeds("info", tmp_path / "a.txt", tmp_path / "a.obj")
    rig, weights, _ = values["files"]
    assert (rig["kind"], rig["names"], rig["bones_without_length"]) == ("rig", ["hip", "head"], 1)
    assert (weights["kind"], weights["shape"], weights["vertices"]) == ("weights", [None, 2], 2)
    assert weights["problems"] == ["1 of 2 vertices have weights that do not sum to one; those of vertex 1 sum to 0.75"]
    assert values["problems"] == []
    (tmp_path / "a.txt").write_text(RIGNET + "skin 8 hip -1 head 2\n")
    values = succeeds("info", tmp_path / "a.txt", tmp_path / "a.obj")
    assert values["problems"] == [f"{tmp_path}/a.txt and {tmp_path}/a.obj: weights of vertex 8, but the mesh has 8"]
    assert values["files"][1]["problems"][0] == "weights leave 0 to 1: they run from -1 to 2"


def test_painted_weights_of_nothing(tmp_path, succeeds):
    write_mesh(tmp_path / "a.obj", CUBE, CUBE_F)
    (tmp_path / "a.mhskel").write_text(json.dumps(MHSKEL))
    (tmp_path / "a.mhw").write_text('{"weights": {}}')
    values = succeeds("info", tmp_path / "a.obj", tmp_path / "a.mhskel", tmp_path / "a.mhw")
    assert values["files"][2]["problems"] == ["no vertex has a weight"]


def test_a_flat_mesh_and_a_rig_in_space(tmp_path, succeeds, bar):
    V, T, C, BE = bar(2)
    write_mesh(tmp_path / "a.obj", V, T)
    write_tgf(tmp_path / "a.tgf", C + np.array([0, 0, 0.5]), BE)
    problems = succeeds("info", tmp_path / "a.obj", tmp_path / "a.tgf")["problems"]
    assert [p.split(": ", 1)[1] for p in problems] == ["the mesh is flat (z = 0) but joint 0 of the rig is not"]


def test_a_character_in_one_file(tmp_path, succeeds, bar):
    from nilbs.geometry.skeleton import Skeleton
    from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
    from nilbs.io.gltf_writer import write_gltf

    V, F, C, BE = bar(3)
    skeleton = Skeleton(C, BE, np.array([-1, 0]), ("upper", "lower"))
    n = len(V) - 1  # the last vertex is left without a weight
    painted = Influences(np.arange(n), (V[:n, 0] > 2).astype(int), np.ones(n))
    B = np.tile(np.eye(4), (3, 2, 1, 1))
    clip = Clip("still", skeleton, np.array([0, 0.5, 1.0]), B)
    write_gltf(tmp_path / "a.glb", Bundle(Mesh(V, F), skeleton, painted, (clip,)))
    values = succeeds("info", tmp_path / "a.glb")
    assert [report["kind"] for report in values["files"]] == ["mesh", "rig", "weights", "motion"]
    assert {report["file"] for report in values["files"]} == {str(tmp_path / "a.glb")}
    assert values["files"][0]["verdict"] == "clean solid: used as it is"
    motion = values["files"][3]
    assert (motion["name"], motion["frames"], motion["seconds"], motion["rms_local_rotation"]) == ("still", 3, 1, 0)
    assert values["files"][2]["shape"] == [n + 1, 2]


def test_painted_weights_that_leave_out_vertices_and_bones():
    from nilbs.app.descriptions import describe
    from nilbs.io.bundle import Bundle, Influences

    painted = Influences(np.array([0, 2, 2]), np.array([1, 1, 2]), np.array([1, 1, 0.0]), (4, 3))
    (report,) = describe("a.glb", Bundle(influences=painted), None)
    assert report["problems"] == [
        "2 of 4 vertices have no weight, vertex 1 first",
        "2 bones move no vertex, bone 0 first",
    ]
    assert (report["min"], report["shape"]) == (0, [4, 3])


def test_a_file_of_nothing(tmp_path, fails, monkeypatch):
    from nilbs.io.bundle import Bundle

    (tmp_path / "a.gltf").write_text('{"asset": {"version": "2.0"}}')
    assert "a.gltf: " in fails("info", tmp_path / "a.gltf")
    monkeypatch.setattr("nilbs.characters.bundle.read_bundle", lambda path, **_: Bundle())
    assert fails("info", tmp_path / "a.gltf").endswith("a.gltf: the file holds no mesh, rig or motion")


@pytest.mark.parametrize(
    ("name", "found"),
    [("fox", [1250, 833, 3, 0, 0]), ("snake", [995, 567, 1, 0, 0]),
     ("spider", [924, 800, 1, 4, 8]), ("dragon", [2905, 1783, 17, 6, 4])],
)  # fmt: skip
def test_creatures(data, succeeds, name, found):
    report = succeeds("info", data / "creatures" / f"{name}.glb")["files"][0]
    keys = ("vertices", "welded_vertices", "components", "boundary_edges", "nonmanifold_edges")
    assert [report[key] for key in keys] == found
    assert report["seam_vertices"] > report["vertices"] - report["welded_vertices"]
    assert not any("seam" in problem for problem in report["problems"])
    assert report["watertight"] == (name in ("fox", "snake"))


BVH = """HIERARCHY
ROOT {0}
{{
  OFFSET 90 0 0
  CHANNELS 3 Zrotation Xrotation Yrotation
  End Site
  {{
    OFFSET 0 5 0
  }}
}}
MOTION
Frames: {1}
Frame Time: 0.04
{2}"""


def test_a_motion_with_a_skeleton_of_its_own(tmp_path, succeeds, bar):
    V, F, C, BE = bar(3)
    write_mesh(tmp_path / "a.obj", V, F)
    write_tgf(tmp_path / "a.tgf", C, BE)
    path = tmp_path / "walk.bvh"
    path.write_text(BVH.format("hip", 2, "0 0 0\n10 0 0\n"))
    values = succeeds("info", path, tmp_path / "a.obj", tmp_path / "a.tgf")
    assert [report["kind"] for report in values["files"]] == ["rig", "motion", "mesh", "rig"]
    assert values["files"][1]["frames"] == 2
    # Where its skeleton stands does not matter, beside a rig.
    assert [p.split(": ", 1)[1] for p in values["problems"]] == [
        "no bone of the motion has the name of one of the rig: it will take a map"
    ]
    path.write_text(BVH.format("bone0", 1, "0 0 0\n"))
    assert succeeds("info", path, tmp_path / "a.tgf")["problems"] == []
    problems = succeeds("info", path, tmp_path / "a.obj")["problems"]
    assert problems
    assert all("walk.bvh" in problem for problem in problems)


def test_a_motion_without_frames(tmp_path, succeeds):
    (tmp_path / "a.bvh").write_text(BVH.format("hip", 0, ""))
    assert succeeds("info", tmp_path / "a.bvh")["files"][1]["problems"] == ["the motion has no frame"]


MHSKEL = {
    "bones": {"hip": {"head": "a", "tail": "b", "parent": None, "rotation_plane": None}},
    "joints": {"a": [0, 7], "b": [3]},
}


def test_makehuman_files_in_any_order(tmp_path, succeeds, fails):
    (tmp_path / "a.mhskel").write_text(json.dumps(MHSKEL))
    (tmp_path / "a.mhw").write_text(json.dumps({"weights": {"hip": [[0, 1.0], [7, 1.0]]}}))
    write_mesh(tmp_path / "a.obj", CUBE, CUBE_F)
    assert "give the mesh and the rig too" in fails("info", tmp_path / "a.mhw")
    assert "give the mesh file too" in fails("info", tmp_path / "a.mhskel")
    values = succeeds("info", tmp_path / "a.mhw", tmp_path / "a.mhskel", tmp_path / "a.obj")
    assert [report["kind"] for report in values["files"]] == ["weights", "rig", "mesh"]
    assert values["files"][0]["pairs"] == 2
    assert values["files"][1]["lower"] == [0.0, 0.5, 0.5]


def test_as_a_table(assets, nilbs, tmp_path):
    write_mesh(tmp_path / "open.obj", CUBE, CUBE_F[1:])
    status, text, err = nilbs("info", tmp_path / "open.obj", assets / "bar.tgf")
    assert (status, err) == (0, "")
    lines = text.splitlines()
    assert lines[0] == str(tmp_path / "open.obj")
    assert "  problem: the surface is not closed: 3 of its edges belong to one facet only" in lines
    assert "  no problem found" in lines
    assert "together" in lines
    end = f"{tmp_path / 'open.obj'}: not a clean solid (1 hole): weights will be solved in a wrapped volume"
    assert lines[-2:] == ["", end]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "v 0 0 1\nv 0 nan 0\n", "a.obj:2: 'nan' is not a finite number"),
        ("a.tgf", "1 0 0 0\n", "a.tgf: the rig has no bone"),
        ("a.dmat", "3 100000000\n1\n", "a.dmat:1: 100000000 rows of 3 columns do not fit in"),
        ("a.npz", "hello", "a.npz: damaged .npz file"),
        ("a.json", "[" * 100_000, "a.json: the JSON is nested too deep"),
        ("a.nilbs", "hello", "a.nilbs: "),
        ("a.txt", "hello", "a.txt:1: a line of a rig starts with"),
        ("a.doc", "hello", "a.doc: the file name must end in"),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path, fails, name, content, message):
    (tmp_path / name).write_text(content)
    assert message in fails("info", tmp_path / name)


def test_a_matrix_that_is_neither_weights_nor_a_motion(tmp_path, succeeds):
    write_dmat(tmp_path / "a.dmat", np.ones((5, 5)))
    report = succeeds("info", tmp_path / "a.dmat")["files"][0]
    assert report["kind"] == "weights"
    assert report["problems"] == ["5 of 5 vertices have weights that do not sum to one; those of vertex 0 sum to 5"]
    assert json.dumps(report)
