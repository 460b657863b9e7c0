"""Files to arrays and back: one file a format; degrees, axes and 1-based indices end here.

Every reader is bounded by the size of its file, whatever the file claims, and raises `FileFormatError` or `OSError`.
Every writer replaces its file in one step or leaves it alone.
"""

from nilbs.io.atomic import check_writable, replacing
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.dmat import read_dmat, write_dmat
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.mesh import read_mesh, write_mesh
from nilbs.io.motion import read_motion_json, read_transforms, write_motion_json, write_transforms
from nilbs.io.npy import read_npy, write_npy
from nilbs.io.npz import write_npz
from nilbs.io.registry import read_bundle
from nilbs.io.tgf import read_tgf, write_tgf
from nilbs.io.weights import read_weights, write_weights

__all__ = [
    "Bundle",
    "Clip",
    "FileFormatError",
    "Influences",
    "Mesh",
    "check_suffix",
    "check_writable",
    "read_bundle",
    "read_dmat",
    "read_mesh",
    "read_motion_json",
    "read_npy",
    "read_tgf",
    "read_transforms",
    "read_weights",
    "replacing",
    "write_dmat",
    "write_mesh",
    "write_motion_json",
    "write_npy",
    "write_npz",
    "write_tgf",
    "write_transforms",
    "write_weights",
]
