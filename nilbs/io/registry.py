"""Which file holds what, and the one reader of everything that a file holds of a character."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nilbs.geometry.skeleton import Skeleton
from nilbs.io.bundle import Bundle, Influences
from nilbs.io.dmat import read_dmat
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.motion import read_motion_json, read_transforms
from nilbs.io.npz import NpzFile
from nilbs.io.tgf import read_tgf_rig
from nilbs.io.weights import read_weights

MESHES = (".obj", ".ply", ".off", ".stl", ".3mf")
OUTLINES = (".obj", ".ply")  # that can hold the edges of a flat shape
RIGS = (".tgf", ".txt", ".mhskel")
WHOLE = (".glb", ".gltf", ".fbx")  # mesh, skeleton, painted weights and motions in one file
WEIGHTS = (".dmat", ".npz", ".mhw")
OWN_MOTIONS = (".dmat", ".json")  # of the character's own bones, which the file does not describe
MOTIONS = (*OWN_MOTIONS, ".bvh", ".npz", *WHOLE)
READABLE = tuple(dict.fromkeys(MESHES + RIGS + WHOLE + WEIGHTS + MOTIONS))
WRITABLE = (*MESHES, ".glb", ".gltf", ".txt", ".tgf", ".dmat", ".npz", ".bvh")

_WEIGHTS_TOLERANCE = 0.1  # of the median row's sum from one


def looks_like_weights(A: np.ndarray) -> bool:
    """Whether a matrix is skinning weights and not transforms, which take 12 rows a bone and a column a frame.

    True where most rows sum to about one, or where A cannot hold transforms.

    Examples
    --------
    >>> looks_like_weights(np.full((24, 2), 0.5)), looks_like_weights(np.ones((24, 2)))
    (True, False)
    """
    return bool(A.size == 0 or len(A) % 12 or np.median(np.abs(A.sum(axis=1) - 1)) < _WEIGHTS_TOLERANCE)


def needs_rig(path: str | os.PathLike) -> bool:
    """Whether a file is read for a rig, if there is one: a motion of a body of the SMPL family.

    Examples
    --------
    >>> needs_rig("walk.bvh")
    False
    """
    return Path(path).suffix.lower() == ".npz" and "poses" in NpzFile(path).names


def read_bundle(
    path: str | os.PathLike,
    *,
    V: np.ndarray | None = None,
    names: Sequence[str] | None = None,
    rig: Skeleton | None = None,
    positions: str = "auto",
) -> Bundle:
    r"""Read whatever a file holds of a character: mesh, skeleton, weights, motions.

    Parameters
    ----------
    path : str or path
        `.obj`, `.ply`, `.off`, `.stl`, `.3mf`: a mesh. `.tgf`: a rig. `.txt`: a rig with weights, as RigNet writes it.
        `.mhskel`: a rig of MakeHuman, with the weights beside it that it names. `.bvh`: a skeleton and its motion.
        `.glb`, `.gltf`, and `.fbx` where Blender is installed: everything. `.npz`: a body model of the SMPL family,
        where it has `v_template`, or a motion of one, where it has `poses`, else weights. `.mhw`: weights. `.json`: a
        motion of bones by name. `.dmat`: weights, or transforms of bones, whichever the numbers can be.
    V : (n, 3) float array, optional
        Vertices of the whole mesh file that the rig was made for; the joints of `.mhskel` are means of these.
    names : sequence of str, optional
        Names of the rig's bones; the weights of `.mhw` are by name.
    rig : Skeleton, optional
        The rig that a motion of the SMPL family moves, if it has the joints of such a body.
    positions : "auto", "add" or "replace"
        Whether the positions of a `.bvh` file are added to its OFFSETs or take their place; by default the data decide.

    Returns
    -------
    bundle : Bundle

    Raises
    ------
    FileFormatError
        If the file is not what its suffix promises, or is a `.mhskel` without V or a `.mhw` without names.
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
    suffix = check_suffix(path, *READABLE)
    if suffix in MESHES:
        from nilbs.io.mesh import read_mesh_parts

        mesh = read_mesh_parts(path)
        return Bundle(mesh=mesh, notes=mesh.notes)
    if suffix == ".tgf":
        return read_tgf_rig(path)
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

        return read_bvh(path, positions=positions)
    if suffix == ".txt":
        from nilbs.io.rignet import read_rignet

        return read_rignet(path)
    arrays = NpzFile(path).names if suffix == ".npz" else ()
    if "v_template" in arrays:
        from nilbs.io.smpl import read_smpl

        return read_smpl(path)
    if "poses" in arrays:
        from nilbs.io.amass import read_amass

        return read_amass(path, rig=rig)
    if suffix == ".mhw":
        from nilbs.io.makehuman import read_mhw

        if names is None:
            raise FileFormatError(path, "its weights are of bones by name: give the mesh and the rig too")
        return Bundle(influences=read_mhw(path, names))
    if suffix == ".json":
        return Bundle(motion=read_motion_json(path))
    if suffix == ".dmat" and not looks_like_weights(read_dmat(path)):
        return Bundle(motion=read_transforms(path))
    return Bundle(influences=Influences.of_matrix(read_weights(path)))


def _read_makehuman(path: str | os.PathLike, V: np.ndarray | None) -> Bundle:
    from nilbs.io.makehuman import read_mhskel, read_mhw, weights_file

    if V is None:
        raise FileFormatError(path, "its joints are means of vertices of a mesh: give the mesh file too")
    skeleton, weights = read_mhskel(path, V), weights_file(path)
    if weights is None:
        return Bundle(skeleton=skeleton)
    note = f"it names {Path(weights).name}, which lies beside it, for its weights"
    return Bundle(skeleton=skeleton, influences=read_mhw(weights, skeleton.names), notes=(note,))
