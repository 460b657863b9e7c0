"""Grids of the rest pose: distance and weights, by their names in the field's state."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import LocalEncoding, ParameterEncoding
from nilbs.fields.forward import ForwardField, packed_weights
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.inverse_map import InverseField
from nilbs.fields.network import WeightNetwork
from nilbs.fields.search import SearchField
from nilbs.engine.unit_frame import at_rest, first_joints, root_bone
from nilbs.geometry.grids import Grid
from nilbs.geometry.rest_grids import distance_bricks, weight_grid
from nilbs.geometry.skin_fit import fit_to_skin
from nilbs.geometry.validation import arrays

# In units of L: the band around the body with rest weights, and the distance beyond which they stay constant.
BAND, DEPTH = 0.05, 0.015
# Parts that the edge of a cell of the rest cache is divided in: at the surface, and again, twice, where interpolation
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


def rest_state(character: Character, *, cache_cells: int, weight_cells: int, seed: int) -> RestState:
    """Grids of a character at rest, with so many cells along their longest edges."""
    c = character
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    cache = Grid.box(V, max(2, -(-cache_cells // PARTS[0])))
    weights = Grid.box(V, weight_cells, pad=BAND)
    node, W_node = weight_grid(V, c.F, c.W, V_volume, c.T, c.W_volume, weights, band=BAND, depth=DEPTH)
    W_node = fit_to_skin(V, c.F, c.W, weights, node, W_node, rng=np.random.default_rng(seed))
    bricks = distance_bricks(V, c.F, cache, parts=PARTS, tolerance=TOLERANCE, relative=RELATIVE)
    state = {
        **{f"{CACHE}.{name}": array for name, array in bricks._asdict().items()},
        f"{CACHE}.origin": cache.origin,
        **{f"{FORWARD}.{name}": array for name, array in packed_weights(node, W_node, weights.shape).items()},
        f"{FORWARD}.origin": weights.origin,
    }
    return RestState(state, {CACHE: cache.spacing, FORWARD: weights.spacing})


def search_field(
    character: Character,
    grids: Mapping[str, np.ndarray],
    spacing: Mapping[str, float],
    *,
    cache_width: float,
    encoding: str,
    ghost: bool,
    width: int,
    depth: int,
    forward_network: bool,
) -> SearchField:
    """An untrained field around grids of the rest pose; the options are settings of `InverseSkinning`."""
    c, b = character, len(character.skeleton.BE)
    part = {name: torch.as_tensor(array) for name, array in grids.items()}
    cache = RestCache(
        **{name: part[f"{CACHE}.{name}"] for name in ("values", "brick", "finer", "origin")},
        spacing=float(spacing[CACHE]),
        parts=PARTS,
        width=cache_width,
    )
    encoded: LocalEncoding | ParameterEncoding
    if encoding == "local":
        encoded = LocalEncoding(torch.as_tensor(first_joints(c)))
    else:
        encoded = ParameterEncoding(torch.as_tensor(c.skeleton.P), c.d)
    network = WeightNetwork(encoded, b, ghost=ghost, width=width, depth=depth)
    forward_field = ForwardField(
        **{name: part[f"{FORWARD}.{name}"] for name in ("row", "node", "bone", "weight", "first", "origin")},
        spacing=float(spacing[FORWARD]),
    )
    second = ForwardNetwork(c.d, b, width=width, depth=depth) if forward_network else None
    return SearchField(InverseField(network, cache, root=root_bone(c)), forward_field, second)


def spacing_of(field: SearchField) -> dict[str, float]:
    """Edges of the cells of a field's grids, which are no tensors."""
    return {CACHE: field.inverse.cache.spacing, FORWARD: field.forward_field.spacing}


def checked_spacing(values: Mapping[str, Any]) -> dict[str, float]:
    """What `spacing_of` returned, from a file.

    Raises
    ------
    KeyError, TypeError, ValueError
        If an edge is missing or no positive number.
    """
    spacing = {name: float(values[name]) for name in (CACHE, FORWARD)}
    if not all(0 < edge < 1e9 for edge in spacing.values()):
        raise ValueError(f"cells of grids must have an edge above zero, got {spacing}")
    return spacing


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
    # RestCache checks how many bricks there are.
    if min(brick.min(), finer.min(initial=-1)) < -1:
        raise ValueError("a brick of the rest cache has a number below -1")
    steps = np.diff(first.astype(np.int64))
    if first.ndim != 1 or len(first) < 2 or first[0] != 0 or first[-1] != len(bone) or (steps < 1).any():
        raise ValueError("the rows of rest weights do not follow each other")
    for name in (f"{CACHE}.values", f"{CACHE}.origin", f"{FORWARD}.weight", f"{FORWARD}.origin"):
        if state[name].dtype.kind != "f":
            raise ValueError(f"{name} must be stored as floating-point numbers")
    # Outside, weights continue linearly and leave [0, 1] a little.
    if not np.abs(weight).max(initial=0) < 100:
        raise ValueError("a rest weight is 100 or more")
    if bone.shape != weight.shape or row.min() < 0 or row.max() >= len(steps) or bone.min() < 0 or bone.max() >= b:
        raise ValueError("a row or a bone of the rest weights does not exist")
    if node.shape != steps.shape or node.min() < 0 or node.max() >= row.size:
        raise ValueError("a node of the rest weights does not exist")
