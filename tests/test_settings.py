from dataclasses import asdict, replace

import pytest

from nilbs.settings import Settings


def test_a_mapping_and_back() -> None:
    settings = Settings(steps=7, supervision="paper", noise=0.01)
    assert Settings.from_mapping(asdict(settings)) == settings
    assert replace(settings, steps=8).steps == 8


def test_a_whole_number_stands_for_a_length() -> None:
    assert Settings(noise=1).noise == 1


@pytest.mark.parametrize(("bones", "steps"), [(1, 2250), (4, 3000), (32, 10_000), (163, 10_000)])
@pytest.mark.parametrize(("d", "cells", "weights"), [(2, 512, 256), (3, 256, 128)])
def test_what_is_left_open_fits_the_character(bones: int, steps: int, d: int, cells: int, weights: int) -> None:
    resolved = Settings(seed=4).resolved(bones=bones, d=d)
    assert resolved == Settings(seed=4, steps=steps, cache_resolution=cells, weight_resolution=weights)
    given = Settings(steps=7, cache_resolution=9, weight_resolution=8)
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
        ({"width": 0}, "width must be positive, got 0"),
        ({"cache_width": 0.0}, "cache_width must be positive, got 0.0"),
        ({"depth": 1}, "depth must be at least 2, got 1"),
        ({"supervision": "none"}, "supervision must be one of volume, paper, got 'none'"),
        ({"mapping": "forward"}, "mapping must be one of search, inverse, got 'forward'"),
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
