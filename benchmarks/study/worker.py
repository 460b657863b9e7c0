"""Does jobs of the study, in a process of its own: `python -m benchmarks.study.worker`.

Reads a job a line on standard input and answers a line on standard output, "done" or "failed"; the results are in the
study's folder. All else that is printed goes to standard error.
"""

import hashlib
import json
import os
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

from benchmarks.study.characters import motion_of, prepared
from benchmarks.study.jobs import FAILURES, PICTURE, SCORE, TRAIN, TWIST, Job
from benchmarks.study.store import Store
from nilbs.app.memory import peak_memory_mib
from nilbs.models.protocol import IOUS

if TYPE_CHECKING:
    from nilbs.models.model import Model

_WATCH = 2.0  # seconds between checks whether the parent process is still there


def main() -> None:
    """Do jobs until standard input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    for line in sys.stdin:
        request = json.loads(line)
        data = None if request["data"] is None else Path(request["data"])
        ok = do(Job(**request["job"]), Store(Path(request["folder"])), data)
        answers.write("done\n" if ok else "failed\n")
        answers.flush()


def do(job: Job, store: Store, data: Path | None) -> bool:
    """Do a job and keep its result, or the reason why there is none.

    Parameters
    ----------
    job : Job
    store : Store
    data : path, optional
        Folder of the real meshes.

    Returns
    -------
    ok : bool
        False where it failed; any error of the job itself is recorded and not raised.
    """
    print(f"--- {job.key}", file=sys.stderr, flush=True)
    start = perf_counter()
    try:
        result = _KINDS[job.kind](job, store, data)
        store.write(job, {**result, "wall_seconds": perf_counter() - start})
        if job.kind == TRAIN:  # not before its result is safe too
            _checkpoint(job, store).unlink(missing_ok=True)
    except Exception as error:  # one failed job must not end the study
        details = traceback.format_exc()
        sys.stderr.write(details)
        message = " ".join(str(error).split())
        store.fail(job, f"{type(error).__name__}: {message}" if message else type(error).__name__, details)
        return False
    return True


def _train(job: Job, store: Store, data: Path | None) -> Mapping[str, Any]:
    from nilbs.io.errors import FileFormatError
    from nilbs.models.fitting import fit, remove_checkpoint

    spec, path = job.spec, store.model(job.key)
    path.parent.mkdir(parents=True, exist_ok=True)
    character = prepared(spec["character"], store.folder / "characters", data, report=_tell)
    motion = motion_of(spec["character"], character, data, frames=spec["frames"], seed=spec["seed"])
    changes = dict(spec["settings"]) | {"seed": spec["seed"]}
    if spec["minutes"] is not None:
        changes["minutes"] = spec["minutes"]
    checkpoint = _checkpoint(job, store)
    changes |= {"device": "cpu", "checkpoint": checkpoint, "resume": True, "progress": True, "report": _tell}
    resumed, start = checkpoint.exists(), perf_counter()
    try:
        model = fit(character, motion, **changes)
    except FileFormatError as error:
        if not resumed:
            raise
        _tell(f"{error}; the training starts again")
        remove_checkpoint(checkpoint)
        resumed, start = False, perf_counter()
        model = fit(character, motion, **changes)
    seconds = perf_counter() - start
    model.save(path)
    return {
        "stamp": os.urandom(8).hex(),
        "seconds": seconds,
        "resumed": resumed,  # then the seconds are of the last piece only
        "steps": len(model.history),
        "loss": float(model.history[-100:].mean()) if len(model.history) else None,
        "frames": len(motion),
        "motion": motion.source,
        "bones": len(character.skeleton.BE),
        "vertices": len(character.V),
        "file_bytes": path.stat().st_size,
        "peak_memory_mib": peak_memory_mib(),
    }


def _checkpoint(job: Job, store: Store) -> Path:
    """Where a training is kept while it runs; named after its spec, so that other settings have another file."""
    path, digest = store.model(job.key), hashlib.sha256(json.dumps(job.spec, sort_keys=True).encode())
    return path.with_name(f"{path.stem}.{digest.hexdigest()[:12]}.checkpoint")


def _model(job: Job, store: Store) -> "Model":
    """The model that a job reads; one that cannot be read is to be trained again."""
    from nilbs.io.errors import FileFormatError
    from nilbs.models.model import load_model

    try:
        return load_model(store.model(job.spec["training"]))
    except FileFormatError as error:
        store.forget(Job(job.spec["training"], TRAIN, job.spec["of"]))
        raise ValueError(f"{error}; the same command trains it again") from None


def _score(job: Job, store: Store, data: Path | None) -> Mapping[str, Any]:
    from nilbs.models.evaluation import evaluate

    spec = job.spec
    scores = evaluate(
        _model(job, store),
        points=spec["points"],
        resolution=spec["resolution"],
        seed=spec["seed"],
        poses=spec["poses"],
        rows=spec["rows"],
        noise=spec["noise"],
        ious=spec.get("ious", IOUS),
        distances=spec["distances"],
        progress=True,
    )
    return {"trained": _stamp(job, store), "scores": scores.values}


def _picture(job: Job, store: Store, data: Path | None) -> Mapping[str, Any]:
    from nilbs.figures import reconstruction_figure
    from nilbs.models.evaluation import evaluation_poses

    model = _model(job, store)
    sets = {name: evaluation_poses(model.character, model.motion, name, seed=0) for name in ("seen", "unseen", "far")}
    # Not the first frame of a motion, which often is the rest pose.
    poses = {f"{name} pose {len(B) // 2}": B[len(B) // 2] for name, B in sets.items() if len(B)}
    path = store.folder / "pictures" / f"{model.character.name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    reconstruction_figure(model, path, poses=poses, resolution=job.spec["resolution"])
    caption = "True surfaces above, reconstructed ones below, coloured by their distance to the true one."
    picture = {"title": model.character.name, "caption": caption, "file": path.relative_to(store.folder).as_posix()}
    return {"trained": _stamp(job, store), "pictures": [picture]}


def _twist(job: Job, store: Store, data: Path | None) -> Mapping[str, Any]:
    from benchmarks.study.twist import twist_table

    return {"table": [dict(row) for row in twist_table(**_made(job.spec))]}


def _failures(job: Job, store: Store, data: Path | None) -> Mapping[str, Any]:
    from benchmarks.study.failures import failure_figures

    folder = store.folder / "pictures" / "failures"
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [
        {"title": title, "caption": caption, "file": Path(path).relative_to(store.folder).as_posix()}
        for title, caption, path in failure_figures(folder, **_made(job.spec))
    ]
    return {"pictures": pictures}


def _made(spec: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a job's function: its spec without the digests that only mark other code's results."""
    return {name: value for name, value in spec.items() if name != "defaults"} | {"device": "cpu"}


_KINDS: Mapping[str, Callable[[Job, Store, Path | None], Mapping[str, Any]]] = {
    TRAIN: _train,
    SCORE: _score,
    PICTURE: _picture,
    TWIST: _twist,
    FAILURES: _failures,
}


def _stamp(job: Job, store: Store) -> str | None:
    """The stamp of the training whose model a job reads."""
    assert job.needs is not None
    training = store.result(Job(job.needs, TRAIN, job.spec["of"]))
    return None if training is None else str(training["stamp"])


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _end_with(parent: int) -> None:
    """End this process when its parent ends."""
    while os.getppid() == parent:
        sleep(_WATCH)
    os._exit(1)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main()
