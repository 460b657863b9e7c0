"""What is run, what is not run again, and what becomes of what fails."""

import json
import signal
from threading import Barrier, Timer

import pytest

from benchmarks.study.jobs import TRAIN, Job, Plan
from benchmarks.study.plan import plan
from benchmarks.study.runner import Stopped, Worker, run
from benchmarks.study.scale import quick_scale
from benchmarks.study.store import Store
from benchmarks.study.worker import do


def a_plan(*, steps: int = 2, points: int = 10, keep: bool = True) -> Plan:
    training = Job("arm/nilbs", TRAIN, {"settings": {"steps": steps}}, keep=keep)
    spec = {"of": training.spec, "points": points, "resolution": 0, "poses": ["seen"], "rows": [], "seed": 0}
    spec["distances"] = False
    one = Job("arm/scores", "score", spec, training.key)
    other = Job("arm/far", "score", {**spec, "poses": ["far"]}, training.key)
    return Plan((training, one, other), ())


def ran(study: Plan, store: Store, worker, **options) -> list[str]:
    lines: list[str] = []
    run(study, store, [worker], report=lines.append, **options)
    return worker.did


def test_what_is_done_is_not_run_again(store, pretender) -> None:
    study = a_plan()
    assert ran(study, store, pretender()) == ["arm/nilbs", "arm/scores", "arm/far"]
    assert ran(study, store, pretender()) == []
    assert all(store.done(job, study) for job in study.jobs)


def test_a_changed_spec_is_run_again_and_so_is_what_depends_on_it(store, pretender) -> None:
    ran(a_plan(), store, pretender())
    assert ran(a_plan(points=11), store, pretender()) == ["arm/scores", "arm/far"]
    assert ran(a_plan(steps=3, points=11), store, pretender()) == ["arm/nilbs", "arm/scores", "arm/far"]


def test_scores_of_another_training_of_the_same_spec_do_not_count(store, pretender) -> None:
    study = a_plan()
    ran(study, store, pretender())
    store.model("arm/nilbs").unlink()
    assert store.done(study.jobs[0], study)  # nobody needs it
    (store.folder / "results" / "arm" / "far.json").unlink()
    assert not store.done(study.jobs[0], study)
    assert ran(study, store, pretender()) == ["arm/nilbs", "arm/scores", "arm/far"]


def test_a_damaged_result_is_none(store, pretender) -> None:
    study = a_plan()
    ran(study, store, pretender())
    path = store.folder / "results" / "arm" / "scores.json"
    for text in ("", "{", "[]", '{"kind": "score"}', json.dumps({**json.loads(path.read_text()), "result": 3})):
        path.write_text(text)
        assert store.result(study.jobs[1]) is None


@pytest.mark.parametrize(
    "spoil",
    [
        lambda result: result.clear(),
        lambda result: result.pop("wall_seconds"),
        lambda result: result.update(wall_seconds="long"),
        lambda result: result.pop("scores"),
        lambda result: result.update(scores=[1]),
        lambda result: result["scores"].pop("controls"),
        lambda result: result["scores"].update(poses=None),
        lambda result: result["scores"].update(poses={"unseen": "x"}),
        lambda result: result["scores"].update(rows={"floor": {"unseen": "x"}}),
        lambda result: result["scores"].update(controls={"perfect": 5}),
        lambda result: result["scores"].update(controls={"perfect": {"iou_bbox": "x"}}),
        lambda result: result.update(wall_seconds=10**400),
    ],
)
def test_a_result_that_lacks_what_such_a_job_makes_is_none(spoil, store, pretender) -> None:
    study = a_plan()
    ran(study, store, pretender())
    path = store.folder / "results" / "arm" / "scores.json"
    contents = json.loads(path.read_text())
    spoil(contents["result"])
    path.write_text(json.dumps(contents))
    assert ran(study, store, pretender()) == ["arm/scores"]


@pytest.mark.parametrize(
    "pictures", [None, ["x"], [{"title": "x", "caption": "x"}], [{"title": "x", "caption": "x", "file": 7}]]
)
def test_pictures_that_are_none_are_made_again(pictures, store, pretender) -> None:
    study = plan(quick_scale())
    run(study, store, [pretender()], report=lambda line: None)
    job = next(job for job in study.jobs if job.kind == "picture")
    store.write(job, {**store.result(job), "pictures": pictures})
    assert not store.done(job, study)


def test_only_pictures_of_the_study_get_into_a_report(store, tmp_path) -> None:
    (store.folder / "pictures").mkdir(parents=True)
    for name in ("secret.png", "pictures/mine.png", "pictures/notes.txt"):
        (store.folder / name).touch()
    (store.folder / "pictures" / "link.png").symlink_to(store.folder / "secret.png")
    assert store.picture("pictures/mine.png").samefile(store.folder / "pictures" / "mine.png")
    for name in ("secret.png", "pictures/../secret.png", "pictures/link.png", "pictures/notes.txt", "pictures/no.png"):
        assert store.picture(name) is None
    for name in (str(store.folder / "secret.png"), "pictures/\0.png", f"pictures/{'x' * 5000}.png", "pictures", ""):
        assert store.picture(name) is None


def test_a_model_that_cannot_be_read_is_trained_again(store, pretender, capfd) -> None:
    study = a_plan()
    ran(study, store, pretender())
    (store.folder / "results" / "arm" / "scores.json").unlink()
    training, scoring, _ = study.jobs
    spec = {"training": training.key, "noise": 0.006, **scoring.spec}
    assert not do(Job(scoring.key, "score", spec, training.key), store, None)
    assert "the same command trains it again" in str(store.failure(Job(scoring.key, "score", spec, training.key)))
    assert not store.done(training, study)
    assert ran(study, store, pretender()) == ["arm/nilbs", "arm/scores", "arm/far"]


def test_what_was_left_half_written_is_swept_away_and_nothing_else(store, pretender) -> None:
    study = a_plan()
    ran(study, store, pretender())
    kept = {path for path in store.folder.rglob("*") if path.is_file()}
    for place in ("models/arm/.nilbs.nilbs.0a1b2c3d.part", "results/arm/.far.json.12345678.part"):
        (store.folder / place).write_bytes(b"half")
    (store.folder / "my notes.part").write_text("mine")
    (store.folder / "results" / ".mine.part").mkdir()
    store.sweep()
    assert {path for path in store.folder.rglob("*") if path.is_file()} == kept | {store.folder / "my notes.part"}


def test_a_model_that_is_not_kept_goes_when_all_that_need_it_are_done(store, pretender) -> None:
    study = a_plan(keep=False)
    ran(study, store, pretender(), jobs=study.jobs[:2])
    assert store.model("arm/nilbs").is_file()
    ran(study, store, pretender())
    assert not store.model("arm/nilbs").exists()
    assert ran(study, store, pretender()) == []


def test_a_failure_is_recorded_and_the_others_go_on(store, pretender) -> None:
    study, lines = a_plan(), []
    worker = pretender(failing=("arm/scores",))
    failed = run(study, store, [worker], report=lines.append)
    assert failed == {"arm/scores": "ValueError: it would <not> & could not"}
    assert worker.did == ["arm/nilbs", "arm/scores", "arm/far"]
    assert next(line for line in lines if "FAILED" in line).startswith(
        "[2/3] arm/scores ... 0:00 min FAILED: ValueError"
    )
    assert ran(study, store, pretender()) == ["arm/scores"]
    assert store.failure(study.jobs[1]) is None


def test_what_needs_a_training_that_failed_is_not_run(store, pretender) -> None:
    study = a_plan()
    worker = pretender(failing=("arm/nilbs",))
    failed = run(study, store, [worker], report=lambda line: None)
    assert worker.did == ["arm/nilbs"]
    assert list(failed) == ["arm/nilbs", "arm/scores", "arm/far"]
    assert store.failure(study.jobs[2]) == "its training failed: arm/nilbs"


def test_a_stop_loses_only_the_job_at_work(store, pretender) -> None:
    study, worker = a_plan(), pretender()

    def stopped(job: Job) -> bool:
        if job.key == "arm/far":
            raise KeyboardInterrupt
        return worker(job)

    with pytest.raises(KeyboardInterrupt):
        run(study, store, [stopped], report=lambda line: None)
    assert ran(study, store, pretender()) == ["arm/far"]


def test_two_at_once_wait_for_what_they_need(store, pretender) -> None:
    """The second worker has nothing to do until the training is done; then both score at the same time."""
    study, worker, together = a_plan(), pretender(), Barrier(2, timeout=20)

    def patient(job: Job) -> bool:
        if job.kind != TRAIN:
            together.wait()
        return worker(job)

    assert run(study, store, [patient, patient], report=lambda line: None) == {}
    assert worker.did[0] == "arm/nilbs"
    assert sorted(worker.did[1:]) == ["arm/far", "arm/scores"]


@pytest.fixture
def busy(store, tmp_path, monkeypatch) -> Worker:
    """A worker whose process answers nothing for a minute."""
    store.folder.mkdir()
    program = tmp_path / "busy"
    program.write_text("#!/bin/sh\nsleep 60\n")
    program.chmod(0o755)
    monkeypatch.setattr("benchmarks.study.runner.sys.executable", str(program))
    return Worker(store, None)


def test_a_worker_that_is_stopped_leaves_no_failure(store, busy) -> None:
    job, lines = Job("a", "twist", {}), []
    Timer(0.5, busy.stop).start()
    with pytest.raises(Stopped):
        run(Plan((job,), ()), store, [busy], report=lines.append)
    assert store.failure(job) is None
    assert not lines


def test_a_stop_that_finds_no_process_yet_is_heard(busy, monkeypatch) -> None:
    start, processes = Worker._start, []

    def stopped_first(worker: Worker):
        worker.stop()
        processes.append(start(worker))
        return processes[0]

    monkeypatch.setattr(Worker, "_start", stopped_first)
    with busy as worker, pytest.raises(Stopped):
        worker(Job("a", "twist", {}))
    assert worker._process is None
    assert processes[0].returncode == -signal.SIGKILL  # it was not left to end by itself


def test_progress_shows_the_number_of_the_job_its_time_and_the_time_left(store, pretender) -> None:
    lines: list[str] = []
    run(a_plan(), store, [pretender()], report=lines.append)
    assert lines[0].startswith("[1/3] arm/nilbs ... 0:00 min, about 0:02 h left")
    assert lines[-1] == "[3/3] arm/far ... 0:00 min"


def test_the_worker_records_why_a_job_fails(store) -> None:
    job = Job("nobody/nilbs", TRAIN, {"character": "nobody", "frames": 3, "minutes": None, "seed": 0, "settings": {}})
    assert not do(job, store, None)
    assert store.failure(job) == "KeyError: 'nobody'"
    assert store.result(job) is None


@pytest.mark.parametrize("fresh", [True, False])
def test_workers_are_processes_that_outlive_a_failed_job_only(fresh, store) -> None:
    store.folder.mkdir()
    spec = {"frames": 3, "minutes": None, "seed": 0, "settings": {}}
    jobs = [Job(name, TRAIN, {"character": name, **spec}) for name in ("nobody", "somebody")]
    with Worker(store, None, fresh=fresh) as work:
        assert [work(job) for job in jobs] == [False, False]
    assert [store.failure(job) for job in jobs] == ["KeyError: 'nobody'", "KeyError: 'somebody'"]
    assert "--- nobody" in (store.folder / "log.txt").read_text()


def test_a_process_that_dies_is_a_failure(store, monkeypatch) -> None:
    store.folder.mkdir()
    monkeypatch.setattr("benchmarks.study.runner.sys.executable", "false")
    job = Job("a", "twist", {})
    with Worker(store, None) as work:
        assert not work(job)
    assert store.failure(job) == "the process ended with status 1"


def test_the_whole_quick_plan_runs_by_a_pretender(store, pretender) -> None:
    study, worker = plan(quick_scale()), pretender()
    assert run(study, store, [worker], report=lambda line: None) == {}
    assert worker.did == [job.key for job in study.jobs]
    assert ran(study, store, pretender()) == []


def test_one_study_at_a_time_works_in_a_folder(store) -> None:
    pytest.importorskip("fcntl")
    store.folder.mkdir()
    with store.alone(), pytest.raises(ValueError, match=r": another study is at work in this folder$"), store.alone():
        pass
    with store.alone():  # and again when it has ended
        pass
