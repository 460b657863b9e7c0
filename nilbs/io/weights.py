"""Skinning weights: `.dmat` and `.npz` files."""

import io
import os
import struct
import zipfile
import zlib

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.bounded import SIZE_LIMIT, file_bytes
from nilbs.io.dmat import read_dmat, write_dmat
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.npy import npy_array

_MEMBER = "W.npy"
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that numpy writes


def read_weights(path: str | os.PathLike) -> np.ndarray:
    """Read skinning weights.

    Parameters
    ----------
    path : str or path
        A `.dmat` file, or a `.npz` file with an array named W. Nothing in it is ever run: no pickle is read.

    Returns
    -------
    W : (n, b) float array
        As the file has them: rows may not sum to one.

    Raises
    ------
    FileFormatError
        If the file holds no finite matrix.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/weights.npz"
    >>> write_weights(path, [[0.25, 0.75]])
    >>> read_weights(path)
    array([[0.25, 0.75]])
    """
    W = read_dmat(path) if check_suffix(path, ".dmat", ".npz") == ".dmat" else _read_npz(path)
    if W.ndim != 2 or W.size == 0:
        raise FileFormatError(path, f"weights must be a matrix (vertices, bones), this file holds {W.shape}")
    return W


def write_weights(path: str | os.PathLike, W: np.ndarray) -> None:
    """Write skinning weights, with every digit.

    Parameters
    ----------
    path : str or path
        A file that ends in `.dmat` or `.npz`.
    W : (n, b) float array
        Weights.

    Raises
    ------
    ValueError
        If W is not a finite matrix, or the suffix is another.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/weights.dmat"
    >>> write_weights(path, [[1.0], [1.0]])
    >>> read_weights(path).shape
    (2, 1)
    """
    if check_suffix(path, ".dmat", ".npz") == ".dmat":
        write_dmat(path, W)
        return
    (W,) = arrays(W=(W, "n b"))
    with replacing(path) as file:
        np.savez_compressed(file, W=W)


def _read_npz(path: str | os.PathLike) -> np.ndarray:
    # numpy.load would make room for whatever shape the header claims; so the header is read here and held against the
    # size of what follows it.
    data = file_bytes(path)
    member = None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = sorted(archive.namelist())
            size = archive.getinfo(_MEMBER).file_size if _MEMBER in names else 0
            if 0 < size <= SIZE_LIMIT and archive.getinfo(_MEMBER).compress_type in _PACKINGS:
                with archive.open(_MEMBER) as file:
                    member = file.read(SIZE_LIMIT)
    # What the standard library raises for an archive that is cut, damaged or encrypted.
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, ValueError, OSError) as error:
        raise FileFormatError(path, f"damaged .npz file: {error}") from None
    if _MEMBER not in names:
        raise FileFormatError(path, f"the file holds no array W, but {', '.join(names[:5]) or 'nothing'}")
    if member is None:
        raise FileFormatError(path, f"W is empty, larger than {SIZE_LIMIT >> 30} GiB or packed in an unknown way")
    return npy_array(path, member, "W")
