"""The command of the study: train and score every method on the same characters, and report."""

import argparse
from typing import TYPE_CHECKING

from benchmarks.study.plan import PARTS
from nilbs.app.options import add_json, positive, whole

if TYPE_CHECKING:
    from pathlib import Path

    from benchmarks.study.scale import Scale

MINUTES, SEEDS = 5.0, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "--out",
        metavar="DIR",
        required=True,
        help="folder of everything that is written; the same command goes on where it was stopped",
    )
    parser.add_argument(
        "--data",
        metavar="FOLDER",
        help="folder of the real meshes (default: the environment variable NILBS_DATA); without one, only the "
        "gingerbread men are studied",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="everything once, on the gingerbread men, in minutes; numbers mean nothing",
    )
    parser.add_argument(
        "--minutes",
        type=positive,
        metavar="M",
        help="training time of the elephant and of MakeHuman's body, two fifths of it in sweeps, a fifth elsewhere "
        f"(default {MINUTES:g})",
    )
    parser.add_argument(
        "--seeds",
        type=whole(1, 100),
        metavar="N",
        help=f"seeds on the gingerbread men and the elephant; one elsewhere (default {SEEDS})",
    )
    parser.add_argument(
        "--jobs",
        type=whole(1, 256),
        metavar="N",
        help="how many trainings and scorings run at once, sharing the cores (default: one a core, each on one thread; "
        "one with --quick)",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=PARTS,
        default=tuple(PARTS),
        metavar="PART",
        help=f"run only these parts, of {', '.join(PARTS)}; the tables show all results",
    )
    add_json(parser)


def _scale(args: argparse.Namespace, data: "Path | None") -> "tuple[Scale, list[str]]":
    """The scale of the study, and sentences on characters without files."""
    from pathlib import Path

    from benchmarks.study.characters import available, made_of
    from benchmarks.study.scale import full_scale, quick_scale

    for option, value in (("--minutes", args.minutes), ("--seeds", args.seeds)):
        if args.quick and value is not None:
            raise ValueError(f"{option} cannot stand beside --quick, which does everything once")
    if args.data and not Path(args.data).is_dir():
        raise ValueError(f"{args.data}: this is no folder; --data names one that holds arm/, elephant/ and makehuman/")
    if args.quick:
        return quick_scale(), []
    characters, left_out = available(data)
    digests = {name: made_of(source, data) for name, source in characters.items()}
    scale = full_scale(list(characters), minutes=args.minutes or MINUTES, seeds=args.seeds or SEEDS, made_of=digests)
    return scale, left_out


def run(args: argparse.Namespace) -> None:
    """Plan, run what is not done, and write the tables, also when stopped."""
    import os
    import sys
    from contextlib import ExitStack
    from pathlib import Path

    from benchmarks.study.outputs import FILES, cores, write_outputs
    from benchmarks.study.plan import plan
    from benchmarks.study.runner import Worker, estimate
    from benchmarks.study.runner import run as run_jobs
    from benchmarks.study.store import FOLDERS, Store
    from nilbs.app.output import show
    from nilbs.app.poses import print_note
    from nilbs.io import check_writable

    given = args.data or os.environ.get("NILBS_DATA")
    data = Path(given) if given and not args.quick else None
    scale, left_out = _scale(args, data)
    study = plan(scale, left_out)
    if Path(args.out).is_file():
        raise ValueError(f"--out {args.out}: this is a file, and the study needs a folder")
    store = Store(Path(args.out).resolve())
    for name in FOLDERS:
        (store.folder / name).mkdir(parents=True, exist_ok=True)
    for name in FILES:
        check_writable(store.folder / name)

    def write() -> dict:
        command = ["python", "-m", "benchmarks.study", *sys.argv[1:]]
        return write_outputs(study, store, scale, command=command, quick=args.quick, lanes=lanes, threads=threads)

    for line in study.missing:
        print_note(line)
    lanes = args.jobs or (1 if args.quick else cores())
    # Jobs share the cores: more threads than cores would wait.
    given = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()  # a list has nested regions
    threads = 1 if args.quick else (int(given) if given.isdecimal() else 0) or max(1, cores() // lanes)
    jobs = study.of_parts(args.only)
    todo = [job for job in jobs if not store.done(job, study)]
    print_note(f"{len(todo)} of {len(jobs)} jobs are to be done" + (f", about {estimate(todo, lanes)}" if todo else ""))
    try:
        with ExitStack() as stack:
            stack.enter_context(store.alone())
            store.sweep()
            stack.callback(store.sweep)  # after workers that ended while they wrote
            # A small job's process would take longer to start than the job.
            workers = [
                stack.enter_context(Worker(store, data, fresh=not args.quick, threads=threads)) for _ in range(lanes)
            ]
            failed = run_jobs(study, store, workers, jobs=jobs, report=print_note)
    except KeyboardInterrupt as interrupt:
        write()
        interrupt.add_note(f"the same command goes on from here; {args.out} holds tables of what is done")
        raise
    values = write()
    files = [str(store.folder / name) for name in FILES]
    shown = {name: value for name, value in values.items() if name != "rows"} | {"files": files}
    table = "\n".join([(store.folder / "study.md").read_text(encoding="utf-8"), "written:", *(f"  {f}" for f in files)])
    show(shown if args.json else {}, as_json=args.json, table=table)
    if failed:
        for key, why in failed.items():
            print_note(f"{key} failed: {why}")
        raise ValueError(f"{len(failed)} of {len(jobs)} jobs failed; the same command tries them again")
