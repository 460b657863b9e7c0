"""Which file holds what, and one reader of all files that describe their own mesh, bones, weights or motion."""

import os
from pathlib import Path

import numpy as np

from nilbs.geometry.skeleton import skeleton_of_bones
from nilbs.io.bundle import Bundle
from nilbs.io.dmat import read_dmat
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.npz import NpzFile
from nilbs.io.tgf import read_tgf

MESHES = (".obj", ".ply", ".off", ".stl", ".3mf")
OUTLINES = (".obj", ".ply")  # that can hold the edges of a flat shape
RIGS = (".tgf", ".txt", ".mhskel")
WHOLE = (".glb", ".gltf", ".fbx")  # mesh, skeleton, painted weights and motions in one file
WEIGHTS = (".dmat", ".npz", ".mhw")
OWN_MOTIONS = (".dmat", ".json")  # of the character's own bones, which the file does not describe
MOTIONS = (*OWN_MOTIONS, ".bvh", *WHOLE)
READABLE = tuple(dict.fromkeys(MESHES + RIGS + WHOLE + WEIGHTS + MOTIONS))
WRITABLE = (*MESHES, ".glb", ".gltf", ".txt", ".tgf", ".dmat", ".npz", ".bvh")

_WEIGHTS_TOLERANCE = 0.1  # of the median row's sum from one


def kind_of(path: str | os.PathLike) -> str:
    """What a file holds: "parts" (what `read_bundle` reads), "weights" or "motion", of bones that are elsewhere.

    The suffix decides, and where it leaves that open the content.

    Examples
    --------
    >>> kind_of("body.glb"), kind_of("walk.json")
    ('parts', 'motion')
    """
    suffix = check_suffix(path, *READABLE)
    if suffix == ".dmat":
        return "weights" if looks_like_weights(read_dmat(path)) else "motion"
    if suffix == ".npz":
        return "parts" if "v_template" in NpzFile(path).names else "weights"  # a body model of the SMPL family
    return {".mhw": "weights", ".json": "motion"}.get(suffix, "parts")


def looks_like_weights(A: np.ndarray) -> bool:
    """Whether a matrix is skinning weights and not transforms, which take 12 rows a bone and a column a frame.

    Weights are what cannot hold transforms, and a matrix in which most rows sum to about one.
    """
    return bool(A.size == 0 or len(A) % 12 or np.median(np.abs(A.sum(axis=1) - 1)) < _WEIGHTS_TOLERANCE)


def read_bundle(path: str | os.PathLike, *, V: np.ndarray | None = None) -> Bundle:
    r"""Read whatever a file holds of a character: mesh, skeleton, painted weights, motions.

    Parameters
    ----------
    path : str or path
        `.obj`, `.ply`, `.off`, `.stl`, `.3mf`: a mesh. `.tgf`: a rig. `.txt`: a rig with weights, as RigNet writes it.
        `.mhskel`: a rig of MakeHuman, with the weights beside it that it names. `.bvh`: a skeleton and its motion.
        `.glb`, `.gltf`, and `.fbx` where Blender is installed: everything. `.npz` with `v_template`: a body model of
        the SMPL family.
    V : (n, 3) float array, optional
        Vertices of the whole mesh file that the rig was made for; the joints of `.mhskel` are means of these.

    Returns
    -------
    bundle : Bundle

    Raises
    ------
    FileFormatError
        If the file is not what its suffix says, holds weights or a motion alone, or is a `.mhskel` without V.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "rig.tgf"
    >>> _ = path.write_text("1 0 0 0\n2 1 0 0\n#\n1 2\n#\n")
    >>> read_bundle(path).skeleton.names
    ('bone0',)
    """
    kind = kind_of(path)
    if kind != "parts":
        what = {"weights": "weights of vertices", "motion": "a motion of bones"}[kind]
        raise FileFormatError(path, f"the file holds {what} and no mesh or rig")
    suffix = Path(path).suffix.lower()
    if suffix in MESHES:
        from nilbs.io.mesh import read_mesh_parts

        mesh = read_mesh_parts(path)
        return Bundle(mesh=mesh, notes=mesh.notes)
    if suffix == ".tgf":
        C, BE = read_tgf(path)
        return Bundle(skeleton=skeleton_of_bones(C, BE))
    if suffix == ".mhskel":
        return _read_makehuman(path, V)
    if suffix in (".glb", ".gltf"):
        from nilbs.io.gltf import read_gltf

        return read_gltf(path)
    if suffix == ".fbx":
        from nilbs.io.fbx import read_fbx

        return read_fbx(path)
    if suffix == ".bvh":
        from nilbs.io.bvh import read_bvh

        return read_bvh(path)
    if suffix == ".npz":
        from nilbs.io.smpl import read_smpl

        return read_smpl(path)
    from nilbs.io.rignet import read_rignet

    return read_rignet(path)


def _read_makehuman(path: str | os.PathLike, V: np.ndarray | None) -> Bundle:
    from nilbs.io.makehuman import read_mhskel, read_mhw, weights_file

    if V is None:
        raise FileFormatError(path, "its joints are means of vertices of a mesh: give the mesh file too")
    skeleton, weights = read_mhskel(path, V), weights_file(path)
    if weights is None:
        return Bundle(skeleton=skeleton)
    note = f"it names {Path(weights).name}, which lies beside it, for its weights"
    return Bundle(skeleton=skeleton, influences=read_mhw(weights, skeleton.names), notes=(note,))
