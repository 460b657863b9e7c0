"""Grids of the rest pose: distance and weights, by their names in a model's state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_array

from nilbs.characters.character import Character
from nilbs.engine.distances import Distances, divisions
from nilbs.engine.search import SearchEngine
from nilbs.engine.unit_frame import at_rest
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
# Parts that the edge of a cell of distance is divided in: at the surface, and again, twice, where the distance at the
# surface is more than this on average, in units of L; and the most values of all.
PARTS, TOLERANCE, MOST_VALUES = (4, 2, 2), 7e-6, 6_500_000
# Distances are rounded to multiples of this, in units of L, or of what 16 bits need.
UNIT = 1e-5
# Weights below this are not kept; the rest of the row is scaled to sum to one.
SMALLEST = 2e-4
# In space: about how many nodes of a grid of weights lie in the body and the band, the most cells along its longest
# edge, and how many cells of distance lie along the edge of one of weights, at the surface.
NODES, MOST_CELLS, FINER = 1e5, 192, 8 / 3
# Cells along the longest edge in the plane, of distance at the surface and of weights.
CELLS_IN_PLANE = (2048, 256)
DISTANCE, WEIGHTS = "rest.distance", "rest.weights"
# The largest count of an int16.
LARGEST = 32_767


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
    c = character
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    cache = Grid.box(V, max(2, -(-cache_cells // PARTS[0])), pad=PAD)
    rng = np.random.default_rng(seed)
    bricks = distance_bricks(V, c.F, cache, parts=PARTS, tolerance=TOLERANCE, most=MOST_VALUES, rng=rng)
    weights = Grid.box(V, weight_cells, pad=PAD)
    # In a volume no weight is zero, and most are tiny.
    W, W_volume = (scaled_rows(csr_array(W), smallest=SMALLEST / 10) for W in (c.W, c.W_volume))
    node, W_node = weight_grid(V, c.F, W, V_volume, c.T, W_volume, weights, band=BAND, depth=DEPTH)
    W_node = fit_to_skin(V, c.F, W, weights, node, W_node, smallest=SMALLEST, rng=rng)
    return _state(
        bricks.values, bricks.brick, bricks.finer, cache, list(PARTS), WeightBlocks.pack(node, W_node, weights), weights
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
    """Check that the grids of a model fit the character and themselves.

    Raises
    ------
    KeyError, TypeError, ValueError
        Naming what does not.
    """
    d, b = character.d, len(character.skeleton.BE)
    spacing, parts = state.header["spacing"], state.header["parts"]
    if not all(0 < float(spacing[name]) < 1e9 for name in ("distance", "weights")):
        raise ValueError(f"cells of grids must have an edge above zero, got {spacing}")
    if not all(type(part) is int and 2 <= part <= 64 for part in parts):
        raise ValueError(f"cells must be divided in 2 to 64 parts, got {parts}")
    values, unit, brick, finer, origin = (
        state.arrays[f"{DISTANCE}.{name}"] for name in ("values", "unit", "brick", "finer", "origin")
    )
    arrays(unit=(unit, f"{1 + len(parts)}"), origin=(origin, f"{d}"))
    place, first, bone, weight, weight_origin, shape = (
        state.arrays[f"{WEIGHTS}.{name}"] for name in ("place", "first", "bone", "weight", "origin", "shape")
    )
    arrays(weight_origin=(weight_origin, f"{d}"), shape=(shape, f"{d}", int))
    kinds = {"values": (values, "int16"), "brick": (brick, "int32"), "finer": (finer, "int32"),
             "place": (place, "int32"), "first": (first, "int64"), "bone": (bone, "int32"),
             "weight": (weight, "int16"), "unit": (unit, "float32")}  # fmt: skip
    for name, (array, kind) in kinds.items():
        if array.dtype != kind or array.ndim != {"brick": d, "place": 2}.get(name, 1):
            raise ValueError(f"{name} of the rest grids is {array.dtype} {array.shape}")
    if min(brick.shape) < 1 or min(brick.min(), finer.min(initial=-1)) < -1:
        raise ValueError(f"the rest cache has shape {brick.shape}, or a brick a number below -1")
    divisions(brick, finer, parts, values=len(values))
    if not len(place) or place.shape[1] != d or place.min() < 0 or (EDGE * place >= shape).any() or shape.max() > 2**20:
        raise ValueError("a block of weights lies outside the grid, or there is none")
    if len(np.unique(np.ravel_multi_index(tuple(place.T), tuple(int(n) for n in shape)))) < len(place):
        raise ValueError("two blocks of weights lie at the same place")
    counts = np.diff(first)
    if first.shape != (len(place) + 1,) or first[0] != 0 or first[-1] != len(bone) or (counts < 1).any():
        raise ValueError("the bones of blocks do not follow each other")
    nodes = (EDGE + 1) ** d
    if len(weight) != nodes * len(bone) or bone.min() < 0 or bone.max() >= b:
        raise ValueError("weights and bones of blocks do not fit, or a bone does not exist")
    row = np.concatenate([[0], np.cumsum(np.repeat(counts, nodes))[:-1]])
    if (np.add.reduceat(weight, row, dtype=np.int64) != ONE).any():
        raise ValueError("the weights of a node do not sum to one")
