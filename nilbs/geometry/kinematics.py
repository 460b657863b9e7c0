"""Parents of bones, forward kinematics and its inverse, poses between poses, random poses and motions.

A bone's rest frame is the translation to its first joint with world axes; its local rotation turns it about that joint
relative to its parent. A root's rotation is relative to the world, and its first joint may be moved by a translation.
Bones may also be moved away from their parents, and scaled together with all that hangs from them.
"""

import numpy as np

from nilbs.geometry.rotations import (
    interpolate_transforms,
    linear_inverses,
    rigid_transforms,
    rotation_matrices,
    rotation_vectors,
    transform_points,
)
from nilbs.geometry.validation import arrays, check_indices


def bone_parents(BE: np.ndarray) -> np.ndarray:
    """Parent of every bone: the bone that ends at the joint where it starts.

    Parameters
    ----------
    BE : (b, 2) int array
        Bones as pairs of joint indices, from first joint to second.

    Returns
    -------
    P : (b,) int array
        Parent bones, -1 at a root.

    Raises
    ------
    ValueError
        If two bones end at one joint, a bone starts where it ends, or the bones form a cycle.

    Examples
    --------
    >>> bone_parents([[0, 1], [1, 2], [1, 3]])
    array([-1,  0,  0])
    """
    (BE,) = arrays(BE=(BE, "b 2", int))
    ending: dict[int, int] = {}
    for bone, (first, second) in enumerate(BE.tolist()):
        if first == second:
            raise ValueError(f"bone {bone} starts and ends at joint {first}")
        if second in ending:
            raise ValueError(
                f"bones {ending[second]} and {bone} both end at joint {second}; a joint has one parent bone"
            )
        ending[second] = bone
    P = np.array([ending.get(first, -1) for first in BE[:, 0].tolist()], dtype=np.int64)
    bone_order(P)
    return P


def bone_order(P: np.ndarray) -> np.ndarray:
    """Permutation of the bones, level by level from the roots, so that parents come before their children.

    Examples
    --------
    >>> bone_order([1, -1, 0])
    array([1, 0, 2])
    """
    (P,) = arrays(P=(P, "b", int))
    check_indices("P", np.maximum(P, 0), max(len(P), 1), "bones")
    return np.argsort(_levels(P), kind="stable")


def forward_kinematics(
    C: np.ndarray,
    BE: np.ndarray,
    P: np.ndarray,
    theta: np.ndarray,
    *,
    root_translation: np.ndarray | None = None,
    translation: np.ndarray | None = None,
    scale: np.ndarray | None = None,
) -> np.ndarray:
    """Rest-to-posed transforms of bones from their local rotations, and from their translations and scales.

    Parameters
    ----------
    C, BE, P : (k, d) float array, (b, 2) and (b,) int arrays
        Joints at rest, in mesh units; bones, indices into C; parent bones, -1 at a root.
    theta : (..., b, 1) or (..., b, 3) float array
        Local rotations in radians, relative to the parent, about each bone's first joint.
    root_translation : (..., d) float array, optional
        How far every root's first joint moves, in mesh units; none by default.
    translation : (..., b, d) float array, optional
        How far every bone's first joint moves from where its parent takes it, in mesh units and in the parent's posed
        axes; none by default.
    scale : (..., b, 1) or (..., b, d) float array, optional
        Factors of size, along all axes or along each of the bone's rest axes; all that hangs from the bone is scaled
        with it. 1 by default.

    Returns
    -------
    B : (..., b, d+1, d+1) float array
        Homogeneous transforms, rest to posed, acting on column vectors.

    Raises
    ------
    ValueError
        If the sizes disagree or P is not a forest.

    Notes
    -----
    B_b = B_parent T(c + t_b) R(theta_b) S_b T(-c) with c = C[BE[b, 0]]. Without translation t_b and scale S_b it is the
    pose function above eq. 2 of [1]_.

    References
    ----------
    .. [1] Jeruzalski et al., NiLBS: Neural Inverse Linear Blend Skinning, 2020, arXiv:2004.05980.

    Examples
    --------
    >>> B = forward_kinematics([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], [[0.0], [np.pi / 2]])
    >>> (B[1] @ [2, 0, 1]).round(6)  # the second bone now points up
    array([1., 1., 1.])
    """
    C, BE, P = arrays(C=(C, "k d"), BE=(BE, "b 2", "C"), P=(P, "b", int))
    d = C.shape[1]
    (theta,) = arrays(theta=(theta, f"... {len(BE)} {3 if d == 3 else 1}"))
    center = C[BE[:, 0]]
    A = rotation_matrices(theta)
    if scale is not None:
        size = 1 if np.shape(scale)[-1:] == (1,) else d
        (scale,) = arrays(scale=(scale, f"... {len(BE)} {size}"))
        A = A * scale[..., None, :]
    moved = center - (A @ center[:, :, None])[..., 0]
    if translation is not None:
        (translation,) = arrays(translation=(translation, f"... {len(BE)} {d}"))
        moved = moved + translation
    if root_translation is not None:
        (root_translation,) = arrays(root_translation=(root_translation, f"... {d}"))
        moved = moved + np.where((P < 0)[:, None], root_translation[..., None, :], 0.0)
    return composed(P, rigid_transforms(A, moved))


def composed(P: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Products down the hierarchy of transforms (..., b, d+1, d+1) relative to the parent: relative to the world.

    Examples
    --------
    >>> step = rigid_transforms(np.eye(2), [1, 0])
    >>> composed(np.array([1, -1]), np.array([step, step]))[:, 0, 2]
    array([2., 1.])
    """
    world, level = local.copy(), _levels(P)
    ends = np.cumsum(np.bincount(level))
    for bones in np.split(np.argsort(level, kind="stable"), ends[:-1])[1:]:
        world[..., bones, :, :] = world[..., P[bones], :, :] @ world[..., bones, :, :]
    return world


def local_transforms(C: np.ndarray, BE: np.ndarray, P: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Transforms (..., b, d+1, d+1) of posed rest frames relative to that of the parent, or to the world at a root.

    B may scale bones and take joints apart. A parent that squeezes space flat has its pseudoinverse.

    Examples
    --------
    >>> C, BE, P = np.array([[0.0, 0], [1, 0]]), np.array([[0, 0], [1, 1]]), np.array([-1, 0])
    >>> local_transforms(C, BE, P, np.array([2 * np.eye(3)] * 2) / [[[1], [1], [2]]])[:, 0].tolist()
    [[2.0, 0.0, 0.0], [1.0, 0.0, 1.0]]
    """
    d, start = C.shape[1], C[BE[:, 0]]
    A = B[..., :d, :d]
    place = (A @ start[:, :, None])[..., 0] + B[..., :d, d]
    root = P < 0
    back = np.where(root[:, None, None], np.eye(d), linear_inverses(A[..., P, :, :]))
    away = place - np.where(root[:, None], 0.0, place[..., P, :])
    return rigid_transforms(back @ A, (back @ away[..., None])[..., 0])


def local_rotations(C: np.ndarray, BE: np.ndarray, P: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and root translation of posed bones; the inverse of `forward_kinematics`.

    Parameters
    ----------
    C, BE, P : (k, d) float array, (b, 2) and (b,) int arrays
        Joints at rest, in mesh units; bones, indices into C; parent bones, -1 at a root.
    B : (..., b, d+1, d+1) float array
        Rest-to-posed transforms of the bones.

    Returns
    -------
    theta : (..., b, 1) or (..., b, 3) float array
        Local rotations in radians.
    root_translation : (..., d) float array
        How far the first root's first joint moves, in mesh units.

    Raises
    ------
    ValueError
        If the sizes disagree, or the transforms are not what one skeleton can do: a bone is not rigid, a joint comes
        apart, or two roots move differently. The message names the bone.

    Examples
    --------
    >>> C, BE, P = [[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0]
    >>> theta, root_translation = local_rotations(C, BE, P, forward_kinematics(C, BE, P, [[0.1], [0.2]]))
    >>> theta.ravel().round(6)
    array([0.1, 0.2])
    """
    C, BE, P, B = arrays(C=(C, "k d"), BE=(BE, "b 2", "C"), P=(P, "b", int), B=(B, "... b d+1 d+1"))
    d = C.shape[1]
    bone_order(P)
    R = B[..., :d, :d]
    rigid = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(d)).max(axis=(-1, -2)) < 1e-6
    rigid &= np.linalg.det(R) > 0
    if not rigid.all():
        raise ValueError(f"bone {np.argwhere(~rigid)[0][-1]} is scaled or sheared; local rotations need rigid bones")
    parent_R = np.where((P >= 0)[:, None, None], R[..., P, :, :], np.eye(d))
    theta = rotation_vectors(np.swapaxes(parent_R, -1, -2) @ R)
    center = C[BE[:, 0]]
    roots = np.flatnonzero(P < 0)
    moved = (R @ center[:, :, None])[..., 0] + B[..., :d, d]
    root_translation = moved[..., roots[0], :] - center[roots[0]] if len(roots) else np.zeros((*B.shape[:-3], d))
    recomposed = forward_kinematics(C, BE, P, theta, root_translation=root_translation)
    apart = np.abs(recomposed - B)[..., :d, d].max(axis=-1)
    size = np.linalg.norm(np.ptp(C, axis=0)) + np.abs(root_translation).max(initial=0) + 1e-9 * np.abs(C).max(initial=0)
    if (apart > 1e-5 * size).any():
        raise ValueError(f"bone {np.argwhere(apart > 1e-5 * size)[0][-1]} comes apart from its parent's joint")
    return theta, root_translation


def interpolate_poses(
    C: np.ndarray, BE: np.ndarray, P: np.ndarray, B0: np.ndarray, B1: np.ndarray, s: float | np.ndarray
) -> np.ndarray:
    """Poses a fraction s of the way from one pose to another.

    Parameters
    ----------
    C, BE, P : (k, d) float array, (b, 2) and (b,) int arrays
        Joints at rest, in mesh units; bones, indices into C; parent bones, -1 at a root.
    B0, B1 : (..., b, d+1, d+1) float array
        Poses, rest to posed.
    s : float or (...) float array
        0 gives B0, 1 gives B1.

    Returns
    -------
    B : (..., b, d+1, d+1) float array
        Poses in between.

    Raises
    ------
    ValueError
        If the sizes disagree.

    Notes
    -----
    Relative to its parent a bone is turned, stretched and moved: rotations, those of the polar decomposition, are
    slerped, stretches and translations are linear, recomposed down the hierarchy. So joints that are together in both
    poses stay together.

    Examples
    --------
    >>> C, BE, P = [[0, 0], [1, 0]], [[0, 1]], [-1]
    >>> B0, B1 = (forward_kinematics(C, BE, P, [[angle]]) for angle in (0.0, 1.0))
    >>> local_rotations(C, BE, P, interpolate_poses(C, BE, P, B0, B1, 0.25))[0].round(6)
    array([[0.25]])
    """
    C, BE, P = arrays(C=(C, "k d"), BE=(BE, "b 2", "C"), P=(P, "b", int))
    d, b = C.shape[1], len(BE)
    B0, B1 = arrays(B0=(B0, f"... {b} {d + 1} {d + 1}"), B1=(B1, f"... {b} {d + 1} {d + 1}"))
    bone_order(P)
    local0, local1 = (local_transforms(C, BE, P, B) for B in (B0, B1))
    G = composed(P, interpolate_transforms(local0, local1, np.asarray(s)[..., None]))
    return rigid_transforms(G[..., :d, :d], transform_points(G, -C[BE[:, 0]]))


def random_rotations(P: np.ndarray, d: int, n: int, *, std: float, rng: np.random.Generator) -> np.ndarray:
    """Local rotations (n, b, 1 or 3) of n random poses: every bone but the roots turned about a random axis.

    The angles are normal with standard deviation `std`, in radians.
    """
    (P,) = arrays(P=(P, "b", int))
    if not std >= 0:
        raise ValueError(f"std must not be negative, got {std}")
    angle = std * rng.standard_normal((n, len(P), 1))
    if d == 3:
        axis = rng.standard_normal((n, len(P), 3))
        angle = angle * (axis / np.linalg.norm(axis, axis=-1, keepdims=True))
    return np.where((P >= 0)[:, None], angle, 0.0)


def smooth_random_rotations(P: np.ndarray, d: int, n: int, *, amplitude: float, rng: np.random.Generator) -> np.ndarray:
    """Local rotations (n, b, 1 or 3) of a smooth random motion of n frames, which loops; zero at the roots.

    Each component is a sum of sines of one to four periods with random phases. The root mean square of every bone's
    angle over the motion is `amplitude`, in radians.

    Examples
    --------
    >>> theta = smooth_random_rotations([-1, 0], 2, 50, amplitude=0.4, rng=np.random.default_rng(0))
    >>> float(np.sqrt((theta[:, 1] ** 2).mean()).round(6))
    0.4
    """
    (P,) = arrays(P=(P, "b", int))
    if not amplitude >= 0:
        raise ValueError(f"amplitude must not be negative, got {amplitude}")
    r = 3 if d == 3 else 1
    time = np.arange(n)[:, None, None, None] / max(n, 1)
    periods = np.arange(1, 5)
    phase = rng.uniform(0, 2 * np.pi, (len(P), r, len(periods)))
    # Slower waves carry more: the spectrum of a body's motion falls with frequency.
    size = rng.standard_normal((len(P), r, len(periods))) / periods
    theta = (size * np.sin(2 * np.pi * periods * time + phase)).sum(axis=-1)
    rms = np.sqrt((theta**2).sum(axis=-1).mean(axis=0)) if n else np.ones(len(P))
    theta *= (amplitude / np.where(rms > 0, rms, 1.0))[:, None]
    return np.where((P >= 0)[:, None], theta, 0.0)


def rms_rotation(theta: np.ndarray, P: np.ndarray) -> float | None:
    """Root mean square of the local angles of all bones but the roots; None if there are none.

    Examples
    --------
    >>> rms_rotation([[9.0], [3.0], [4.0]], [-1, 0, 0])
    3.5355339059327378
    """
    theta, P = arrays(theta=(theta, "... b r"), P=(P, "b", int))
    turned = theta[..., P >= 0, :]
    return float(np.sqrt((turned**2).sum(axis=-1).mean())) if turned.size else None


def _levels(P: np.ndarray) -> np.ndarray:
    """How many ancestors every bone has."""
    b = len(P)
    # Bone b stands above the roots and above itself; every round doubles the steps up that have been taken.
    above = np.append(np.where(P < 0, b, P), b)
    level = np.append(np.where(P < 0, 0, 1), 0)
    for _ in range(b.bit_length()):
        level += level[above]
        above = above[above]
    if (above < b).any():
        raise ValueError(f"bones {np.flatnonzero(above < b).tolist()} form a cycle; a skeleton is a tree")
    return level[:b]
