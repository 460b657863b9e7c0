"""Decisions that a user left open are reported to a function that takes a sentence on each."""

from collections.abc import Callable

Report = Callable[[str], None]


def silent(line: str) -> None:
    """Report nothing."""
