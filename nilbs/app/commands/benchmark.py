"""`nilbs benchmark`: the model beside libraries that query the posed mesh."""

import argparse
from typing import TYPE_CHECKING

from nilbs.app.options import add_json, add_seed, positive, whole

if TYPE_CHECKING:
    from pathlib import Path

    from nilbs.race.results import Results

FILES = ("benchmark.json", "benchmark.csv", "benchmark.txt", "report.html")

EXAMPLE = "nilbs benchmark hero.nilbs --quick -o bench"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model in space, .nilbs")
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER",
        help="also write benchmark.json, benchmark.csv, benchmark.txt, plots and report.html, a page of all, here",
    )
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument(
        "--quick",
        action="store_true",
        help="a few minutes: 100,000 points a pose on the given and the finest mesh, and a stream of 1,000 poses",
    )
    extent.add_argument(
        "--full", action="store_true", help="all sizes, however long they take; else slow ones are marked and not run"
    )
    parser.add_argument(
        "--large", action="store_true", help="divide triangles once more: up to 3,200,000 of them, not 800,000"
    )
    parser.add_argument(
        "--contestants",
        nargs="+",
        default=(),
        metavar="NAME",
        help="who takes part beside nilbs, by the names in the table; all that are installed by default",
    )
    parser.add_argument(
        "--threads", type=whole(1, 4096), metavar="N", help="cores to use, beside one alone (default: all)"
    )
    parser.add_argument(
        "--minutes",
        type=positive,
        default=60.0,
        metavar="N",
        help="what has not begun after N minutes is not run (default 60; with --full there is no limit)",
    )
    add_seed(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Measure, write and report."""
    from functools import partial
    from pathlib import Path

    from nilbs.app.output import show
    from nilbs.io import check_writable
    from nilbs.race.plan import LARGE, TRIANGLES, levels, quick
    from nilbs.race.plan import whole as all_sizes
    from nilbs.race.runner import LIMIT, QUICK_LIMIT, cores, race
    from nilbs.race.table import table

    folder = None if args.out is None else Path(args.out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        for name in FILES:
            check_writable(folder / name)
    threads = args.threads or cores()
    if threads > cores():
        raise ValueError(f"--threads {threads}: this process may use {cores()} cores")
    kind = quick if args.quick else partial(all_sizes, full=args.full)
    most = LARGE if args.large else TRIANGLES
    results = race(
        args.model,
        lambda triangles: kind(levels(triangles, most=most), threads=threads),
        contestants=args.contestants,
        limit=float("inf") if args.full else QUICK_LIMIT if args.quick else LIMIT,
        minutes=float("inf") if args.full else args.minutes,
        seed=args.seed,
        progress=True,
    )
    text = table(results)
    if folder is not None:
        _write(results, text, folder, args.model)
    show(results.values(), as_json=args.json, table=text)
    if results.interrupted:
        interrupt = KeyboardInterrupt()
        interrupt.add_note("what was measured is printed" + ("" if folder is None else f", and in {folder}"))
        raise interrupt


def _write(results: "Results", text: str, folder: "Path", model: str) -> None:
    import json

    from nilbs.figures.race import race_figures
    from nilbs.io.atomic import replacing
    from nilbs.io.strict_json import plain
    from nilbs.models.model import load_model
    from nilbs.reports.benchmark import write_benchmark_page

    values = plain(results.values())
    with replacing(folder / "benchmark.json", "w") as file:
        file.write(json.dumps(values, indent=1, allow_nan=False) + "\n")
    results.write_csv(folder / "benchmark.csv")
    with replacing(folder / "benchmark.txt", "w") as file:
        file.write(text + "\n")
    pictures = race_figures(values, folder)
    write_benchmark_page(folder, load_model(model).character, values, pictures=pictures)
