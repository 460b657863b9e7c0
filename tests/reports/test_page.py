"""Pages hold what the JSON files hold, nothing from a network, and names as text."""

import base64
import io
import json
import re
import struct
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import trimesh

from nilbs.characters.motion import random_motion
from nilbs.figures.views import View
from nilbs.geometry.surface import Surface
from nilbs.models.evaluation import evaluate, evaluation_poses
from nilbs.models.fitting import fit
from nilbs.reports.benchmark import write_benchmark_page
from nilbs.reports.evaluation import worst_poses, write_evaluation_page
from nilbs.reports.page import Cell, Page, Table
from nilbs.reports.scene import scene_of_surfaces

NAME = "<script>alert('x')</script> & \"co\""


class Reader(HTMLParser):
    """Elements of a page: their tags with attributes, the text, and the values of all cells of each row."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.text, self.rows, self.heads = "", [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes) -> None:
        found = dict(attributes)
        self.tags.append((tag, found))
        if tag == "tr":
            self.rows.append([])
        if "data-value" in found:
            self.rows[-1].append(found["data-value"])
        if found.get("scope") == "col":
            self.heads.append(found["title"])

    def handle_data(self, data) -> None:
        self.text += data


@pytest.fixture(scope="module", params=[2, 3])
def scored(request, tmp_path_factory, characters):
    """A model, its scores, and the page."""
    character = replace(characters[request.param], name=NAME)
    model = fit(character, random_motion(character, frames=3), steps=0, cache_resolution=16)
    values = evaluate(model, points=50, resolution=8, rows=["floor"]).values
    folder = tmp_path_factory.mktemp("page")
    path = write_evaluation_page(folder, model, values, resolution=8)
    return model, values, Reader(path.read_text()), path.read_text()


def test_every_score_is_there_with_all_its_digits(scored) -> None:
    _, values, page, _ = scored
    scores = page.heads[2 : page.heads.index("watertight") + 1]
    assert {"iou_bbox", "iou_surface", "hausdorff"} <= set(scores)
    for row, sets in {"model": values["poses"], "floor": values["rows"]["floor"]}.items():
        for name, found in sets.items():
            means = [found.get(score, {"mean": None})["mean"] for score in scores]
            assert [row, name, *("" if mean is None else str(mean) for mean in means)] in page.rows
            frames = found["iou_bbox"]["frames"]
            if row == "model":
                for frame, iou in enumerate(frames):
                    assert any(line[:3] == [name, str(frame), str(iou)] for line in page.rows)


def test_nothing_comes_from_elsewhere(scored) -> None:
    *_, page, text = scored
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", re.sub(r"[A-Za-z0-9+/]{200,}", "", text))
    sources = [found[key] for _, found in page.tags for key in ("src", "href") if key in found]
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not {"link", "iframe", "object", "base"} & {tag for tag, _ in page.tags}


def test_a_name_is_text_not_markup(scored) -> None:
    *_, page, text = scored
    assert NAME not in text
    assert page.text.count(f"{NAME}: scores") == 2  # title and head
    assert "alert" not in "".join(found.get("onclick", "") for _, found in page.tags)


def test_the_worst_frame_has_the_lowest_score_of_its_set(scored) -> None:
    model, values, *_ = scored
    found = worst_poses(model, values)
    assert len(found) == 4
    for name, (label, pose) in zip(values["poses"], found.items(), strict=True):
        ious = values["poses"][name]["iou_surface"]["frames"]
        frame = int(label.removeprefix(f"{name}, frame "))
        assert ious[frame] == min(ious)
        poses = evaluation_poses(model.character, model.motion, name, seed=values["seed"])
        np.testing.assert_array_equal(pose, poses[frame])


def test_a_scene_is_there_in_space_only(scored) -> None:
    model, _, page, _ = scored
    assert ("canvas" in dict(page.tags)) == (model.character.d == 3)
    if model.character.d == 3:
        data = max(re.findall(r'octet-stream">([^<]+)<', page.rawdata or scored[3]), key=len)
        glb = base64.b64decode(data)
        names = json.loads(glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])["meshes"]
        assert {mesh["name"] for mesh in names} == {
            f"{label}|{kind}" for label in worst_poses(model, scored[1]) for kind in ("reconstructed", "true")
        }


def test_a_file_of_surfaces_is_what_the_viewer_reads(rng) -> None:
    U, F = rng.normal(size=(5, 3)), np.array([[0, 1, 2], [2, 3, 4]])
    view = View.front(U)
    paint = rng.random((5, 3))
    nothing = Surface(np.zeros((0, 3)), np.zeros((0, 3), int))
    glb = scene_of_surfaces(
        {"a|one": (Surface(U, F), paint), "b|two": (Surface(U, F), None), "c": (nothing, None)}, view
    )
    meshes = trimesh.load(io.BytesIO(glb), file_type="glb", process=False).geometry
    assert set(meshes) == {"a|one", "b|two"}
    np.testing.assert_allclose(meshes["a|one"].vertices @ view.axes, U, atol=1e-6)
    np.testing.assert_array_equal(meshes["a|one"].faces, F)
    np.testing.assert_allclose(meshes["a|one"].visual.vertex_colors[:, :3] / 255, paint, atol=0.002)
    file = json.loads(glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])
    assert not any("byteStride" in part for part in file["bufferViews"])
    assert not any("matrix" in node and node["matrix"] != np.eye(4).ravel().tolist() for node in file["nodes"])
    for mesh in file["meshes"]:
        (part,) = mesh["primitives"]
        kinds = [file["accessors"][part["attributes"][name]]["componentType"] for name in ("POSITION", "COLOR_0")]
        assert kinds == [5126, 5121]


def test_no_surface_is_no_file() -> None:
    assert (
        scene_of_surfaces({"a|one": (Surface(np.zeros((0, 3)), np.zeros((0, 3), int)), None)}, View(np.eye(3))) == b""
    )


def test_times_are_those_of_the_results_in_milliseconds(tmp_path, characters) -> None:
    cell = {
        "quantity": "occupancy",
        "triangles": 12,
        "points": 1000,
        "kind": "near",
        "threads": 2,
        "poses": 1,
        "repeats": 5,
    }
    times = {"status": "measured", "pose_s": 0.001, "query_s": 0.002, "total_s": 0.004, "differing": 0.5, "iou": 0.25}
    late = {"status": "time", "reason": "it would take 30 s"}
    values = {
        "model": {"name": NAME, "method": "nilbs", "bones": 2},
        "machine": {"processor": "a", "cores": 2, "python": "3.11"},
        "skipped": {"mesdf": "not installed"},
        "interrupted": False,
        "rows": [
            {"contestant": "nilbs", **cell, **times},
            {"contestant": "libigl", **cell, **times, "total_s": 0.012, "memory_mib": 7.0},
            {"contestant": "Warp", **cell, **late},
        ],
    }
    text = write_benchmark_page(tmp_path, characters[3], values).read_text()
    page = Reader(text)
    assert NAME not in text
    assert ["nilbs", "1.0", "2.0", "4.0", "1.0", "50.0", "0.25", ""] in page.rows
    assert ["libigl", "1.0", "2.0", "12.0", "3.0", "50.0", "0.25", "7.0"] in page.rows
    assert ["Warp", *[""] * 7] in page.rows
    assert "not run: it would take 30 s" in page.text
    assert ["mesdf", "not installed"] in page.rows


def test_values_that_are_undefined_are_empty() -> None:
    table = Table("Scores", ["row", "p95"], [[Cell("a"), Cell(None)], [Cell("b"), Cell(0)]])
    page = Reader(Page("a page", "", {}, [table]).html())
    assert page.rows[1:] == [["a", ""], ["b", "0"]]
