"""A study whose jobs take no time: scores are made up, by rules that a test can repeat."""

from pathlib import Path
from zlib import crc32

import pytest

from benchmarks.study.jobs import SCORE, TRAIN, Job
from benchmarks.study.store import Store


def made_up_iou(job: Job, poses: str, row: str = "") -> float:
    """0.9, less 0.01 for each seed, less 0.1 for a row, and a little that depends on all else that is scored."""
    of = {name: value for name, value in job.spec["of"].items() if name != "seed"}
    scored = repr([sorted(of.items(), key=str), job.spec.get("noise"), poses, row])
    return 0.9 - 0.01 * job.spec["seed"] - 0.1 * bool(row) - 1e-4 * (crc32(scored.encode()) % 90)


def made_up_scores(job: Job) -> dict:
    """Surface IoU by `made_up_iou`; perfect controls."""

    def sets(row: str) -> dict:
        return {poses: one(poses, row) for poses in job.spec["poses"]}

    def one(poses: str, row: str) -> dict:
        surface = made_up_iou(job, poses, row)
        scores = {"iou_bbox": {"mean": 0.99, "worst": 0.98}, "iou_surface": {"mean": surface, "worst": surface - 0.05}}
        scores["lookups"] = {"mean": 4.0, "worst": 5.0}
        if job.spec["distances"]:
            scores |= {"distance_error": {"mean": 0.1, "worst": 1}, "posed_distance_error": {"mean": 0.03, "worst": 1}}
        if job.spec["resolution"]:
            scores["chamfer_l1"] = {"mean": 0.05, "worst": 0.06}
        return scores

    ones = {"iou_bbox": 1.0, "iou_surface": 1.0}
    zeros = {"iou_bbox": 0.0, "iou_surface": 0.0}
    return {
        "poses": sets(""),
        "rows": {row: sets(row) for row in job.spec["rows"]},
        "query_seconds": dict.fromkeys(["", *job.spec["rows"]], 0.5),
        "controls": {"perfect": ones, "empty": zeros, "inverted": zeros},
    }


class Pretender:
    """Does jobs by writing what they could have found; remembers which it did."""

    def __init__(self, store: Store, *, failing: tuple[str, ...] = ()) -> None:
        self.store, self.failing, self.did = store, failing, []

    def __call__(self, job: Job) -> bool:
        self.did.append(job.key)
        if job.key in self.failing:
            self.store.fail(job, "ValueError: it would <not> & could not")
            return False
        result = {"wall_seconds": 1.0}
        if job.kind == TRAIN:
            model = self.store.model(job.key)
            model.parent.mkdir(parents=True, exist_ok=True)
            model.write_bytes(b"model")
            result |= {"stamp": f"{job.key} {len(self.did)}", "seconds": 120.0, "steps": 100, "resumed": False}
            result["frames"] = min(job.spec.get("frames", 0), 60 if job.spec.get("character") == "elephant" else 1000)
        elif job.kind == SCORE:
            result["scores"] = made_up_scores(job)
        elif job.kind == "twist":
            result["table"] = [{"degrees": 0, "lbs": 1.0, "inverse": 1.001}, {"degrees": 150, "lbs": 0.6, "inverse": 1}]
        else:
            result["pictures"] = []
        if job.needs is not None:
            result["trained"] = self.store.result(Job(job.needs, TRAIN, job.spec["of"]))["stamp"]
        self.store.write(job, result)
        return True


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "study")


@pytest.fixture
def pretender(store: Store):
    return lambda **options: Pretender(store, **options)


@pytest.fixture
def surface_iou():
    """What was made up: of a job, a pose set and a row."""
    return made_up_iou
