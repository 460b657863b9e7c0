from dataclasses import replace

import numpy as np
import pytest
import torch
from nilbs.methods.settings import Settings

from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.rest_state import RestState, check_rest_state, rest_state, search_field
from nilbs.fields.unit_frame import at_rest
from nilbs.geometry.distance import signed_distance

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
SETTINGS = Settings(width=8, depth=2, cache_resolution=64, weight_resolution=48)


@pytest.fixture(scope="module")
def states(characters) -> dict[int, RestState]:
    return {d: rest_state(c, SETTINGS) for d, c in characters.items()}


@DIMENSIONS
def test_the_cache_answers_distance_at_the_skin(d: int, characters, states, rng: np.random.Generator) -> None:
    c = characters[d]
    V = at_rest(c, c.V)
    x = V[rng.integers(0, len(V), 400)] + rng.normal(scale=0.01, size=(400, d))
    cache = search_field(c, SETTINGS, states[d]).double().inverse.cache
    missed = np.abs(cache.distance(torch.as_tensor(x)).numpy() - signed_distance(V, c.F, x))
    assert np.median(missed) < 2e-4
    assert np.quantile(missed, 0.75) < 1e-3
    # Distance bends halfway between limbs too, where an undivided cell misses it by less than its edge.
    assert missed.max() < 4 / 64


@DIMENSIONS
def test_the_forward_field_answers_the_weights_in_the_body(d: int, characters, states) -> None:
    c = characters[d]
    field = search_field(c, SETTINGS, states[d]).double()
    # Of bones of which one alone moves, by a unit, the blend's shift is its weight; between nodes it is interpolated.
    x = torch.as_tensor(at_rest(c, c.V_volume))
    for bone in range(len(c.skeleton.BE)):
        B = torch.eye(d + 1, dtype=torch.float64).repeat(len(c.skeleton.BE), 1, 1)
        B[bone, 0, d] = 1
        shift = field.forward_field.pose(x, field.forward_field.blends(B)).x - x
        missed = np.abs(shift[:, 0].numpy() - c.W_volume[:, bone])
        assert missed.mean() < 0.01
        assert np.quantile(missed, 0.99) < 0.1


@DIMENSIONS
def test_the_forward_field_is_fitted_to_the_skin(d: int, characters, states, monkeypatch) -> None:
    c = characters[d]
    x = torch.as_tensor(at_rest(c, c.V)[c.F].mean(axis=1))

    def missed(state: RestState) -> float:
        field = search_field(c, SETTINGS, state).double().forward_field
        B = torch.eye(d + 1, dtype=torch.float64).repeat(len(c.skeleton.BE), 1, 1)
        B[1, 0, d] = 1
        shift = (field.pose(x, field.blends(B)).x - x)[:, 0].numpy()
        return float(np.abs(shift - c.W[c.F, 1].mean(axis=1)).mean())

    fitted = missed(states[d])
    monkeypatch.setattr("nilbs.fields.rest_state.fit_to_skin", lambda V, F, W, grid, node, W_node, **others: W_node)
    assert fitted < 0.9 * missed(rest_state(c, SETTINGS))


@DIMENSIONS
def test_finer_settings_give_finer_grids(d: int, characters, states) -> None:
    finer = rest_state(characters[d], replace(SETTINGS, cache_resolution=128, weight_resolution=96))
    for part, spacing in states[d].spacing.items():
        assert finer.spacing[part] == pytest.approx(spacing / 2, rel=0.1)
    for state in (states[d], finer):
        check_rest_state(state.arrays, characters[d])


@DIMENSIONS
def test_a_field_is_what_settings_say(d: int, characters, states) -> None:
    c, b = characters[d], len(characters[d].skeleton.BE)

    def field(**changes):
        return search_field(c, replace(SETTINGS, **changes), states[d]).float()

    default = field()
    x, B = torch.zeros((1, 4, d)), torch.eye(d + 1).repeat(1, b, 1, 1)
    assert default.inverse(x, B).weights.shape == (1, 4, b + 1)
    assert (default.inverse(x, B).weights[..., -1] > 0).all()
    assert (field(ghost=False).inverse(x, B).weights[..., -1] == 0).all()
    assert isinstance(field(encoding="parameters").inverse.network.encoding, ParameterEncoding)
    assert default.forward_network is None
    assert isinstance(field(forward="network").forward_network, ForwardNetwork)
    assert field(cache_width=0.02).inverse.cache.width == 0.02
    assert len(field(depth=5).inverse.network.layers) == len(default.inverse.network.layers) + 3
