"""Every reader of files, with what its answer must be, whatever the file holds."""

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nilbs.io import FileFormatError
from nilbs.io.amass import read_amass
from nilbs.io.archive import read_archive
from nilbs.io.bone_map import read_bone_map
from nilbs.io.bundle import Clip, Influences, Mesh, select_group
from nilbs.io.bvh import read_bvh
from nilbs.io.bvh_positions import POSITIONS
from nilbs.io.dmat import read_dmat
from nilbs.io.gltf import read_gltf
from nilbs.io.makehuman import read_mhskel, read_mhw, weights_file
from nilbs.io.mesh import read_mesh_parts
from nilbs.io.motion import read_motion_json, read_transforms
from nilbs.io.npy import read_npy
from nilbs.io.rignet import read_rignet
from nilbs.io.smpl import read_smpl
from nilbs.io.tgf import read_tgf_rig
from nilbs.io.weights import read_weights

from . import mutations

CORPUS = Path(__file__).parent / "corpus"
ARCHIVE = "example 1"
BONES = ("arm", "hand", "eye")
BODY = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 0, 9.0]])


@dataclass(frozen=True)
class Reader:
    """A reader, the suffix of its files, and what changes a file and keeps its form."""

    suffix: str
    read: Callable[[Path], object]
    mutate: mutations.Mutation


def _dmat(path: Path) -> object:
    A = read_dmat(path)
    with suppress(FileFormatError):
        return read_transforms(path)
    return A


def _amass(path: Path) -> object:
    alone = read_amass(path)
    return alone, read_amass(path, rig=alone.skeleton)


def _mhskel(path: Path) -> object:
    return read_mhskel(path, BODY), weights_file(path)


def _bvh(path: Path) -> object:
    return [read_bvh(path, positions=how) for how in POSITIONS]


def _motion(path: Path) -> object:
    with suppress(FileFormatError):
        read_motion_json(path, BONES, 2)
    motion = read_motion_json(path)
    given = np.zeros(0) if motion.given is None else motion.given
    return dataclasses.replace(motion, given=given[~np.isnan(given)])  # NaN means that there is no transform


def _archive(path: Path) -> object:
    arrays, settings = read_archive(path, kind=ARCHIVE)
    return list(arrays), settings  # a training that diverges leaves numbers that are not finite


READERS = {
    "obj": Reader(".obj", read_mesh_parts, mutations.words),
    "ply": Reader(".ply", read_mesh_parts, mutations.words),
    "off": Reader(".off", read_mesh_parts, mutations.words),
    "stl": Reader(".stl", read_mesh_parts, mutations.words),
    "3mf": Reader(".3mf", read_mesh_parts, mutations.threemf),
    "tgf": Reader(".tgf", read_tgf_rig, mutations.words),
    "dmat": Reader(".dmat", _dmat, mutations.words),
    "weights": Reader(".npz", read_weights, mutations.npz),
    "smpl": Reader(".npz", read_smpl, mutations.npz),
    "amass": Reader(".npz", _amass, mutations.npz),
    "npy": Reader(".npy", read_npy, mutations.npy),
    "rignet": Reader(".txt", read_rignet, mutations.words),
    "mhskel": Reader(".mhskel", _mhskel, mutations.json),
    "mhw": Reader(".mhw", lambda path: read_mhw(path, BONES), mutations.json),
    "motion": Reader(".json", _motion, mutations.json),
    "bone_map": Reader(".json", read_bone_map, mutations.json),
    "bvh": Reader(".bvh", _bvh, mutations.words),
    "gltf": Reader(".gltf", read_gltf, mutations.gltf),
    "glb": Reader(".glb", read_gltf, mutations.glb),
    "archive": Reader(".nilbs", _archive, mutations.archive),
}


def read_or_refused(name: str, content: bytes, folder: Path) -> bool:
    """Whether a reader takes a file of this content; anything but a usable answer or one line of refusal raises."""
    reader = READERS[name]
    path = folder / f"file{reader.suffix}"
    path.unlink(missing_ok=True)  # to write over a file is many times slower on some disks than to write a new one
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer, refusal = None, ""
        try:
            answer = reader.read(path)
        except (FileFormatError, OSError) as error:
            refusal = str(error)
        assert refusal.isprintable(), "the error cannot be shown in one line"
        check(answer)
    return not refusal


def check(value: Any) -> None:
    """Assert that an answer can be used: numbers finite, indices within bounds, texts such as a file can hold."""
    if isinstance(value, np.ndarray):
        assert value.dtype.kind in "biu" or np.isfinite(value).all()
    elif isinstance(value, str):
        value.encode()
    elif isinstance(value, Mapping):
        check([*value, *value.values()])
    elif isinstance(value, list | tuple):
        for part in value:
            check(part)
    elif dataclasses.is_dataclass(value):
        check([getattr(value, field.name) for field in dataclasses.fields(value)])
    if isinstance(value, Mesh):
        assert ((value.E >= 0) & (len(value.V) > value.E)).all()
        for group in value.groups:
            select_group(value, group)
    elif isinstance(value, Influences):
        assert len(value.vertex) == len(value.bone) == len(value.weight)
        assert (value.vertex >= 0).all()
        assert (value.bone >= 0).all()
    elif isinstance(value, Clip):
        assert value.B.shape == (len(value.times), len(value.skeleton.BE), 4, 4)
        assert (np.diff(value.times) >= 0).all()
        assert (value.B[:, :, 3] == [0, 0, 0, 1]).all()
    influences, mesh, skeleton = (getattr(value, part, None) for part in ("influences", "mesh", "skeleton"))
    if influences is not None:
        n = int(influences.vertex.max(initial=-1)) + 1 if mesh is None else len(mesh.V)
        assert influences.vertex.max(initial=-1) < n
        assert influences.bone.max(initial=-1) < len(skeleton.BE)


def corpus(name: str) -> list[Path]:
    """The kept files of a reader."""
    return sorted(CORPUS.joinpath(name).iterdir())


def folder_in_memory() -> str | None:
    """Where files are written fastest, if there is such a place."""
    return "/dev/shm" if os.path.isdir("/dev/shm") else None
