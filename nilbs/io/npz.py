"""NumPy's `.npz` archives of numbers, read without pickle; the sizes that they claim are checked."""

import os
from collections.abc import Mapping

import numpy as np

from nilbs.geometry.validation import listed
from nilbs.io.atomic import replacing
from nilbs.io.errors import FileFormatError
from nilbs.io.npy import npy_array
from nilbs.io.zipped import open_zip, unpacked


class NpzFile:
    """The arrays of a `.npz` file by name (`names`, sorted), each unpacked when it is used."""

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = path
        self._archive = open_zip(path)
        self.names = tuple(sorted(name.removesuffix(".npy") for name in self._archive.namelist()))

    def array(self, name: str) -> np.ndarray:
        """An array of finite numbers; FileFormatError if there is none of this name, or it holds anything else."""
        if f"{name}.npy" not in self._archive.NameToInfo:
            there = listed([repr(other[:60]) for other in self.names]) or "nothing"
            raise FileFormatError(self.path, f"the file holds no array {name}, but {there}")
        # numpy.load would make room for whatever shape the header claims; npy_array compares it with the bytes.
        return npy_array(self.path, unpacked(self.path, self._archive, f"{name}.npy"), name)

    def number(self, name: str) -> float:
        """A finite number, or an array of one."""
        A = self.array(name)
        if A.size != 1:
            raise FileFormatError(self.path, f"{name} must be one number, this file holds {A.shape}")
        return float(A.ravel()[0])


def write_npz(path: str | os.PathLike, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays of numbers by name; the file appears whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/places.npz"
    >>> write_npz(path, {"facet": np.array([3, 1])})
    >>> NpzFile(path).array("facet")
    array([3., 1.])
    """
    with replacing(path) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
