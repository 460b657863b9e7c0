"""`python -m benchmarks.study`: train and score every method on the same characters, and report."""

import argparse
import sys
from collections.abc import Sequence

from benchmarks.study.command import add_arguments, run
from nilbs.app.main import exit_status


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; the status is that of `nilbs.app.main.main`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.study", description=__doc__.partition(": ")[2])
    add_arguments(parser)
    args = parser.parse_args(argv)
    return exit_status(lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())
