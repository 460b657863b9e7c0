"""Grids of the rest pose: distance and weights, by their names in a model's state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import prod
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_array

from nilbs.characters.character import Character
from nilbs.engine.distances import MOST_PARTS, Distances, divisions
from nilbs.engine.search import SearchEngine
from nilbs.engine.unit_frame import FAR, at_rest
from nilbs.engine.weights import Weights
from nilbs.geometry.facets import facet_areas
from nilbs.geometry.grids import Grid
from nilbs.geometry.rest_grids import distance_bricks, scaled_rows, weight_grid
from nilbs.geometry.skin_fit import fit_to_skin
from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.weight_blocks import EDGE, ONE, WeightBlocks

# In units of L: the band around the body with rest weights, the distance beyond which they stay constant, and the
# margin of both grids around the body.
BAND, DEPTH, PAD = 0.03, 0.015, 0.05
# Parts that the edge of a cell of distance is divided in, in the plane and in space: at the surface, and again where
# the distance at the surface is more than the tolerance on average, in units of L; and the most values of all.
PARTS, TOLERANCE, MOST_VALUES = {2: (4, 2, 2), 3: (4, 2)}, 7e-6, 6_500_000
# Distances are rounded to multiples of this, in units of L, or of what 16 bits need.
UNIT = 1.2e-5
# Weights below this are not kept; the rest of the row is scaled to sum to one.
SMALLEST = 3e-4
# In space: about how many nodes of a grid of weights lie in the body and the band, the most cells along its longest
# edge, and how many cells of distance lie along the edge of one of weights, at the surface.
NODES, MOST_CELLS, FINER = 1e5, 192, 3.2
# Cells along the longest edge in the plane, of distance at the surface and of weights.
CELLS_IN_PLANE = (2048, 256)
DISTANCE, WEIGHTS = "rest.distance", "rest.weights"
# The largest count of an int16.
LARGEST = 32_767
# Types of the arrays.
KINDS = {
    **{f"{DISTANCE}.{name}": kind for name, kind in {
        "values": np.int16, "unit": np.float32, "brick": np.int32, "finer": np.int32, "origin": np.float64,
    }.items()},
    **{f"{WEIGHTS}.{name}": kind for name, kind in {
        "place": np.int32, "first": np.int64, "bone": np.int32, "weight": np.int16, "origin": np.float64,
        "shape": np.int32,
    }.items()},
}  # fmt: skip
# Of grids in files: the shortest edge of a cell, in units of L, the most cells along an axis, and the most nodes.
FINEST, MOST_ALONG, MOST_NODES = 1e-6, 2**20, 2**28


@dataclass(frozen=True)
class RestState:
    """What a field keeps of the rest pose: of a method without grids, nothing.

    Attributes
    ----------
    arrays : mapping of str to array
        By their names in the model's state, in the unit frame.
    header : mapping of str to Any
        What belongs to them in JSON: the edges of cells (`spacing`) and the divisions of bricks (`parts`).
    """

    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    header: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_state(cls, state: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> Self:
        """The grids among all arrays of a model."""
        kept = {name: array for name, array in state.items() if name.startswith("rest.")}
        return cls(kept, {name: header[name] for name in ("spacing", "parts") if name in header})

    @property
    def blocks(self) -> WeightBlocks:
        """The weights."""
        return WeightBlocks(*(self.arrays[f"{WEIGHTS}.{name}"] for name in ("place", "first", "bone", "weight")))

    def engine(self, *, width: float) -> SearchEngine:
        """The compiled search on these grids."""
        spacing = self.header["spacing"]
        weights = Weights.of(self.blocks, self.arrays[f"{WEIGHTS}.origin"], spacing["weights"])
        parts = {name: self.arrays[f"{DISTANCE}.{name}"] for name in ("values", "unit", "brick", "finer", "origin")}
        distances = Distances.of(**parts, spacing=spacing["distance"], parts=self.header["parts"])
        return SearchEngine.of(weights, distances, d=self.blocks.place.shape[1], width=width)

    def distance_values(self) -> np.ndarray:
        """Distances (s,) at all nodes of the bricks."""
        values = self.arrays[f"{DISTANCE}.values"].astype(np.float64)
        brick, finer = (self.arrays[f"{DISTANCE}.{name}"] for name in ("brick", "finer"))
        begins = [0, *(division.first_value for division in divisions(brick, finer, self.header["parts"])), len(values)]
        for begin, end, unit in zip(begins, begins[1:], self.arrays[f"{DISTANCE}.unit"], strict=False):
            values[begin:end] *= unit
        return values


def rest_cells(character: Character) -> tuple[int, int]:
    """Cells along the longest edge that fit a body: of distance at the surface, and of weights.

    A slim body has thin limbs, and fills little of its box: its grids are finer, and not larger.
    """
    c = character
    if c.d == 2:
        return CELLS_IN_PLANE
    area = facet_areas(c.V_volume, boundary_facets(c.T)).sum() / c.L**2
    filled = element_volumes(c.V_volume, c.T).sum() / c.L**3 + BAND * area
    cells = (1 + 2 * PAD) * (NODES / max(filled, 1e-9)) ** (1 / 3)
    return round(min(cells, MOST_CELLS) * FINER), round(min(cells, MOST_CELLS))


def rest_state(character: Character, *, cache_cells: int, weight_cells: int, seed: int) -> RestState:
    """Grids of a character at rest, with so many cells along their longest edges."""
    c, parts = character, PARTS[character.d]
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    cache = Grid.box(V, max(2, -(-cache_cells // parts[0])), pad=PAD)
    rng = np.random.default_rng(seed)
    bricks = distance_bricks(V, c.F, cache, parts=parts, tolerance=TOLERANCE, most=MOST_VALUES, rng=rng)
    weights = Grid.box(V, weight_cells, pad=PAD)
    # In a volume no weight is zero, and most are tiny.
    W, W_volume = (scaled_rows(csr_array(W), smallest=SMALLEST / 10) for W in (c.W, c.W_volume))
    node, W_node = weight_grid(V, c.F, W, V_volume, c.T, W_volume, weights, band=BAND, depth=DEPTH)
    W_node = fit_to_skin(V, c.F, W, weights, node, W_node, smallest=SMALLEST, rng=rng)
    return _state(
        bricks.values, bricks.brick, bricks.finer, cache, list(parts), WeightBlocks.pack(node, W_node, weights), weights
    )


def from_version_6(
    state: Mapping[str, np.ndarray], header: Mapping[str, Any], character: Character
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """State and header of a model of the last version, whose grids were not rounded.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the grids do not fit the character or themselves.
    """
    cache, forward = (
        {name.removeprefix(part): array for name, array in state.items() if name.startswith(part)}
        for part in ("inverse.cache.", "forward_field.")
    )
    rest = {name: a for name, a in state.items() if not name.startswith(("inverse.cache.", "forward_field."))}
    _check_version_6(cache, forward, character)
    first, bone, weight, order = forward["first"], forward["bone"], forward["weight"], np.argsort(forward["node"])
    W = csr_array((weight.astype(np.float64), bone, first), shape=(len(first) - 1, len(character.skeleton.BE)))
    spacing = header["spacing"]
    weights = Grid(forward["origin"], float(spacing["forward_field"]), forward["row"].shape)
    grid = Grid(cache["origin"], float(spacing["inverse.cache"]), tuple(n + 1 for n in cache["brick"].shape))
    blocks = WeightBlocks.pack(forward["node"][order], scaled_rows(csr_array(W[order])), weights)
    made = _state(cache["values"], cache["brick"], cache["finer"], grid, [4, 2, 2], blocks, weights)
    return rest | dict(made.arrays), {**header, **made.header}


def _check_version_6(cache: Mapping[str, np.ndarray], forward: Mapping[str, np.ndarray], c: Character) -> None:
    """Raise ValueError if arrays of the last version do not fit the character and themselves."""
    d, b = c.d, len(c.skeleton.BE)
    brick, finer, row = cache["brick"], cache["finer"], forward["row"]
    for name, grid, least in (("rest cache", brick, 1), ("grid of rest weights", row, 2)):
        if grid.ndim != d or min(grid.shape) < least:
            raise ValueError(f"the {name} has shape {grid.shape}")
    whole = {"brick": brick, "finer": finer, **{name: forward[name] for name in ("row", "node", "bone", "first")}}
    parts = {"values": cache["values"], "origin": cache["origin"]}
    parts |= {"weight": forward["weight"], "weight_origin": forward["origin"]}
    if any(array.dtype != np.int32 for array in whole.values()):
        raise ValueError(f"{', '.join(whole)} must be stored as 32-bit integers")
    if wrong := [name for name, array in parts.items() if array.dtype.kind != "f"]:
        raise ValueError(f"{wrong[0]} must be stored as floating-point numbers")
    node, bone, first, weight = (forward[name] for name in ("node", "bone", "first", "weight"))
    arrays(
        finer=(finer, "c", int), values=(cache["values"], "n"), origin=(cache["origin"], f"{d}"),
        weight_origin=(forward["origin"], f"{d}"), first=(first, "r+1", int), node=(node, "r", int),
        bone=(bone, "s", int), weight=(weight, "s"),
    )  # fmt: skip
    if min(brick.min(), finer.min(initial=-1)) < -1:
        raise ValueError("a brick of the rest cache has a number below -1")
    divisions(brick, finer, [4, 2, 2], values=len(cache["values"]))
    if not len(node) or first[0] != 0 or first[-1] != len(bone) or (np.diff(first.astype(np.int64)) < 1).any():
        raise ValueError("the rows of rest weights do not follow each other")
    if bone.min() < 0 or bone.max() >= b:
        raise ValueError("a bone of the rest weights does not exist")
    if node.min() < 0 or node.max() >= row.size or len(np.unique(node)) < len(node):
        raise ValueError("a node of the rest weights does not exist, or has two rows")
    if not (np.abs(np.add.reduceat(weight.astype(np.float64), first[:-1]) - 1) < 1e-3).all():
        raise ValueError("the rest weights of a node do not sum to one")


def _state(
    values: np.ndarray,
    brick: np.ndarray,
    finer: np.ndarray,
    cache: Grid,
    parts: list[int],
    blocks: WeightBlocks,
    weights: Grid,
) -> RestState:
    begins = [0, *(division.first_value for division in divisions(brick, finer, parts)), len(values)]
    rounded, units = np.empty(len(values), dtype=np.int16), np.ones(1 + len(parts), dtype=np.float32)
    for k, (begin, end) in enumerate(pairwise(begins)):
        units[k] = max(float(np.abs(values[begin:end]).max(initial=0)) / LARGEST, UNIT)
        rounded[begin:end] = np.clip(np.round(values[begin:end] / units[k]), -LARGEST, LARGEST)
    found = {
        f"{DISTANCE}.values": rounded,
        f"{DISTANCE}.unit": units,
        f"{DISTANCE}.brick": brick,
        f"{DISTANCE}.finer": finer,
        f"{DISTANCE}.origin": cache.origin,
        **{f"{WEIGHTS}.{name}": array for name, array in blocks._asdict().items()},
        f"{WEIGHTS}.origin": weights.origin,
        f"{WEIGHTS}.shape": np.array(weights.shape, dtype=np.int32),
    }
    return RestState(found, {"spacing": {"distance": cache.spacing, "weights": weights.spacing}, "parts": parts})


def check_rest_state(state: RestState, character: Character) -> None:
    """Check that the grids of a model fit the character and themselves: compiled code reads them as they are.

    Raises
    ------
    KeyError, TypeError, ValueError, OverflowError
        Naming what does not.
    """
    d, b = character.d, len(character.skeleton.BE)
    if unknown := sorted(set(state.arrays) - set(KINDS)):
        raise ValueError(f"{unknown[0]} is no array of the rest grids")
    for name, kind in KINDS.items():
        if state.arrays[name].dtype != kind:
            raise ValueError(f"{name} must be stored as {np.dtype(kind)}, not as {state.arrays[name].dtype}")
    spacing, parts = state.header["spacing"], state.header["parts"]
    for name in ("distance", "weights"):
        if type(spacing[name]) not in (int, float) or not FINEST <= float(spacing[name]) < FAR:
            raise ValueError(f"cells of grids must have an edge from {FINEST:g} to {FAR:g}, got {spacing}")
        (origin,) = arrays(**{f"{name}_origin": (state.arrays[f"rest.{name}.origin"], f"{d}")})
        if not np.abs(origin).max() < FAR:
            raise ValueError(f"the grid of rest {name} begins very far away, at {origin.tolist()}")
    most = round(MOST_PARTS ** (1 / d))
    if type(parts) is not list or len(parts) > 8 or not all(type(part) is int and 2 <= part <= most for part in parts):
        raise ValueError(f"edges of cells must be divided at most 8 times in 2 to {most} parts, got {parts}")
    _check_distances(state.arrays, d, parts)
    _check_weights(state.arrays, d, b)


def _check_distances(state: Mapping[str, np.ndarray], d: int, parts: list[int]) -> None:
    values, unit, brick, finer = (state[f"{DISTANCE}.{name}"] for name in ("values", "unit", "brick", "finer"))
    if brick.ndim != d or min(brick.shape) < 1 or max(brick.shape) > MOST_ALONG:
        raise ValueError(f"the grid of rest distances has shape {brick.shape}")
    arrays(values=(values, "s"), finer=(finer, "c", int), unit=(unit, f"{1 + len(parts)}"))
    if not (unit.min() > 0 and unit.max() < FAR):
        raise ValueError(f"units of rest distances must lie between 0 and {FAR:g}, got {unit.tolist()}")
    if min(brick.min(), finer.min(initial=-1)) < -1:
        raise ValueError("a brick of the rest distances has a number below -1")
    divisions(brick, finer, parts, values=len(values))


def _check_weights(state: Mapping[str, np.ndarray], d: int, b: int) -> None:
    place, first, bone, weight, shape = (
        state[f"{WEIGHTS}.{name}"] for name in ("place", "first", "bone", "weight", "shape")
    )
    if shape.shape != (d,) or shape.min() < 2 or shape.max() > MOST_ALONG or prod(shape.tolist()) > MOST_NODES:
        raise ValueError(f"the grid of rest weights has shape {shape.tolist()}")
    k = len(place)
    if k < 1 or place.shape != (k, d) or first.shape != (k + 1,):
        raise ValueError(f"the blocks of rest weights have places {place.shape} and beginnings {first.shape}")
    if place.min() < 0 or (place >= -(-(shape - 1) // EDGE)).any():
        raise ValueError("a block of rest weights lies outside the grid")
    if len(np.unique(np.ravel_multi_index(tuple(place.T), tuple(shape.tolist())))) < k:
        raise ValueError("two blocks of rest weights lie at the same place")
    counts = np.diff(first)
    if first[0] != 0 or first[-1] != len(bone) or bone.ndim != 1 or (counts < 1).any():
        raise ValueError("the bones of blocks of rest weights do not follow each other")
    if bone.min() < 0 or bone.max() >= b:
        raise ValueError("a bone of the rest weights does not exist")
    nodes = (EDGE + 1) ** d
    if weight.shape != (nodes * len(bone),):
        raise ValueError(f"rest weights must be {nodes * len(bone)} numbers, got an array {weight.shape}")
    begins = np.concatenate([[0], np.cumsum(np.repeat(counts, nodes))[:-1]])
    if (np.add.reduceat(weight, begins, dtype=np.int64) != ONE).any():
        raise ValueError("the rest weights of a node do not sum to one")
