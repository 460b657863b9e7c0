import numpy as np
import pytest
import torch

from nilbs.engine.rest_state import DISTANCE, RestState, check_rest_state, rest_state
from nilbs.engine.unit_frame import at_rest
from nilbs.fields import rest_state as rest_module
from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.geometry.distance import signed_distance

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
CELLS = {"cache_cells": 64, "weight_cells": 48, "seed": 0}


def search_field(c, state: RestState, **changes):
    options = {
        "cache_width": 0.003, "encoding": "local", "ghost": True, "width": 8, "depth": 2, "forward_network": False
    }  # fmt: skip
    return rest_module.search_field(c, state, **options | changes)


@pytest.fixture(scope="module")
def states(characters) -> dict[int, RestState]:
    return {d: rest_state(c, **CELLS) for d, c in characters.items()}


@DIMENSIONS
def test_the_cache_answers_distance_at_the_skin(d: int, characters, states, rng: np.random.Generator) -> None:
    c = characters[d]
    V = at_rest(c, c.V)
    skin = V[c.F].mean(axis=1)
    cache = search_field(c, states[d]).double().inverse.cache
    for noise, typical, most in ((0.0, 1e-5, 1e-4), (0.002, 2e-5, 1e-4), (0.01, 5e-5, 1e-3)):
        x = skin[rng.integers(0, len(skin), 400)] + rng.normal(scale=noise, size=(400, d))
        missed = np.abs(cache.distance(torch.as_tensor(x)).numpy() - signed_distance(V, c.F, x))
        assert np.median(missed) < typical
        assert np.quantile(missed, 0.9) < most
    # Distance bends halfway between limbs too, where an undivided cell misses it by less than its edge.
    assert missed.max() < 4 / 64


@DIMENSIONS
def test_the_forward_field_answers_the_weights_in_the_body(d: int, characters, states) -> None:
    c = characters[d]
    field = search_field(c, states[d]).double()
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
        field = search_field(c, state).double().forward_field
        B = torch.eye(d + 1, dtype=torch.float64).repeat(len(c.skeleton.BE), 1, 1)
        B[1, 0, d] = 1
        shift = (field.pose(x, field.blends(B)).x - x)[:, 0].numpy()
        return float(np.abs(shift - c.W[c.F, 1].mean(axis=1)).mean())

    fitted = missed(states[d])
    monkeypatch.setattr("nilbs.engine.rest_state.fit_to_skin", lambda V, F, W, grid, node, W_node, **others: W_node)
    assert fitted < 0.9 * missed(rest_state(c, **CELLS))


@DIMENSIONS
def test_finer_settings_give_finer_grids(d: int, characters, states) -> None:
    finer = rest_state(characters[d], cache_cells=128, weight_cells=96, seed=0)
    for part, spacing in states[d].header["spacing"].items():
        assert finer.header["spacing"][part] == pytest.approx(spacing / 2, rel=0.1)
    for state in (states[d], finer):
        check_rest_state(state, characters[d])


@DIMENSIONS
def test_distances_are_stored_in_16_bits_of_their_own_division(d: int, states) -> None:
    state = states[d]
    values, unit = (state.arrays[f"{DISTANCE}.{name}"] for name in ("values", "unit"))
    assert values.dtype == np.int16
    # Finer bricks lie closer to the skin: their values are smaller, and so are their steps.
    assert (np.diff(unit) <= 0).all()
    assert 0 < unit[-1] <= unit[0] < 1e-4
    # The cache reads each division in its own steps.
    read = state.distance_values()
    cells = np.array(state.arrays[f"{DISTANCE}.brick"].shape)
    undivided = np.prod(cells + 1)
    np.testing.assert_allclose(read[:undivided], values[:undivided] * unit[0].astype(float))
    assert np.abs(read[undivided:]).max() < np.abs(read[:undivided]).max()


@DIMENSIONS
def test_a_field_has_the_options_that_were_chosen(d: int, characters, states) -> None:
    c, b = characters[d], len(characters[d].skeleton.BE)

    def field(**changes):
        return search_field(c, states[d], **changes).float()

    default = field()
    x, B = torch.zeros((1, 4, d)), torch.eye(d + 1).repeat(1, b, 1, 1)
    assert default.inverse.weights(x, B).shape == (1, 4, b + 1)
    assert (default.inverse.weights(x, B)[..., -1] > 0).all()
    assert (field(ghost=False).inverse.weights(x, B)[..., -1] == 0).all()
    assert isinstance(field(encoding="parameters").inverse.network.encoding, ParameterEncoding)
    assert default.forward_network is None
    assert isinstance(field(forward_network=True).forward_network, ForwardNetwork)
    assert field(cache_width=0.02).inverse.cache.width == 0.02
    assert len(field(depth=5).inverse.network.layers) == len(default.inverse.network.layers) + 3
