"""A parser whose errors name the nearest command, option or value."""

import argparse
from collections.abc import Iterable
from typing import Any


class Parser(argparse.ArgumentParser):
    """argparse's parser; commands added to it are of this class too.

    Examples
    --------
    >>> parser = Parser(prog="cut", exit_on_error=False)
    >>> _ = parser.add_argument("--tool", choices=("knife", "saw"))
    >>> parser.parse_args(["--tool", "knive"])
    Traceback (most recent call last):
    argparse.ArgumentError: argument --tool: invalid choice: 'knive' (choose from 'knife', 'saw') (the nearest: 'knife')
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The arguments and the words that are none; an error if such a word is like an option."""
        found, words = super().parse_known_args(args, namespace)
        for word in words:
            option = word.partition("=")[0]
            meant = nearest(option, self._option_string_actions) if option.startswith("--") else ""
            if meant:
                self.error(f"unrecognized arguments: {word}{meant}")
        return found, words

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += nearest(str(value), map(str, action.choices or ()))
            raise


def nearest(name: str, names: Iterable[str]) -> str:
    """As `nilbs.geometry.nearest_names.nearest_name`, loaded when there is an error."""
    from nilbs.geometry.nearest_names import nearest_name

    return nearest_name(name, names)
