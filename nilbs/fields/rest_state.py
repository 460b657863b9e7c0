"""What a field of the method "nilbs" knows of the rest pose: grids of distance and of weights, by their names."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import LocalEncoding, ParameterEncoding
from nilbs.fields.forward import ForwardField, packed_weights
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.network import WeightNetwork
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.search import SearchField
from nilbs.fields.unit_frame import at_rest, root_bone
from nilbs.geometry.grids import Grid
from nilbs.geometry.rest_grids import distance_bricks, weight_grid
from nilbs.geometry.skin_fit import fit_to_skin
from nilbs.geometry.validation import arrays
from nilbs.methods.settings import Settings

# In units of L: how far around the body rest weights are known, and how far they go on beyond the skin unbroken.
BAND, DEPTH = 0.05, 0.015
# Parts that the edge of a cell of the rest cache is divided in: at the skin, and again, twice, where interpolation
# misses the distance by more than this much, in units of L, and this share of it besides.
PARTS, TOLERANCE, RELATIVE = (4, 2, 2), 1e-5, 0.01
# Names of the field's parts that hold the grids.
CACHE, FORWARD = "inverse.cache", "forward_field"


@dataclass(frozen=True)
class RestState:
    """Grids of the rest pose, in the unit frame.

    Attributes
    ----------
    arrays : mapping of str to array
        By their names in the field's state.
    spacing : mapping of str to float
        Edge of a cell of each of the two grids, by its part's name.
    """

    arrays: Mapping[str, np.ndarray]
    spacing: Mapping[str, float]


def rest_state(character: Character, settings: Settings) -> RestState:
    """Grids of a character at rest, of the resolutions that settings say."""
    c = character
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    cache = Grid.box(V, max(2, -(-settings.cache_resolution // PARTS[0])))
    weights = Grid.box(V, settings.weight_resolution, pad=BAND)
    node, W_node = weight_grid(V, c.F, c.W, V_volume, c.T, c.W_volume, weights, band=BAND, depth=DEPTH)
    W_node = fit_to_skin(V, c.F, c.W, weights, node, W_node, rng=np.random.default_rng(settings.seed))
    bricks = distance_bricks(V, c.F, cache, parts=PARTS, tolerance=TOLERANCE, relative=RELATIVE)
    state = {
        **{f"{CACHE}.{name}": array for name, array in bricks._asdict().items()},
        f"{CACHE}.origin": cache.origin,
        **{f"{FORWARD}.{name}": array for name, array in packed_weights(node, W_node, weights.shape).items()},
        f"{FORWARD}.origin": weights.origin,
    }
    return RestState(state, {CACHE: cache.spacing, FORWARD: weights.spacing})


def search_field(character: Character, settings: Settings, rest: RestState) -> SearchField:
    """An untrained field of the method "nilbs" around grids of the rest pose."""
    c = character
    part = {name: torch.as_tensor(array) for name, array in rest.arrays.items()}
    cache = RestCache(
        part[f"{CACHE}.values"],
        part[f"{CACHE}.brick"],
        part[f"{CACHE}.finer"],
        part[f"{CACHE}.origin"],
        float(rest.spacing[CACHE]),
        parts=PARTS,
        width=settings.cache_width,
    )
    sizes = {"width": settings.width, "depth": settings.depth}
    encoding: LocalEncoding | ParameterEncoding
    if settings.encoding == "local":
        encoding = LocalEncoding(torch.as_tensor(at_rest(c, c.skeleton.C[c.skeleton.BE[:, 0]])))
    else:
        encoding = ParameterEncoding(torch.as_tensor(c.skeleton.P), c.d)
    network = WeightNetwork(encoding, len(c.skeleton.BE), ghost=settings.ghost, **sizes)
    forward_field = ForwardField(
        row=part[f"{FORWARD}.row"],
        node=part[f"{FORWARD}.node"],
        bone=part[f"{FORWARD}.bone"],
        weight=part[f"{FORWARD}.weight"],
        first=part[f"{FORWARD}.first"],
        origin=part[f"{FORWARD}.origin"],
        spacing=float(rest.spacing[FORWARD]),
    )
    forward_network = ForwardNetwork(c.d, len(c.skeleton.BE), **sizes) if settings.forward == "network" else None
    return SearchField(NilbsField(network, cache, root=root_bone(c)), forward_field, forward_network)


def check_rest_state(state: Mapping[str, np.ndarray], character: Character) -> None:
    """Check that the grids of a field's state fit the character and themselves.

    Raises
    ------
    KeyError, ValueError
        Naming what does not.
    """
    d, b = character.d, len(character.skeleton.BE)
    values, brick, finer = (state[f"{CACHE}.{name}"] for name in ("values", "brick", "finer"))
    row, first = state[f"{FORWARD}.row"], state[f"{FORWARD}.first"]
    for name, grid, least in (("rest cache", brick, 1), ("grid of rest weights", row, 2)):
        if grid.ndim != d or min(grid.shape) < least:
            raise ValueError(f"the {name} has shape {grid.shape}")
    bone, weight, node = (state[f"{FORWARD}.{name}"] for name in ("bone", "weight", "node"))
    arrays(
        values=(values, "n"), finer=(finer, "c", int), origin=(state[f"{CACHE}.origin"], f"{d}"),
        weight=(weight, "s"), weight_origin=(state[f"{FORWARD}.origin"], f"{d}"),
    )  # fmt: skip
    if any(indices.dtype != np.int32 for indices in (brick, finer, row, node, bone, first)):
        raise ValueError("brick, finer, row, node, bone and first must be stored as 32-bit integers")
    # What bricks there are is told by their numbers, and is checked where they are read.
    if min(brick.min(), finer.min(initial=-1)) < -1:
        raise ValueError("a brick of the rest cache has a number below -1")
    steps = np.diff(first.astype(np.int64))
    if first.ndim != 1 or len(first) < 2 or first[0] != 0 or first[-1] != len(bone) or (steps < 1).any():
        raise ValueError("the rows of rest weights do not follow each other")
    for name in (f"{CACHE}.values", f"{CACHE}.origin", f"{FORWARD}.weight", f"{FORWARD}.origin"):
        if state[name].dtype.kind != "f":
            raise ValueError(f"{name} must be stored as floating-point numbers")
    # Beyond the skin weights go on as they change inside, and leave 0 to 1, but not by much.
    if not np.abs(weight).max(initial=0) < 100:
        raise ValueError("a rest weight is 100 or more")
    if bone.shape != weight.shape or row.min() < 0 or row.max() >= len(steps) or bone.min() < 0 or bone.max() >= b:
        raise ValueError("a row or a bone of the rest weights does not exist")
    if node.shape != steps.shape or node.min() < 0 or node.max() >= row.size:
        raise ValueError("a node of the rest weights does not exist")
