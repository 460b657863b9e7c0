"""Words of a text file as numbers, with the line of the one that is none."""

import os
import re

import numpy as np

from nilbs.io.errors import FileFormatError

_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_INTEGER = re.compile(rb"[+-]?\d{1,18}")


def finite_numbers(path: str | os.PathLike, words: list[bytes], lines: list[int]) -> np.ndarray:
    """Decimal numbers (l, w), the same count of them from every line; FileFormatError with the line of a bad one.

    Examples
    --------
    >>> finite_numbers("a.off", [b"1", b"2.5"], [7])
    array([[1. , 2.5]])
    """
    try:
        values = np.array([float(word) for word in words], dtype=np.float64)
        legal = b"_" not in b"".join(words) and bool(np.isfinite(values).all())  # float() reads 1_0 as 10
    except ValueError:
        legal = False
    if not legal:
        bad = next(i for i, word in enumerate(words) if not is_number(word))
        line = lines[bad // (len(words) // len(lines))]
        raise FileFormatError(path, f"{_shown(words[bad])} is not a finite number", line)
    return values.reshape(len(lines), -1)


def is_number(word: bytes) -> bool:
    """Whether a word is a finite decimal number.

    Examples
    --------
    >>> is_number(b"-1e3"), is_number(b"1e"), is_number(b"1e999")
    (True, False, False)
    """
    return bool(_NUMBER.fullmatch(word)) and bool(np.isfinite(float(word)))


def whole_numbers(path: str | os.PathLike, words: list[bytes], counts: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Whole numbers (w,) of at most 18 digits, `counts` (l,) of them from each line; FileFormatError with its line."""
    try:
        values = np.array([int(word) for word in words], dtype=np.int64)
        legal = b"_" not in b"".join(words)
    except (ValueError, OverflowError):
        legal = False
    if not legal:
        bad = next(i for i, word in enumerate(words) if not _INTEGER.fullmatch(word))
        line = int(lines[np.searchsorted(np.cumsum(counts), bad, side="right")])
        raise FileFormatError(path, f"{_shown(words[bad])} is not a whole number", line)
    return values


def _shown(word: bytes) -> str:
    return repr(word[:40].decode("ascii", "replace"))
