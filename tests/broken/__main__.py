"""Solve for the weights of every broken kind, each in a process of its own, and print what came of it.

PYTHONPATH=tests python -m broken [NAME ...] [--seed N] [--seconds 60]
"""

import argparse
import multiprocessing
import resource
import signal
import sys
from multiprocessing.connection import Connection

from . import figures, rigs, surfaces  # noqa: F401  (they fill the list)
from .case import KINDS
from .verdict import verdict

LIMIT = 30.0  # seconds; the tests assert no speed


def _judge(name: str, seed: int, seconds: int, answer: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    try:
        found = verdict(KINDS[name], seed)
        lines = found.problems + ((f"took {found.seconds:.0f} s",) if found.seconds > LIMIT else ())
        row = (found.outcome, found.seconds, found.notes, found.row_error)
    except Exception as error:
        import traceback

        place = traceback.extract_tb(error.__traceback__)[-1]
        lines = (f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})",)
        row = (type(error).__name__, 0.0, (), 0.0)
    answer.send((*row, lines, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6))


def main() -> int:
    parser = argparse.ArgumentParser(prog="broken", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="kinds, or beginnings of their names; all of them by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--seconds", type=int, default=60, help="of the processor's time, after which a kind is stopped"
    )
    given = parser.parse_args()
    chosen = [name for name in KINDS if not given.names or name.startswith(tuple(given.names))]
    failed = 0
    print(f"{'kind':40} {'outcome':10} {'s':>5} {'GB':>5} {'row sums':>8}  notes and problems")
    for name in chosen:
        receiving, sending = multiprocessing.Pipe(duplex=False)
        process = multiprocessing.Process(target=_judge, args=(name, given.seed, given.seconds, sending))
        process.start()
        sending.close()
        try:
            answer = receiving.recv()
            process.join()
        except EOFError:
            process.join()
            late = process.exitcode in (-signal.SIGXCPU, -signal.SIGKILL)
            why = f"not done in {given.seconds} s" if late else f"the process died (exit code {process.exitcode})"
            answer = ("none", float(given.seconds), (), 0.0, (why,), 0.0)
        outcome, seconds, notes, row_error, problems, memory = answer
        failed += bool(problems)
        word = outcome if outcome in ("weights", "none") else "error"
        print(f"{name:40} {word:10} {seconds:5.1f} {memory:5.2f} {row_error:8.1e}")
        if word == "error":
            print(f"    error: {outcome}")
        for note in notes:
            print(f"    note: {note}")
        for problem in problems:
            print(f"  * PROBLEM: {problem}")
        sys.stdout.flush()
    print(f"{len(chosen) - failed} of {len(chosen)} kinds as they must be")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
