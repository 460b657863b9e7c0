"""Grids of the rest pose: distance and weights, by their names in a model's state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np

from nilbs.characters.character import Character
from nilbs.engine.distances import Distances, divisions
from nilbs.engine.search import SearchEngine
from nilbs.engine.unit_frame import at_rest
from nilbs.engine.weights import Weights
from nilbs.geometry.grids import Grid
from nilbs.geometry.rest_grids import distance_bricks, weight_grid
from nilbs.geometry.skin_fit import fit_to_skin
from nilbs.geometry.validation import arrays
from nilbs.geometry.weight_blocks import EDGE, ONE, WeightBlocks

# In units of L: the band around the body with rest weights, and the distance beyond which they stay constant.
BAND, DEPTH = 0.05, 0.015
# Parts that the edge of a cell of the rest cache is divided in: at the surface, and again, twice, where interpolation
# misses the distance by more than this much, in units of L, and this share of it besides.
PARTS, TOLERANCE, RELATIVE = (4, 2, 2), 1e-5, 0.01
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


def rest_state(character: Character, *, cache_cells: int, weight_cells: int, seed: int) -> RestState:
    """Grids of a character at rest, with so many cells along their longest edges."""
    c = character
    V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
    cache = Grid.box(V, max(2, -(-cache_cells // PARTS[0])))
    weights = Grid.box(V, weight_cells, pad=BAND)
    node, W_node = weight_grid(V, c.F, c.W, V_volume, c.T, c.W_volume, weights, band=BAND, depth=DEPTH)
    W_node = fit_to_skin(V, c.F, c.W, weights, node, W_node, rng=np.random.default_rng(seed))
    bricks = distance_bricks(V, c.F, cache, parts=PARTS, tolerance=TOLERANCE, relative=RELATIVE)
    return _state(
        bricks.values, bricks.brick, bricks.finer, cache, list(PARTS), WeightBlocks.pack(node, W_node, weights), weights
    )


def from_version_6(
    state: Mapping[str, np.ndarray], header: Mapping[str, Any], character: Character
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """State and header of a model of the last version, whose grids were not rounded."""
    old = {name: state[name] for name in state if name.startswith(("inverse.cache.", "forward_field."))}
    rest = {name: array for name, array in state.items() if name not in old}
    cache = {name.removeprefix("inverse.cache."): array for name, array in old.items()}
    forward = {name.removeprefix("forward_field."): array for name, array in old.items()}
    first = forward["first"]
    W = np.zeros((len(first) - 1, len(character.skeleton.BE)), dtype=np.float32)
    W[np.repeat(np.arange(len(W)), np.diff(first)), forward["bone"]] = forward["weight"]
    spacing = header["spacing"]
    weights = Grid(forward["origin"], spacing["forward_field"], forward["row"].shape)
    grid = Grid(cache["origin"], spacing["inverse.cache"], tuple(n + 1 for n in cache["brick"].shape))
    blocks = WeightBlocks.pack(forward["node"], W, weights)
    made = _state(cache["values"], cache["brick"], cache["finer"], grid, list(PARTS), blocks, weights)
    return rest | dict(made.arrays), {**header, **made.header}


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
        units[k] = max(float(np.abs(values[begin:end]).max(initial=0)) / LARGEST, 1e-12)
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
