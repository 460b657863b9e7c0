from dataclasses import asdict, replace

import pytest
from nilbs.methods.settings import MAPPINGS, METHODS, UNTRAINED, Settings


def test_a_mapping_and_back() -> None:
    settings = Settings(steps=7, supervision="paper", noise=0.01)
    assert Settings.from_mapping(asdict(settings)) == settings
    assert replace(settings, steps=8).steps == 8


def test_a_whole_number_stands_for_a_length() -> None:
    assert Settings(noise=1).noise == 1


@pytest.mark.parametrize(("bones", "steps"), [(1, 1100), (4, 1400), (30, 4000), (163, 4000)])
@pytest.mark.parametrize(("d", "cells", "weights"), [(2, 2048, 256), (3, 512, 128)])
def test_what_is_left_open_fits_the_character(bones: int, steps: int, d: int, cells: int, weights: int) -> None:
    resolved = Settings(seed=4).resolved(bones=bones, d=d)
    sizes = {"learning_rate": 0.01, "width": 96, "depth": 5, "poses_per_step": 64, "points_per_pose": 128}
    assert resolved == Settings(seed=4, steps=steps, cache_resolution=cells, weight_resolution=weights, **sizes)
    sizes = {"learning_rate": 0.5, "width": 7, "depth": 2, "poses_per_step": 6, "points_per_pose": 12}
    given = Settings(steps=7, cache_resolution=9, weight_resolution=8, **sizes)
    assert given.resolved(bones=bones, d=d) == given


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 1.5}, "steps must be of type int, got 1.5"),
        ({"steps": True}, "steps must be of type int, got True"),
        ({"steps": None}, "steps must be of type int, got None"),
        ({"noise": "0.1"}, "noise must be of type float, got '0.1'"),
        ({"supervision": 1}, "supervision must be of type str, got 1"),
        ({"seed": -1}, "seed must lie between 0 and 1e9, got -1"),
        ({"learning_rate": float("nan")}, "learning_rate must lie between 0 and 1e9, got nan"),
        ({"shell": float("inf")}, "shell must lie between 0 and 1e9, got inf"),
        ({"steps": -1}, "steps must lie between 0 and 1e9, got -1"),
        ({"cache_resolution": -1}, "cache_resolution must lie between 0 and 1e9, got -1"),
        ({"ghost": 1}, "ghost must be of type bool, got 1"),
        ({"method": "magic"}, f"method must be one of {', '.join(METHODS)}, got 'magic'"),
        ({"cache_width": 0.0}, "cache_width must be at least 1e-06, got 0.0"),
        ({"width": 100_000}, "width and depth must be at most 4096, got 100000 and 0"),
        ({"depth": 1}, "depth must be at least 2, got 1"),
        ({"supervision": "none"}, "supervision must be one of volume, paper, got 'none'"),
        (
            {"supervision": "paper", "method": "nasa"},
            "supervision 'paper' is of the method nilbs: nasa has losses of its own",
        ),
        ({"mapping": "forward"}, f"mapping must be one of {', '.join(MAPPINGS)}, got 'forward'"),
    ],
)
def test_a_value_out_of_range_is_named(changes: dict, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        Settings(**changes)
    assert str(caught.value) == message


def test_other_names_are_refused() -> None:
    values = asdict(Settings())
    for wrong in ({**values, "colour": "red"}, {k: v for k, v in values.items() if k != "steps"}, {}):
        with pytest.raises(ValueError, match=r"^settings are \["):
            Settings.from_mapping(wrong)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_sizes_of_its_own(method: str) -> None:
    resolved = Settings(method=method).resolved(bones=3, d=2)
    assert {name: getattr(resolved, name) for name in METHODS[method]} == METHODS[method]
    assert (resolved.steps == 0) == (method in UNTRAINED)


@pytest.mark.parametrize(
    ("d", "name", "fits"),
    [
        (2, "cache_resolution", 32_000),
        (3, "cache_resolution", 1000),
        (2, "weight_resolution", 11_000),
        (3, "weight_resolution", 500),
    ],
)
def test_a_grid_that_would_fill_the_memory_is_refused(d: int, name: str, fits: int) -> None:
    assert getattr(Settings(**{name: fits}).resolved(bones=3, d=d), name) == fits
    with pytest.raises(ValueError, match=rf"^{name} must be at most \d+ in {d} dimensions, got {2 * fits}$"):
        Settings(**{name: 2 * fits}).resolved(bones=3, d=d)
