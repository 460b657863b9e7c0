"""The field of the root search, in torch, around the grids of the rest pose."""

import torch

from nilbs.characters.character import Character
from nilbs.engine.rest_state import DISTANCE, WEIGHTS, RestState
from nilbs.engine.unit_frame import first_joints, last_joints, root_bone
from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import DistanceEncoding, LocalEncoding, ParameterEncoding
from nilbs.fields.forward import ForwardField
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.inverse_map import InverseField
from nilbs.fields.network import WeightNetwork
from nilbs.fields.search import SearchField


def search_field(
    character: Character,
    rest: RestState,
    *,
    cache_width: float,
    encoding: str,
    ghost: bool,
    width: int,
    depth: int,
    forward_network: bool,
) -> SearchField:
    """An untrained field around grids of the rest pose; the options are settings of `InverseSkinning`."""
    c, b, spacing = character, len(character.skeleton.BE), rest.header["spacing"]
    cache = RestCache(
        torch.as_tensor(rest.distance_values()),
        **{name: torch.as_tensor(rest.arrays[f"{DISTANCE}.{name}"]) for name in ("brick", "finer")},
        origin=torch.as_tensor(rest.arrays[f"{DISTANCE}.origin"]),
        spacing=float(spacing["distance"]),
        parts=rest.header["parts"],
        width=cache_width,
    )
    encoded: LocalEncoding | ParameterEncoding
    if encoding == "distances":
        encoded = DistanceEncoding(torch.as_tensor(first_joints(c)), torch.as_tensor(last_joints(c)))
    elif encoding == "local":
        encoded = LocalEncoding(torch.as_tensor(first_joints(c)))
    else:
        encoded = ParameterEncoding(torch.as_tensor(c.skeleton.P), c.d)
    network = WeightNetwork(encoded, b, ghost=ghost, width=width, depth=depth)
    rows = rest.blocks.rows(tuple(int(n) for n in rest.arrays[f"{WEIGHTS}.shape"]))
    forward_field = ForwardField(
        **{name: torch.as_tensor(array) for name, array in rows.items()},
        origin=torch.as_tensor(rest.arrays[f"{WEIGHTS}.origin"]),
        spacing=float(spacing["weights"]),
    )
    second = ForwardNetwork(c.d, b, width=width, depth=depth) if forward_network else None
    return SearchField(InverseField(network, cache, root=root_bone(c)), forward_field, second)
