"""Tables, curves and the report, of scores that are known."""

import csv
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from benchmarks.study import results, tables
from benchmarks.study.jobs import Plan
from benchmarks.study.outputs import FILES, write_outputs
from benchmarks.study.pages import Page, Picture, html, markdown
from benchmarks.study.plan import plan
from benchmarks.study.results import Score, series, summary
from benchmarks.study.runner import run
from benchmarks.study.scale import full_scale, quick_scale
from benchmarks.study.tables import Cell, Table, study_tables
from nilbs.methods.inverse_skinning import MAPPINGS
from nilbs.models.protocol import IOUS, POSE_SETS

TITLES = {"gingerbread-2d": "flat man", "elephant": "elephant"}


@pytest.fixture
def done(store, pretender):
    """A full study of two characters, without the elephant's nasa and without sweeps over frames."""
    study = plan(full_scale(["gingerbread-2d", "elephant"], minutes=5, seeds=3))
    without = ("elephant/nasa/", "frames/")
    left = [job for job in study.jobs if not any(key.startswith(without) for key in (job.key, job.needs or ""))]
    run(study, store, [pretender()], jobs=left, report=lambda line: None)
    return study


@pytest.fixture
def shown(surface_iou):
    """The cell that shows the surface IoU of some scorings."""

    def text(study: Plan, keys: list[str], poses: str, row: str = "") -> str:
        mean, spread = summary([surface_iou(study.by_key[key], poses, row) for key in keys])
        return f"{mean:.4f}" + ("" if spread is None else f" ± {spread:.4f}")

    return text


def keys(character: str, method: str, seeds: int) -> list[str]:
    return [f"{character}/{method}/seed{seed}/scores" for seed in range(seeds)]


def table(tables: list[Table], start: str) -> dict[str, dict[str, Cell]]:
    found = next(t for t in tables if t.title.startswith(start))
    return {name: dict(zip(found.columns[1:], cells, strict=True)) for name, cells in found.rows}


def test_means_and_spreads_over_seeds(done, store, shown) -> None:
    rows = table(study_tables(done, store, TITLES), "elephant")
    three = keys("elephant", "nilbs", 3)
    assert shown(done, three, "seen").endswith(" ± 0.0100")
    for poses in POSE_SETS:
        assert rows["nilbs"][f"{poses}: surface IoU"].text == shown(done, three, poses)
        assert rows["inverse"][f"{poses}: surface IoU"].text == shown(done, three, poses, "inverse")
        assert rows["nearest °"][f"{poses}: surface IoU"].text == shown(done, three[:1], poses, "nearest")
    assert rows["snarf"]["far: surface IoU"].text == shown(done, keys("elephant", "snarf", 3), "far")
    assert rows["nilbs"]["seen: Chamfer, % of L"].text == "0.050 ± 0.000"
    assert rows["paper"]["seen: Chamfer, % of L"].text == "0.050"
    assert rows["nilbs"]["training, s"].text == "120 ± 0"
    assert rows["nilbs"]["s for 100,000 points"].text == "0.50 ± 0.00"


def test_the_overview_holds_every_method_on_every_character(done, store, shown) -> None:
    tables = study_tables(done, store, TITLES)
    rows = table(tables, "Surface IoU of every method")
    assert list(rows["nilbs"]) == [f"{title}: {poses}" for title in TITLES.values() for poses in ("unseen", "far")]
    for character, title in TITLES.items():
        for poses in ("unseen", "far"):
            for method in ("nilbs", "paper", "snarf", "mlp"):
                assert rows[method][f"{title}: {poses}"].text == shown(done, keys(character, method, 3), poses)
    assert rows["nilbs"]["flat man: far"].text == table(tables, "flat man")["nilbs"]["far: surface IoU"].text
    assert rows["nasa"]["elephant: far"].text == "-"
    meanings = table(tables, "What the rows are")
    assert [name for name in meanings if name != "floor °°"] == list(rows)  # which has a surface alone
    assert "SNARF" in meanings["snarf"]["what it is"].text


def test_the_time_of_a_training_that_was_continued_is_not_shown(done, store) -> None:
    training = done.by_key["elephant/nilbs/seed0"]
    store.write(training, store.result(training) | {"resumed": True})
    rows = table(study_tables(done, store, TITLES), "elephant")
    assert rows["nilbs"]["training, s"].text == "120 ± 0"  # of the other two seeds
    for seed in (1, 2):
        training = done.by_key[f"elephant/nilbs/seed{seed}"]
        store.write(training, store.result(training) | {"resumed": True})
    rows = table(study_tables(done, store, TITLES), "elephant")
    assert rows["nilbs"]["training, s"].text == "-"
    assert rows["nilbs"]["steps"].text == "100 ± 0"


def test_scores_of_a_training_that_was_repeated_are_not_shown(done, store, shown) -> None:
    training = done.by_key["elephant/nilbs/seed0"]
    store.write(training, store.result(training) | {"stamp": "another"})
    rows = table(study_tables(done, store, TITLES), "elephant")
    assert rows["nilbs"]["seen: surface IoU"].text == shown(done, keys("elephant", "nilbs", 3)[1:], "seen")
    assert rows["nearest °"]["seen: surface IoU"].text == "-"


def test_pictures_of_a_training_that_was_repeated_are_not_shown(done, store) -> None:
    job = done.by_key["elephant/nilbs/seed0/picture"]
    store.write(
        job, store.result(job) | {"pictures": [{"title": "elephant", "caption": "", "file": "pictures/here.png"}]}
    )
    (store.folder / "pictures").mkdir(exist_ok=True)
    (store.folder / "pictures" / "here.png").touch()
    assert [picture["file"] for picture in results.pictures(done, store)] == ["pictures/here.png"]
    training = done.by_key["elephant/nilbs/seed0"]
    store.write(training, store.result(training) | {"stamp": "another"})
    assert not results.pictures(done, store)


@pytest.mark.parametrize(
    ("values", "best"),
    [
        # Differences of 0.02 and 0.01 are more than they spread; of 0.02 and -0.01, less.
        ({"a": {0: 0.9, 1: 0.8}, "b": {0: 0.88, 1: 0.79}}, "a"),
        ({"a": {0: 0.9, 1: 0.8}, "b": {0: 0.88, 1: 0.81}}, "ab"),
        # One seed in common: the spread is that of the row with several.
        ({"a": {0: 0.9, 1: 0.8}, "b": {0: 0.86}}, "ab"),
        ({"a": {0: 0.9, 1: 0.8}, "b": {0: 0.84}}, "a"),
        # The mean of b is the higher, of an easier seed.
        ({"a": {0: 0.9, 1: 0.8}, "b": {0: 0.89}}, "ab"),
        ({"a": {0: 0.9}, "b": {0: 0.8}, "c": {0: 0.90004}}, "ac"),
        ({"a": {0: 0.9}, "b": {0: None}, "c": {}}, ""),
    ],
)
def test_best_is_what_no_other_row_beats_seed_by_seed(values, best) -> None:
    def marked(values: dict, score: str) -> str:
        rows = tables._rows(list(values), [[row] for row in values.values()], [score], str)
        return "".join(name for name, (cell,) in rows if cell.best)

    assert marked(values, "iou_bbox") == best
    lower = {name: {seed: x and -x for seed, x in row.items()} for name, row in values.items()}
    assert marked(lower, "chamfer_l1") == best
    assert not marked(values, "lookups")
    assert not marked(values, "training_seconds")


def test_what_was_not_run_is_a_dash(done, store) -> None:
    tables = study_tables(done, store, TITLES)
    rows = table(tables, "elephant")
    assert {cell.text for cell in rows["nasa"].values()} == {"-"}
    assert rows["rigid-parts °"]["seen: Chamfer, % of L"].text == "-"
    frames = table(tables, "Surface IoU against training poses: unseen")
    assert [cell.text for cell in frames["nasa"].values()] == ["-"] * 5
    surfaces = table(tables, "elephant: surfaces")
    assert list(surfaces) == [
        "nilbs",
        "inverse",
        "paper",
        "nasa",
        "nasa-rigid",
        "mlp",
        "nearest °",
        "floor °°",
    ]
    assert {cell.text for cell in surfaces["nasa"].values()} == {"-"}
    assert "elephant/nasa/seed0" in results.unfinished(done, store)


def test_the_best_of_a_column_is_bold_and_the_truth_is_not_compared(done, store, shown, surface_iou) -> None:
    rows = table(study_tables(done, store, TITLES), "flat man")
    best = {name for name, cells in rows.items() if cells["seen: surface IoU"].best}
    # One seed is all that baselines are scored for in seen poses, and nilbs spreads by more than they differ.
    baselines = ("paper", "nasa", "nasa-rigid", "snarf", "mlp")
    scores = {name: surface_iou(done.by_key[f"gingerbread-2d/{name}/seed0/scores"], "seen") for name in baselines}
    assert best == {"nilbs", max(scores, key=scores.get)}
    assert not any(cell.best for cell in rows["mesh-lbs °°"].values())
    assert rows["mesh-lbs °°"]["seen: surface IoU"].text == shown(done, keys("gingerbread-2d", "mesh-lbs", 1), "seen")
    # Its points would be compared with themselves.
    assert rows["floor °°"]["seen: surface IoU"].text == "-"
    assert rows["floor °°"]["seen: Chamfer, % of L"].text == "0.050 ± 0.000"
    assert not any(cells["training, s"].best for cells in rows.values())


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([], (None, None)),
        ([None], (None, None)),
        ([0.5], (0.5, None)),
        ([0.5, None], (0.5, None)),
        ([1.0, 2.0, 6.0], (3.0, 2.5)),
    ],
)
def test_a_summary_is_the_mean_and_half_the_range(values, expected) -> None:
    assert summary(values) == expected


def test_series_take_one_pose_set_or_any() -> None:
    def score(value: float, poses: str, mean: float | None) -> Score:
        return Score("amplitude", "elephant", "nilbs", value, 0, poses, "iou_surface", mean, None)

    known = [score(0.4, "random 0.4", 0.9), score(0.2, "random 0.2", 0.95), score(0.6, "random 0.6", None)]
    assert series(known, "amplitude", None, "iou_surface") == {"nilbs": {0.2: 0.95, 0.4: 0.9}}
    assert series(known, "amplitude", "random 0.2", "iou_surface") == {"nilbs": {0.2: 0.95}}
    assert series(known, "noise", None, "iou_surface") == {}


def test_distances(done, store) -> None:
    rows = table(study_tables(done, store, TITLES), "Error of the distance")
    assert rows["elephant"]["far: read at rest"].text == "0.100"
    assert rows["flat man"]["far: corrected by the local stretch"].text == "0.030"


def test_ablation_and_mappings(done, store, shown) -> None:
    tables = study_tables(done, store, TITLES)
    settings = table(tables, "Settings switched")
    ghostless = ["ablation/elephant-no-ghost-bone/scores"]
    for poses in ("unseen", "far"):
        assert settings["no ghost bone"][poses].text == shown(done, ghostless, poses)
        assert settings["no ghost bone"][f"{poses}, inverse map alone"].text == shown(done, ghostless, poses, "inverse")
    ways = table(tables, "Ways of the default model")
    assert next(iter(ways)) == "search (default)"
    default, others = (["ablation/elephant-default/" + key] for key in ("scores", "mappings"))
    assert ways.pop("search (default)")["far"].text == shown(done, default, "far")
    assert ways["inverse"]["unseen"].text == shown(done, default, "unseen", "inverse")
    assert ways["reverse"]["unseen"].text == shown(done, others, "unseen", "reverse")
    assert len(ways) == len(MAPPINGS) - 1


def test_a_sweep_shows_the_rows_that_are_scored_there(done, store) -> None:
    tables = study_tables(done, store, TITLES)
    for what, learned_nothing in (("training minutes", []), ("surface noise, in units of 0.006 L", ["nearest °"])):
        unseen = table(tables, f"Surface IoU against {what}: unseen")
        assert list(unseen) == ["nilbs", "inverse", "nasa", "snarf", "mlp", *learned_nothing]
        assert list(table(tables, f"Surface IoU against {what}: far")) == ["nilbs", "inverse", *learned_nothing]


def test_controls_are_the_most_wrong_of_all_scorings(done, store, surface_iou) -> None:
    job = next(job for job in done.jobs if job.key == "elephant/nilbs/seed1/scores")
    result = store.result(job)
    result["scores"]["controls"]["perfect"]["iou_bbox"] = 0.75
    store.write(job, result)
    found = results.controls(done, store)
    assert found["elephant"]["perfect"] == {"iou_bbox": 0.75, "iou_surface": 1.0}
    assert found["gingerbread-2d"]["inverted"] == {"iou_bbox": 0.0, "iou_surface": 0.0}
    rows = [row for row in results.scores(done, store) if row.part == "controls" and row.character == "elephant"]
    assert sorted((row.method, row.score, row.mean) for row in rows) == [
        (kind, name, float(kind == "perfect")) for kind in ("empty", "inverted", "perfect") for name in IOUS
    ]
    rows = table(study_tables(done, store, TITLES), "Controls")
    assert rows["elephant"]["perfect: iou_bbox"].text == "0.7500"
    job = done.by_key["elephant/mesh-lbs/seed0/scores"]
    worst = min(surface_iou(job, poses) for poses in POSE_SETS)
    assert rows["elephant"]["mesh LBS: iou_surface"].text == f"{worst:.4f}"


def test_all_files_are_written_and_agree(done, store, shown, surface_iou) -> None:
    scale = full_scale(["gingerbread-2d", "elephant"], minutes=5, seeds=3)
    values = write_outputs(done, store, scale, command=["nilbs", "study", "--out", "<here>"])
    assert json.loads((store.folder / "study.json").read_text()) == values
    with open(store.folder / "scores.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(values["rows"])
    mine = [r for r in rows if (r["method"], r["poses"], r["score"]) == ("nilbs", "far", "iou_surface")]
    assert [float(r["mean"]) for r in mine if r["part"] == "methods" and r["character"] == "elephant"] == [
        surface_iou(done.by_key[key], "far") for key in keys("elephant", "nilbs", 3)
    ]
    assert values["machine"]["cores"] >= 1
    assert any(key.startswith("frames/") for key in values["unfinished"])
    text = (store.folder / "study.md").read_text()
    assert "| method | seen: bbox IoU |" in text
    assert f"**{shown(done, keys('gingerbread-2d', 'nilbs', 3), 'seen')}**" in text
    assert "| training frames | 100, evenly spaced, where the motion has as many; elephant 60 |" in text
    worst = text.partition("### gingerbread man, 2D: worst frames")[2].partition("###")[0]
    row = next(line for line in worst.splitlines() if line.startswith("| nilbs |"))
    assert "0.9800" in row
    assert "0.9900" not in row
    page = ElementTree.fromstring((store.folder / "study.html").read_text().replace("<!DOCTYPE html>", ""))
    sources = [image.get("src") for image in page.iter("img")]
    assert len(sources) >= 4
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    headings = [heading.text for heading in page.iter("h2")]
    assert headings[0] == "What was measured"
    assert headings[-1] == "What is missing"


def test_a_report_without_results_holds_dashes(store) -> None:
    study = plan(quick_scale())
    store.folder.mkdir()
    write_outputs(study, store, quick_scale(), quick=True)
    assert sorted(path.name for path in store.folder.iterdir() if path.is_file()) == sorted(FILES)
    page = ElementTree.fromstring((store.folder / "study.html").read_text().replace("<!DOCTYPE html>", ""))
    assert {cell.text for table in page.iter("table") if not table.get("class") for cell in table.iter("td")} == {"-"}
    assert "numbers mean nothing" in (store.folder / "study.md").read_text()


def test_failures_are_listed_and_text_is_escaped(store, pretender) -> None:
    study = plan(quick_scale())
    run(study, store, [pretender(failing=("gingerbread-2d/nilbs/seed0",))], report=lambda line: None)
    write_outputs(study, store, quick_scale(), command=["nilbs", "study", "--out", "a<b>&\x07"])
    text = (store.folder / "study.html").read_text()
    page = ElementTree.fromstring(text.replace("<!DOCTYPE html>", ""))
    shown = [item.text for item in page.iter("li")]
    assert "gingerbread-2d/nilbs/seed0 failed: ValueError: it would <not> & could not" in shown
    assert "\x07" not in text
    assert "nilbs study --out a<b>&" in [cell.text for cell in page.iter("td")]


def test_a_page_escapes_what_it_is_given(tmp_path: Path) -> None:
    evil = 'a|b <script>"&\n'
    picture = Picture(evil, evil, tmp_path / "gone.png")
    page = Page(
        evil,
        {evil: evil},
        [Table("twist", evil, evil, (evil, evil), ((evil, (Cell("1.0 ± <0.1>", True),)),))],
        {"twist": [picture], "failures": [picture]},
        [evil],
        [evil],
    )
    root = ElementTree.fromstring(html(page).replace("<!DOCTYPE html>", ""))
    assert not list(root.iter("script"))
    assert root.find("body/h1").text == evil
    assert [strong.text for strong in root.iter("strong")] == ["1.0"]
    assert [small.text for small in root.iter("small")] == ["± <0.1>"]
    rows = [line for line in markdown(page).splitlines() if line.startswith("|")]
    assert all(len(re.findall(r"(?<!\\)\|", row)) == 3 for row in rows)
    assert "<script>" not in markdown(page)
