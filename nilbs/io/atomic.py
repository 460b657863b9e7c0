"""Files that are replaced in one step or not at all."""

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

# How the names of files end that are not finished.
PART = ".part"


@contextmanager
def replacing(path: str | os.PathLike, mode: str = "wb") -> Iterator[Any]:
    """Open a new file that takes the place of `path` when the block ends well.

    What is written goes to a hidden file in the same folder, reaches the disk, and is renamed. On any error, an
    interrupt included, the hidden file goes and `path` is as it was.

    Parameters
    ----------
    path : str or path
        The file to write. A symbolic link is followed. A device such as /dev/null is written to directly.
    mode : "wb" or "w"
        Text is UTF-8 with Unix line ends.

    Yields
    ------
    file : file object

    Raises
    ------
    OSError
        With `path` as its file name, also where the system gives none (a full disk).

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "note.txt"
    >>> with replacing(path, "w") as file:
    ...     _ = file.write("done")
    >>> path.read_text()
    'done'
    """
    target = Path(os.path.realpath(path))
    # To rename over a device would put a plain file in its place.
    written = target if _is_device(target) else target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}{PART}")
    creation = "x" if written != target else "w"
    text: dict[str, Any] = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}
    try:
        _check_folder(target)
        with open(written, mode.replace("w", creation), **text) as file:
            yield file
            file.flush()
            if written != target:
                os.fsync(file.fileno())
        if written != target:
            os.replace(written, target)
    except OSError as error:
        if error.filename is None or os.fspath(error.filename) == os.fspath(written):
            error.filename, error.filename2 = os.fspath(path), None
        raise
    finally:
        if written != target:
            with suppress(FileNotFoundError, NotADirectoryError):
                os.unlink(written)


def check_writable(path: str | os.PathLike, *, inputs: Iterable[str | os.PathLike] = ()) -> None:
    """Check that a file can be written, before the work that it is to hold.

    Parameters
    ----------
    path : str or path
    inputs : iterable of str or path
        Files that the work is made from, which it must not replace.

    Raises
    ------
    OSError
        If `path` is a folder or one of the inputs, or its folder does not exist or cannot be written to.

    Examples
    --------
    >>> check_writable("no/such/folder/file.npz")
    Traceback (most recent call last):
    FileNotFoundError: [Errno 2] the folder does not exist: 'no/such/folder'
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(21, "this is a folder, not a file to write", os.fspath(path))
    if target.is_file() and any(os.path.exists(file) and os.path.samefile(file, target) for file in inputs):
        raise FileExistsError(17, "this file is read too and would be lost: write to another", os.fspath(path))
    try:
        _check_folder(target)
    except FileNotFoundError as error:
        error.filename = os.fspath(Path(path).parent)
        raise
    if not os.access(target if _is_device(target) else target.parent, os.W_OK):
        raise PermissionError(13, "this place cannot be written to", os.fspath(path))


def _is_device(target: Path) -> bool:
    return target.exists() and not target.is_file() and not target.is_dir()


def _check_folder(target: Path) -> None:
    if not target.parent.is_dir():
        raise FileNotFoundError(2, "the folder does not exist", os.fspath(target.parent))
