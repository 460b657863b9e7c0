"""The contents of a file, never more than a fixed size of them."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from nilbs.io.errors import FileFormatError

SIZE_LIMIT = 2**31  # bytes; a larger file is refused before it is read
LINE_LIMIT = 2**20  # bytes; longer than any line of a file of text that we read
_BLOCK = 2**22  # bytes of lines held at a time: the words of a block take some twenty times its size


def file_bytes(path: str | os.PathLike, *, limit: int = SIZE_LIMIT) -> bytes:
    """All bytes of a regular file that is neither empty nor larger than the limit."""
    with _opened(path, limit) as (file, size):
        return file.read(size)  # not up to the limit: Python would make room for all of that


def line_blocks(path: str | os.PathLike) -> Iterator[tuple[int, list[bytes]]]:
    """The lines of a text file, with their ends, a few megabytes at a time; and the number, from 1, of the first.

    A NUL byte or an endless line shows that the file is no text: FileFormatError.
    """
    first = 1
    with _opened(path) as (file, _):
        while lines := file.readlines(_BLOCK):
            for number, line in enumerate(lines, first):
                if len(line) > LINE_LIMIT or b"\0" in line:
                    raise FileFormatError(path, "binary data where text was expected", number)
            yield first, lines
            first += len(lines)


@contextmanager
def _opened(path: str | os.PathLike, limit: int = SIZE_LIMIT) -> Iterator[tuple[BinaryIO, int]]:
    """The file, and its size in bytes."""
    # Opening a named pipe would wait for ever.
    if not stat.S_ISREG(os.stat(path).st_mode) and not os.path.isdir(path):
        raise FileFormatError(path, "this is not a regular file")
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            shown = f"{limit >> 30} GiB" if limit >> 30 else f"{limit >> 20} MiB"
            raise FileFormatError(path, f"the file is larger than {shown}")
        if size == 0:
            raise FileFormatError(path, "the file is empty")
        yield file, size
