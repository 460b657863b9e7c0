"""The contents of a file, never more than a fixed size of them."""

import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from nilbs.io.errors import FileFormatError
from nilbs.io.text import byte_order_mark, line_feeds, utf8_lines, without_mark

SIZE_LIMIT = 2**31  # bytes; a larger file is refused before it is read
LINE_LIMIT = 2**20  # bytes; longer than any line of a file of text that we read
_BLOCK = 2**22  # bytes of lines held at a time: the words of a block take some twenty times its size


def file_bytes(path: str | os.PathLike, *, limit: int = SIZE_LIMIT) -> bytes:
    """All bytes of a regular file that is neither empty nor larger than the limit."""
    with _opened(path, limit) as (file, size):
        return file.read(size)  # not up to the limit: Python would make room for all of that


def text_bytes(path: str | os.PathLike, *, limit: int = SIZE_LIMIT) -> bytes:
    """All bytes of a text file, in UTF-8 if it starts with a byte order mark, which is left out; lines end in LF."""
    return line_feeds(without_mark(path, file_bytes(path, limit=limit)))


def line_blocks(path: str | os.PathLike, notes: list[str] | None = None) -> Iterator[tuple[int, list[bytes]]]:
    """The lines of a text file in UTF-8, with their ends, a few megabytes at a time; and the number of the first.

    Lines end in LF, CR LF or CR, and are counted from 1. `notes` receives a sentence on text that was not UTF-8. A NUL
    byte or an endless line shows that the file is no text: FileFormatError.
    """
    first = 1
    with _opened(path) as (file, _):
        size, encoding = byte_order_mark(file.read(4))
        file.seek(size if encoding == "utf-8" else 0)
        if encoding != "utf-8":
            file = io.BytesIO(without_mark(path, file.read()))
        while lines := file.readlines(_BLOCK):
            text = b"".join(lines)
            if text.count(b"\r") > text.count(b"\r\n"):
                lines = text.splitlines(keepends=True)
            lines, other = utf8_lines(lines)
            note = f"its text is not UTF-8: it was read as {other}"
            if other and notes is not None and note not in notes:
                notes.append(note)
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
