"""Decisions that a user left open are reported to a function that takes a sentence on each."""

from collections.abc import Callable

Report = Callable[[str], None]


class Detail(str):
    """A line that is of interest only to those who want to check a decision."""


def silent(line: str) -> None:
    """Report nothing."""
