"""Volume against twist: how much of a twisted capsule each map from posed to rest points gives back.

Skinning blends rotations as matrices, so that a limb that is twisted about its own axis grows thin where the weights
change: the candy wrapper. That loss is the skinning's own. What is measured here is what a map adds to it.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nilbs.geometry.diagnosis import enclosed_volume
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.characters.motion import Motion
    from nilbs.models.model import Model

DEGREES = tuple(range(0, 180, 10))  # of a table's rows
FRAMES = 41  # of the twist that is trained on, both ways
MAPS = ("inverse", "reverse", "search")
# Around the capsule: with fewer edges its triangles span so much of the twist that they cut off part of the volume.
EDGES_AROUND = 64


def twist_table(
    *,
    seed: int = 0,
    minutes: float | None = None,
    steps: int | None = None,
    resolution: int = 128,
    progress: bool = False,
    character: "Character | None" = None,
    degrees: Sequence[float] = DEGREES,
    **changes: Any,
) -> list[dict[str, float]]:
    """Volumes of a twisted capsule: of the skinned mesh, and of what each map reconstructs.

    Parameters
    ----------
    seed : int
        Of the training.
    minutes : float, optional
        How long to train; by default `steps` steps.
    steps : int, optional
        How many; by default what suits the character.
    resolution : int
        Cells along each edge of the cube that surfaces are extracted on.
    progress : bool
        Show progress on standard error.
    character : Character, optional
        Two bones or more along the y axis, of which the last one turns; a capsule by default.
    degrees : sequence of float
        By how much, one row each.
    **changes
        Settings of the training by name.

    Returns
    -------
    rows : list of dict
        One for each twist:

        - ``degrees``;
        - ``lbs``: volume of the skinned mesh, divided by that at rest;
        - ``inverse``, ``reverse``, ``search``: volume of the surface extracted from the field by each map, divided by
          that of the skinned mesh in the same pose.

    Raises
    ------
    ValueError
        If a setting is out of range.

    Notes
    -----
    All volumes are by the divergence theorem. The twisted capsule covers no place twice, so that is the volume where
    its winding number is one, the truth of the labelled points.

    The model is trained on the twist itself, both ways and up to the largest one. All maps use the same network.

    A blend of rotations about one axis only ever moves points towards it. Skinning does so, which is the candy wrapper;
    the inverse of the blend (eq. 6) takes it back. The blend of inverses (the map called "reverse" in a comment of the
    paper's source) does it a second time: it moves posed points even nearer to the axis, so that points outside land in
    the body and the reconstruction swells where the skinned mesh grows thin. A surface is cut off at its cube, so that
    what swells beyond the cube is not counted.
    """
    from nilbs.characters.capsule import capsule

    character = character or capsule(resolution=EDGES_AROUND)
    model = twist_model(
        character,
        largest=float(np.abs(degrees).max()),
        seed=seed,
        minutes=minutes,
        steps=steps,
        progress=progress,
        **changes,
    )
    return [twist_row(model, angle, resolution=resolution) for angle in degrees]


def twist_model(
    character: "Character",
    *,
    largest: float = 170.0,
    seed: int = 0,
    minutes: float | None = None,
    steps: int | None = None,
    progress: bool = False,
    **changes: Any,
) -> "Model":
    """A model that is trained on a twist, both ways up to the `largest` in degrees; the rest as for `twist_table`."""
    from nilbs.models.fitting import fit

    if steps is not None:
        changes["steps"] = steps
    if minutes is not None:
        changes["minutes"] = minutes
    motion = twist_motion(character, np.linspace(-largest, largest, FRAMES))
    return fit(character, motion, seed=seed, progress=progress, **changes)


def twist_row(model: "Model", degrees: float, *, resolution: int = 128) -> dict[str, float]:
    """One row of `twist_table`."""
    character = model.character
    pose = twist_motion(character, [degrees])[0]
    U = character.skin(pose)
    volume, grid = enclosed_volume(U, character.F), Grid.cube(U, resolution)
    ratios = {name: enclosed_volume(*model.posed(pose, mapping=name).extract_on(grid)) / volume for name in MAPS}
    return {"degrees": float(degrees), "lbs": volume / enclosed_volume(character.V, character.F), **ratios}


def twist_motion(character: "Character", degrees: Sequence[float] | np.ndarray) -> "Motion":
    """The last bone turned about the y axis, which is its own.

    Parameters
    ----------
    character : Character
        In space, with its last bone along y.
    degrees : (t,) float array
        One angle a frame.

    Returns
    -------
    motion : Motion

    Raises
    ------
    ValueError
        If the character is flat: the plane has no twist.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> motion = twist_motion(capsule(resolution=8), [0, 90])
    >>> motion[1][1].round(3)[:3, :3].tolist()
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    """
    if character.d != 3:
        raise ValueError("a flat character cannot be twisted")
    return turned(character, -1, degrees)


def turned(character: "Character", bone: int, degrees: Sequence[float] | np.ndarray) -> "Motion":
    """One bone turned: in the plane, or in space about the y axis.

    Parameters
    ----------
    character : Character
    bone : int
    degrees : (t,) float array
        One angle a frame.

    Returns
    -------
    motion : Motion

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> turned(capsule(d=2, resolution=8), 1, [90])[0][1].round(3)[:2, :2].tolist()
    [[0.0, -1.0], [1.0, 0.0]]
    """
    from nilbs.characters.motion import Motion

    c = character
    theta = np.zeros((len(degrees), len(c.skeleton.BE), 1 if c.d == 2 else 3))
    theta[:, bone, -1 if c.d == 2 else 1] = np.radians(degrees)
    B = forward_kinematics(c.skeleton.C, c.skeleton.BE, c.skeleton.P, theta)
    return Motion(B, np.arange(len(B)), f"bone {c.skeleton.names[bone]} turned", skeleton=c.skeleton)
