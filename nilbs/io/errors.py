"""The one error of a file that does not hold what it should."""

import os
from pathlib import Path

from nilbs.io.names import printable


class FileFormatError(ValueError):
    """A file that cannot be read as what it claims to be.

    Parameters
    ----------
    path : str or path
        The file.
    message : str
        What is wrong with it.
    line : int, optional
        Where, counted from 1, in a file of lines.

    Examples
    --------
    >>> print(FileFormatError("arm.obj", "a face needs three corners", 12))
    arm.obj:12: a face needs three corners
    """

    def __init__(self, path: str | os.PathLike, message: str, line: int | None = None) -> None:
        super().__init__(path, message, line)  # as received, so that the error can be pickled
        self.path = os.fspath(path)
        self.message = printable(message)  # whatever it quotes stays on one line
        self.line = line

    def __str__(self) -> str:
        place = self.path if self.line is None else f"{self.path}:{self.line}"
        return f"{place}: {self.message}"


def check_suffix(path: str | os.PathLike, *allowed: str) -> str:
    """Return the lower-case suffix of a file name, if it is one of those allowed.

    Raises
    ------
    FileFormatError
        If it is another, or there is none.

    Examples
    --------
    >>> check_suffix("posed.OBJ", ".obj", ".ply")
    '.obj'
    """
    suffix = Path(path).suffix.lower()
    if suffix not in allowed:
        got = f"not {suffix}" if suffix else "and this one has none"
        raise FileFormatError(path, f"the file name must end in {' or '.join(allowed)}, {got}")
    return suffix
