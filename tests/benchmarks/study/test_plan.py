"""Which jobs there are."""

import re

import pytest

from benchmarks.study.characters import SOURCES, available
from benchmarks.study.jobs import SCORE, TRAIN, Builder, Entry, Job
from benchmarks.study.plan import PARTS, SWEEPS, SWEPT, plan
from benchmarks.study.scale import TRAINED, full_scale, quick_scale
from nilbs.methods.inverse_skinning import MAPPINGS
from nilbs.methods.registry import method_of, untrained


@pytest.fixture(scope="module")
def full():
    return plan(full_scale(list(SOURCES), minutes=5, seeds=3))


@pytest.fixture(scope="module", params=["full", "quick"])
def either(request, full):
    return full if request.param == "full" else plan(quick_scale())


def test_keys_are_unique_and_a_job_follows_the_training_that_it_needs(either) -> None:
    keys = [job.key for job in either.jobs]
    assert len(set(keys)) == len(keys)
    for job in either.jobs:
        if job.needs is not None:
            training = either.by_key[job.needs]
            assert {
                other.needs or other.key for other in either.jobs[keys.index(training.key) : keys.index(job.key)]
            } == {training.key}  # nothing stands between
            assert training.kind == TRAIN
            assert keys.index(training.key) < keys.index(job.key)
            assert job.spec["of"] == training.spec
    assert {entry.job for entry in either.entries} <= set(keys)
    assert {job.key for job in either.of_parts(PARTS)} == set(keys)


def test_no_two_places_in_the_tables_are_the_same(either) -> None:
    places = [(e.part, e.character, e.method, e.seed, e.value, e.poses) for e in either.entries if e.row != "picture"]
    assert len(set(places)) == len(places)


def test_no_work_is_done_twice(either) -> None:
    work = [repr(sorted(job.spec.items())) + job.kind for job in either.jobs]
    assert len(set(work)) == len(work)


def test_settings_and_rows_are_those_of_the_project(either) -> None:
    for job in either.jobs:
        if job.kind == TRAIN:
            method_of(**{"method": "nilbs"} | job.spec["settings"])
            assert not (job.spec["minutes"] is not None and "steps" in job.spec["settings"])
        if job.kind == SCORE:
            assert set(job.spec["rows"]) <= {"floor", *MAPPINGS, *untrained()}


def test_seeds(full) -> None:
    trainings = [job for job in full.jobs if job.kind == TRAIN and job.keep]
    for name in SOURCES:
        seeds = {job.spec["seed"] for job in trainings if job.spec["character"] == name}
        assert seeds == ({0} if name in ("arm", "makehuman") else {0, 1, 2})
        for method in TRAINED:
            assert f"{name}/{method}/seed0" in full.by_key


def test_surfaces_of_baselines_are_scored_for_first_seeds_only(full) -> None:
    with_surfaces = {job.key: job for job in full.jobs if job.kind == SCORE and job.spec["resolution"]}
    assert "surfaces/elephant-nilbs" in with_surfaces
    others = {key: job for key, job in with_surfaces.items() if "-nilbs-seed" not in key}
    assert {job.spec["seed"] for job in others.values()} == {0}
    assert {key for key in with_surfaces if key not in others} == {
        f"surfaces/{name}-nilbs-seed{seed}" for name in SOURCES for seed in (1, 2) if name not in ("arm", "makehuman")
    }
    assert {tuple(job.spec["poses"]) for job in with_surfaces.values()} == {("seen", "unseen")}
    assert {e.job for e in full.entries if e.part == "surfaces"} == set(with_surfaces)


def test_methods_that_evaluate_every_bone_are_left_out_where_there_are_very_many(full) -> None:
    assert not {"surfaces/arm-nasa", "surfaces/elephant-snarf"} & set(full.by_key)
    assert {"surfaces/elephant-nasa", "surfaces/gingerbread-2d-snarf"} <= set(full.by_key)
    snarf = full.by_key["makehuman/snarf/seed0/scores"]
    assert snarf.spec["poses"] == ["unseen"]
    assert snarf.spec["ious"] == ["iou_surface"]
    assert snarf.spec["points"] == full.by_key["makehuman/nasa/seed0/scores"].spec["points"] / 10 == 10_000
    assert "ious" not in full.by_key["elephant/snarf/seed0/scores"].spec
    assert full.by_key["makehuman/nasa/seed0/scores"].spec["poses"] == ["seen", "unseen"]
    assert full.by_key["frames/elephant-snarf-10/scores"].spec["poses"] == ["unseen"]
    counts = {int(key.rpartition("-")[2]) for key in full.by_key if re.fullmatch(r"frames/elephant-snarf-\d+", key)}
    assert counts == {1, 10, 100}
    assert "frames/elephant-nasa-3" in full.by_key
    assert "all-bones" not in full.by_key["makehuman/nilbs/seed0/other-rows"].spec["rows"]
    assert "all-bones" in full.by_key["arm/nilbs/seed0/other-rows"].spec["rows"]
    assert full.by_key["elephant/nilbs/seed0/other-rows"].spec["rows"] == ["rigid-parts"]


def test_baselines_are_scored_on_fewer_poses(full) -> None:
    def poses(key: str) -> list[str]:
        return full.by_key[key].spec["poses"]

    assert poses("elephant/nilbs/seed2/scores") == ["seen", "interpolated", "unseen", "far"]
    assert poses("elephant/nasa/seed0/scores") == ["seen", "unseen", "far"]
    assert poses("elephant/nasa/seed2/scores") == ["unseen", "far"]
    assert poses("noise/elephant-nilbs-x2") == ["unseen", "far"]
    assert poses("noise/elephant-nasa-x2") == ["unseen"]
    assert {e.poses for e in full.entries if (e.part, e.value, e.method) == ("noise", 1, "nasa")} == {("unseen",)}


def test_sweeps_share_what_they_can(full) -> None:
    """At 100 frames the default of the ablation is the frames' sweep's last and the training of two minutes."""
    entries = [e for e in full.entries if e.method in ("nilbs", "default") and e.part in ("ablation", "frames", "time")]
    shared = {
        e.job for e in entries if (e.part, e.value) in (("ablation", None), ("frames", 100), ("time", 2)) and not e.row
    }
    assert len(shared) == 1
    minutes = {e.value: full.by_key[full.by_key[e.job].needs] for e in entries if e.part == "time"}
    assert minutes[5].key == "elephant/nilbs/seed0"
    assert {value: job.spec["minutes"] for value, job in minutes.items()} == {v: v for v in (0.25, 0.5, 1, 2, 5)}


def test_quick_is_small_and_complete() -> None:
    quick = plan(quick_scale())
    assert {entry.part for entry in quick.entries} == set(PARTS)
    trainings = [job for job in quick.jobs if job.kind == TRAIN]
    assert len(trainings) <= 35
    assert {job.spec["character"] for job in trainings} == {"gingerbread-2d", "gingerbread-3d"}
    assert {job.spec["settings"].get("method", "nilbs") for job in trainings} >= {"nasa", "snarf", "mlp"}
    assert all((job.spec["minutes"] or 0) <= 0.02 for job in trainings)


def test_without_data_the_sweeps_and_their_character_are_missing(tmp_path) -> None:
    found, left_out = available(tmp_path)
    study = plan(full_scale(list(found), minutes=5, seeds=3), left_out)
    assert list(found) == ["gingerbread-2d", "gingerbread-3d"]
    assert [line.split(" is ")[0] for line in left_out] == ["arm", "elephant", "MakeHuman body"]
    assert study.missing[-1] == "the sweeps are left out: they are of the elephant"
    assert not {entry.part for entry in study.entries} & set(SWEEPS)
    for name in SOURCES:
        for file in SOURCES[name].files:
            (tmp_path / file).parent.mkdir(exist_ok=True)
            (tmp_path / file).touch()
    assert list(available(tmp_path)[0]) == list(SOURCES)


def test_a_part_brings_the_trainings_that_it_needs(full) -> None:
    jobs = full.of_parts(["amplitude"])
    assert {job.key for job in jobs if job.kind == TRAIN} == {f"elephant/{name}/seed0" for name in SWEPT}
    assert all(job.kind == TRAIN or job.key.startswith("amplitude/") for job in jobs)


def test_jobs_of_other_files_are_other_jobs() -> None:
    def specs(digest: str) -> dict[str, dict]:
        made = plan(full_scale(["gingerbread-2d", "arm"], minutes=5, seeds=1, made_of={"arm": digest}))
        return {job.key: job.spec for job in made.jobs}

    one, other = specs("a"), specs("b")
    changed = {key for key in one if one[key] != other[key]}
    assert changed == {key for key in one if "arm" in key}


def test_two_jobs_of_one_name_are_refused() -> None:
    builder = Builder()
    first = builder.job(Job("a", "twist", {"seed": 0}))
    assert builder.job(Job("b", "twist", {"seed": 0})) == first
    with pytest.raises(ValueError, match="two jobs are called a"):
        builder.job(Job("a", "twist", {"seed": 1}))
    builder.entry(Entry("twist", "", "", 0, "a"))
    assert [job.key for job in builder.plan().jobs] == ["a"]
