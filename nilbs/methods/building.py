"""Every method that a field can be trained by: what it is made of, and what its training minimises."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.fields.field import Field
from nilbs.fields.objective import Objective, Term
from nilbs.fields.occupancy_term import OccupancyTerm
from nilbs.fields.rest_state import RestState, rest_state, search_field
from nilbs.fields.samples import OccupancySamples, RestSamples, occupancy_samples, surface_samples, volume_samples
from nilbs.fields.search import SearchField
from nilbs.fields.unit_frame import at_rest, in_unit_frame, root_bone
from nilbs.fields.weight_term import ForwardWeightTerm, RandomPoses, WeightTerm
from nilbs.methods.mesh_lbs import MeshLbsField
from nilbs.methods.nasa import NasaField, NasaWeightTerm
from nilbs.methods.nearest import NearestVertex
from nilbs.methods.pose_mlp import PoseMlp
from nilbs.methods.rigid_parts import RigidParts
from nilbs.methods.settings import MOST_LABELLED, Settings
from nilbs.methods.snarf import SnarfBoneTerm, SnarfField

# Rest points whose weights the weight loss knows.
REST_POINTS = 200_000
# Sets the draws before the first step apart from those of the steps.
_STREAM = 2**32 - 1


@dataclass(frozen=True)
class Scene:
    """What a training knows beside its field.

    Attributes
    ----------
    character : Character
    settings : Settings
    poses : (t, b, d+1, d+1) tensor
        The motion's frames in the unit frame, in the field's precision and on its device.
    rng : numpy.random.Generator
        Where chance comes from before the first step.
    """

    character: Character
    settings: Settings
    poses: Tensor
    rng: np.random.Generator


def build_field(character: Character, settings: Settings, rest: RestState | None = None) -> Field:
    """An untrained field of the method that settings name.

    Parameters
    ----------
    character : Character
    settings : Settings
        Resolved.
    rest : RestState, optional
        Grids of the rest pose, where they are at hand; only the method "nilbs" has any.

    Returns
    -------
    field : Field
    """
    c, sizes = character, {"width": settings.width, "depth": settings.depth}
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    centers, P = torch.as_tensor(at_rest(c, c.skeleton.C[c.skeleton.BE[:, 0]])), torch.as_tensor(c.skeleton.P)
    builders: dict[str, Callable[[], Field]] = {
        "nilbs": lambda: search_field(c, settings, rest or rest_state(c, settings)),
        "nasa": partial(NasaField, centers, deformable=True, root=root_bone(c), **sizes),
        "nasa-rigid": partial(NasaField, centers, deformable=False, root=root_bone(c), **sizes),
        "snarf": partial(SnarfField, P, centers, **sizes),
        "mlp": partial(PoseMlp, P, c.d, **sizes),
        "nearest": partial(NearestVertex, V, c.F, c.W),
        "rigid-parts": partial(RigidParts, V, c.F, c.W, V_volume, c.W_volume),
        "mesh-lbs": partial(MeshLbsField, V, c.F, c.W),
    }
    return builders[settings.method]()


def build_objective(
    field: Field, character: Character, motion: Motion, settings: Settings, *, progress: bool
) -> Objective:
    """What the training of a field minimises.

    Parameters
    ----------
    field : Field
        Of `build_field`, on its device.
    character : Character
    motion : Motion
        Its frames are what the occupancy loss sees.
    settings : Settings
        Resolved.
    progress : bool
        Show a progress bar while frames are labelled.

    Returns
    -------
    objective : Objective

    Raises
    ------
    ValueError
        If every loss is off.
    """
    c, paper = character, settings.supervision == "paper"
    _, B = in_unit_frame(c, np.zeros((len(motion), 1, c.d)), motion.B)
    poses = torch.as_tensor(B).to(next(field.parameters()))
    scene = Scene(c, settings, poses, np.random.default_rng([settings.seed, _STREAM]))
    occupancy = None
    if settings.occupancy_loss:
        occupancy = OccupancyTerm(
            field.logit,
            poses,
            _labelled(scene, motion, progress=progress),
            **_batch(settings),
            factor=settings.occupancy_loss,
            # Of the default method; rivals draw uniformly, as in their papers.
            adaptive=settings.adaptive and not paper and settings.method == "nilbs",
            absolute=paper,
        )
    return Objective(occupancy, *_TERMS.get(settings.method, lambda field, scene: [])(field, scene), seed=settings.seed)


def _labelled(scene: Scene, motion: Motion, *, progress: bool) -> OccupancySamples:
    """Labelled points of the motion's frames, drawn in the world, as scores draw them, and told in the unit frame."""
    from tqdm import tqdm

    c, settings = scene.character, scene.settings
    frames: Iterable[np.ndarray] = tqdm(motion.B, desc="labelling", unit="frame", disable=not progress, delay=2)
    noise = None if settings.supervision == "paper" else settings.noise * c.L
    n = max(1, min(settings.samples_per_frame, MOST_LABELLED // len(motion)))
    samples = occupancy_samples(c.V, c.F, c.W, frames, n=n, noise=noise, rng=scene.rng)
    return replace(samples, x=in_unit_frame(c, samples.x, motion.B)[0].astype(np.float32))


def _nilbs_terms(field: Field, scene: Scene) -> list[Term]:
    assert isinstance(field, SearchField)
    c, settings = scene.character, scene.settings
    paper = settings.supervision == "paper"
    position_loss = 0.0 if paper else settings.position_loss
    terms: list[Term] = []
    rest = _rest_samples(scene)
    if settings.weight_loss or position_loss:
        random_poses = RandomPoses(at_rest(c, c.skeleton.C), c.skeleton.BE, c.skeleton.P, settings.random_pose_std)
        terms.append(
            WeightTerm(
                field.inverse,
                None if paper else scene.poses,
                rest,
                random_poses=random_poses if settings.random_pose_std and not paper else None,
                factor=settings.weight_loss,
                position_loss=position_loss,
                **_batch(settings),
            )
        )
    if not terms and not settings.occupancy_loss:
        raise ValueError("every loss of the weight network is off: there is nothing to train for")
    if field.forward_network is not None:
        points = settings.poses_per_step * settings.points_per_pose
        terms.append(ForwardWeightTerm(field.forward_network, rest, points=points))
    return terms


def _rest_samples(scene: Scene) -> RestSamples:
    c, settings = scene.character, scene.settings
    if settings.supervision == "paper":
        return surface_samples(*_skin(c))
    return volume_samples(
        at_rest(c, c.V),
        c.F,
        c.W,
        at_rest(c, c.V_volume),
        c.T,
        c.W_volume,
        n=REST_POINTS,
        shell=settings.shell,
        rng=scene.rng,
    )


def _nasa_terms(field: Field, scene: Scene) -> list[Term]:
    assert isinstance(field, NasaField)
    c, settings = scene.character, scene.settings
    if not settings.weight_loss:
        return []
    V, W = _skin(c)
    return [NasaWeightTerm(field, V, W, scene.poses, factor=settings.weight_loss, **_batch(settings))]


def _snarf_terms(field: Field, scene: Scene) -> list[Term]:
    assert isinstance(field, SnarfField)
    c, settings = scene.character, scene.settings
    if not settings.weight_loss:
        return []
    return [SnarfBoneTerm(field, at_rest(c, c.skeleton.C), c.skeleton.BE, c.skeleton.P, factor=settings.weight_loss)]


def _skin(character: Character) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the surface at rest and their weights; in the plane a mesh has others inside."""
    on = np.unique(character.F)
    return at_rest(character, character.V[on]), character.W[on]


def _batch(settings: Settings) -> dict[str, int]:
    return {"poses_per_step": settings.poses_per_step, "points_per_pose": settings.points_per_pose}


# Losses of a method beside the occupancy loss.
_TERMS: dict[str, Callable[[Field, Scene], list[Term]]] = {
    "nilbs": _nilbs_terms,
    "nasa": _nasa_terms,
    "nasa-rigid": _nasa_terms,
    "snarf": _snarf_terms,
}
