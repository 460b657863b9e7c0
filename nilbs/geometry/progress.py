"""How far a long computation is, on standard error: a bar in a terminal, else a line now and then."""

import sys
from collections.abc import Iterable
from time import monotonic
from typing import Any

from tqdm import tqdm

SECONDS = 10.0  # between two lines
SHOWN = True  # False switches all off


def progress_bar(items: Iterable | None = None, *, shown: bool = True, form: str | None = None, **options: Any) -> tqdm:
    """A bar of tqdm around items, or for `update`; no carriage returns where standard error is no terminal.

    Parameters
    ----------
    items : iterable, optional
        What is counted; without it, give `total` and call `update`.
    shown : bool
        False shows nothing.
    form : str, optional
        tqdm's `bar_format` in a terminal.
    **options
        tqdm's: `desc`, `total`, `unit`, ...

    Examples
    --------
    >>> list(progress_bar([3, 4], desc="frames"))
    [3, 4]
    """
    disable = not (shown and SHOWN)
    if getattr(sys.stderr, "isatty", bool)():
        return tqdm(items, disable=disable, bar_format=form, **{"delay": 2} | options)
    return _Lines(items, disable=disable, miniters=1, mininterval=0, **options)


class _Lines(tqdm):
    """A line every `SECONDS`, for log files; none if all is done before."""

    disable: bool
    monitor_interval = 0  # no thread
    _FORM = "{desc}: {percentage:.0f} %, {elapsed} passed, {remaining} left{postfix}"

    def __init__(self, items: Iterable | None = None, **options: Any) -> None:
        self._next = monotonic() + SECONDS
        self._some = False
        super().__init__(items, bar_format=self._FORM, **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Print a line if one is due."""
        if monotonic() >= self._next:
            self._next = monotonic() + SECONDS
            self._print()
        return True

    def close(self) -> None:
        """Print how it ended, if there were lines before."""
        if not self.disable:
            self.disable = True
            self._decr_instances(self)
            if self._some:
                self._print()

    def _print(self) -> None:
        self._some = True
        print(self, file=self.fp, flush=True)
