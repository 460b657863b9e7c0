"""NumPy's `.npz` archives of numbers, read without pickle and without trust in the sizes that they claim."""

import io
import os
import struct
import zipfile
import zlib

import numpy as np

from nilbs.geometry.validation import listed
from nilbs.io.bounded import SIZE_LIMIT, file_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.npy import npy_array

_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that numpy writes
# What the standard library raises for an archive that is cut, damaged or encrypted.
_DAMAGES = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, ValueError, OSError)


class NpzFile:
    """The arrays of a file by name, each unpacked when it is asked for.

    Parameters
    ----------
    path : str or path
        A `.npz` file.

    Attributes
    ----------
    path : str or path
    names : tuple of str
        Of the arrays, sorted.

    Raises
    ------
    FileFormatError
        If the file is no archive.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/a.npz"
    >>> np.savez(path, W=np.eye(2), V=np.zeros((2, 3)))
    >>> file = NpzFile(path)
    >>> file.names, file.array("W").tolist()
    (('V', 'W'), [[1.0, 0.0], [0.0, 1.0]])
    """

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = path
        data = file_bytes(path)
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except _DAMAGES as error:
            raise FileFormatError(path, f"damaged .npz file: {error}") from None
        self.names = tuple(sorted(name.removesuffix(".npy") for name in self._archive.namelist()))

    def array(self, name: str) -> np.ndarray:
        """Return an array of finite numbers.

        Parameters
        ----------
        name : str

        Returns
        -------
        A : float array

        Raises
        ------
        FileFormatError
            If there is none of this name, or it holds anything else.
        """
        # numpy.load would make room for whatever shape the header claims; so the header is held against the bytes here.
        member = None
        try:
            found = self._archive.NameToInfo.get(f"{name}.npy")
            if found and found.compress_type in _PACKINGS and 0 < found.file_size <= SIZE_LIMIT:
                with self._archive.open(found) as file:
                    member = file.read(found.file_size)
        except _DAMAGES as error:
            raise FileFormatError(self.path, f"damaged .npz file: {error}") from None
        if found is None:
            there = listed([repr(other[:60]) for other in self.names]) or "nothing"
            raise FileFormatError(self.path, f"the file holds no array {name}, but {there}")
        if member is None:
            size = SIZE_LIMIT >> 30
            raise FileFormatError(self.path, f"{name} is empty, larger than {size} GiB or packed in an unknown way")
        return npy_array(self.path, member, name)
