"""Skinning weights: `.dmat` and `.npz` files."""

import os

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.dmat import read_dmat, write_dmat
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.npz import NpzFile


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
    W = read_dmat(path) if check_suffix(path, ".dmat", ".npz") == ".dmat" else NpzFile(path).array("W")
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
