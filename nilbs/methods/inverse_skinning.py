"""What nilbs and the paper's own recipe share: a weight network, rest grids, and the ways through them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from nilbs.methods.base import NetworkMethod, check_shapes, setting

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from nilbs.characters.character import Character
    from nilbs.engine.answer import Engine
    from nilbs.engine.rest_state import RestState
    from nilbs.fields.field import Field, PosedField
    from nilbs.fields.inverse_map import InverseField
    from nilbs.fields.objective import Term
    from nilbs.fields.samples import RestSamples
    from nilbs.fields.scene import Scene
    from nilbs.fields.search import SearchField
    from nilbs.fields.weight_term import WeightTerm

MAPPINGS = {
    "search": "a root search on the forward weights from every part of the body that lies there, without the network",
    "one-search": "the root search from the network's answer alone",
    "all-bones": "the root search from every bone's rigid inverse, as in SNARF, without the network",
    "fixed-point": "eq. 5 iterated from the network's answer: x_rest <- [W(x_rest) B]^-1 x",
    "inverse": "the network's inverse map (eq. 6), with the ghost bone (eq. 8)",
    "reverse": "the blend of the bones' inverses, sum_b W_b B_b^-1 x, with the ghost bone",
}
ENCODINGS = {
    "distances": "the point in every bone's local coordinates, and its distances from all posed bones",
    "local": "the point in every bone's local coordinates, for any rig",
    "parameters": "the point and the pose's parameters",
}
ENCODED = "what the network is given of a point and a pose"
NEED_NETWORK = {"one-search", "fixed-point", "inverse", "reverse"}
# The most nodes of a grid that anyone can have meant.
MOST_CELLS, MOST_WEIGHT_CELLS = 2**30, 2**27


@dataclass(frozen=True)
class InverseSkinning(NetworkMethod):
    """A field that finds the canonical point of a posed point, and reads distance there from a cache."""

    mappings: ClassVar[Mapping[str, str]] = MAPPINGS

    steps: int | None = setting(
        None, "training steps (default: 1000 and 100 more for each bone, at most 4000); 0: no network, the grids alone"
    )
    mapping: str = setting("search", "way to the canonical point; training does not depend on it", choices=MAPPINGS)
    encoding: str = setting("local", ENCODED, choices=ENCODINGS)
    ghost: bool = setting(True, "whether the network has a ghost bone (eq. 8)")
    forward_map: str = setting(
        "grid", "rest weights of the forward map (eq. 4): a grid, or a second network", choices=("grid", "network")
    )
    weight_loss: float = setting(1.0, "factor of the cross-entropy of the network's weights")
    cache_resolution: int | None = setting(
        None,
        "cells of the rest cache along its longest edge, at the surface (default: by the shape; 2048 in the plane)",
        least=1,
    )
    weight_resolution: int | None = setting(
        None,
        "cells of the rest weights along the longest edge (default: by the shape; 256 in the plane)",
        least=1,
    )
    cache_width: float = setting(0.003, "width of the step by which occupancy is read from distance", least=1e-6)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_mapping(None)

    def resolved(self, character: "Character") -> Self:
        """With steps, and grids as fine as fits the dimension.

        Raises
        ------
        ValueError
            If a grid would not fit into memory.
        """
        d = character.d
        for name, most in (("cache_resolution", MOST_CELLS), ("weight_resolution", MOST_WEIGHT_CELLS)):
            if (cells := getattr(self, name) or 0) ** d > most:
                raise ValueError(f"{name} must be at most {int(most ** (1 / d))} in {d} dimensions, got {cells}")
        from nilbs.engine.rest_state import rest_cells

        of_cache, of_weights = rest_cells(character)
        return replace(
            super().resolved(character),
            cache_resolution=self.cache_resolution or of_cache,
            weight_resolution=self.weight_resolution or of_weights,
        )

    def rest(self, character: "Character") -> "RestState":
        """Grids of distance and of weights."""
        from nilbs.engine.rest_state import rest_state

        assert self.cache_resolution is not None
        assert self.weight_resolution is not None
        return rest_state(
            character, cache_cells=self.cache_resolution, weight_cells=self.weight_resolution, seed=self.seed
        )

    def field(self, character: "Character") -> "SearchField":
        """An untrained field; its grids of the rest pose are computed here."""
        return self.field_around(character, self.rest(character))

    def field_around(self, character: "Character", rest: "RestState") -> "SearchField":
        """An untrained field around grids of the rest pose."""
        from nilbs.fields.rest_state import search_field

        return search_field(
            character,
            rest,
            cache_width=self.cache_width,
            encoding=self.encoding,
            ghost=self.ghost,
            width=self.width,
            depth=self.depth,
            forward_network=self.forward_map == "network",
        )

    def engine(self, character: "Character", rest: "RestState", mapping: str | None = None) -> "Engine | None":
        """The compiled root search, by the mapping "search" on the grid of weights."""
        if (mapping or self.mapping) != "search" or self.forward_map != "grid":
            return None
        return rest.engine(width=self.cache_width)

    def check_mapping(self, mapping: str | None) -> None:
        """Raise ValueError if there is no such mapping, or no network for it."""
        super().check_mapping(mapping)
        if self.steps == 0 and (mapping or self.mapping) in NEED_NETWORK:
            raise ValueError(f"the mapping {mapping or self.mapping!r} needs a network, and with 0 steps there is none")

    def terms(self, field: "Field", scene: "Scene") -> "list[Term]":
        """Losses of the weights at canonical points, and of the second network where there is one."""
        from nilbs.fields.search import SearchField
        from nilbs.fields.weight_term import ForwardWeightTerm

        assert isinstance(field, SearchField)
        points = self.supervised_points(scene)
        term = self.weight_term(field.inverse, points, scene)
        if term is None and not self.occupancy_loss:
            raise ValueError("every loss of the weight network is off: there is nothing to train for")
        terms: list[Term] = [] if term is None else [term]
        if field.forward_network is not None:
            count = self.poses_per_step * self.points_per_pose
            terms.append(ForwardWeightTerm(field.forward_network, points, points=count))
        return terms

    def supervised_points(self, scene: "Scene") -> "RestSamples":
        """Canonical points whose weights are given to the network."""
        raise NotImplementedError

    def weight_term(self, field: "InverseField", points: "RestSamples", scene: "Scene") -> "WeightTerm | None":
        """The loss of the weights there; None if it is off."""
        raise NotImplementedError

    def posed(self, field: "Field", B: "Tensor", mapping: str | None = None, *, ghost: bool = True) -> "PosedField":
        """A field of this method in a pose, by one of its mappings."""
        from nilbs.fields.search import SearchField

        assert isinstance(field, SearchField)
        self.check_mapping(mapping)
        return field.posed(B, mapping or self.mapping, ghost=ghost)

    def check_state(self, character: "Character", state: "Mapping[str, np.ndarray]", rest: "RestState") -> None:
        """As `NetworkMethod.check_state`; without steps there is no network."""
        from nilbs.engine.rest_state import check_rest_state

        check_rest_state(rest, character)
        if self.steps:
            self.check_layers(state)
        check_shapes(state, self.parameter_shapes(character) if self.steps else {})

    def parameter_shapes(self, character: "Character") -> dict[str, tuple[int, ...]]:
        """Shapes of the parameters of a trained field, by their names in its state."""
        b, d = len(character.skeleton.BE), character.d
        inputs = {"distances": b * d + b, "local": b * d, "parameters": d + b * {2: 1, 3: 3}[d]}[self.encoding]
        shapes = self.layer_shapes("inverse.network.layers", inputs, b + self.ghost)
        if self.encoding != "parameters":
            shapes["inverse.network.encoding.centers"] = (b, d)
        if self.forward_map == "network":
            shapes |= self.layer_shapes("forward_network.layers", d, b)
        return shapes
