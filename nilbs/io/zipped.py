"""Members of a zip archive, never more than a fixed size of them, whatever sizes the archive claims."""

import io
import os
import struct
import zipfile
import zlib

from nilbs.io.bounded import SIZE_LIMIT, file_bytes
from nilbs.io.errors import FileFormatError

_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# What the standard library raises for an archive that is cut, damaged or encrypted.
_DAMAGES = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, ValueError, OSError)


def open_zip(path: str | os.PathLike) -> zipfile.ZipFile:
    """An archive, read into memory."""
    return opened(path, file_bytes(path))


def opened(path: str | os.PathLike, data: bytes) -> zipfile.ZipFile:
    """The archive in the bytes of a file."""
    try:
        return zipfile.ZipFile(io.BytesIO(data))
    except _DAMAGES as error:
        raise _damaged(path, error) from None


def unpacked(path: str | os.PathLike, archive: zipfile.ZipFile, name: str, *, limit: int | None = None) -> bytes:
    """The content of a member; it must not be empty."""
    limit, found = limit or SIZE_LIMIT, archive.getinfo(name)
    if found.compress_type not in _PACKINGS or not 0 < found.file_size <= limit:
        raise FileFormatError(path, f"{name} is empty, larger than {limit >> 20} MiB or packed in an unknown way")
    try:
        with archive.open(found) as file:
            return file.read(found.file_size)
    except _DAMAGES as error:
        raise _damaged(path, error) from None


def _damaged(path: str | os.PathLike, error: Exception) -> FileFormatError:
    return FileFormatError(path, f"damaged {os.path.splitext(path)[1]} file: {error}")
