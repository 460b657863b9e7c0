"""NumPy's `.npz` archives of numbers, read without pickle; the sizes that they claim are checked."""

import os

import numpy as np

from nilbs.geometry.validation import listed
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
