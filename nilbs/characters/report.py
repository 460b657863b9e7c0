"""How decisions that a user left open are told: to a function that takes a sentence on each."""

from collections.abc import Callable

Report = Callable[[str], None]


def silent(line: str) -> None:
    """Tell nobody."""
