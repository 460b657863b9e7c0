from dataclasses import dataclass, replace
from itertools import permutations
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from nilbs.app.main import main, parser_of
from nilbs.app.method_options import chosen_method
from nilbs.methods.base import REGISTERED, Method, TrainedMethod, setting
from nilbs.methods.mlp import Mlp
from nilbs.methods.nasa import Nasa
from nilbs.methods.nilbs import Nilbs
from nilbs.methods.paper import Paper
from nilbs.methods.registry import all_methods, method_class, method_of, of_version_5, values_of

METHODS = all_methods()


def character(bones: int, d: int):
    """The unit cube in six tetrahedra along its diagonal, with so many bones."""
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    steps = np.array(list(permutations([4, 2, 1])))
    T = np.concatenate([np.zeros((6, 1), dtype=int), np.cumsum(steps, axis=1)], axis=1)
    turned = np.linalg.det(np.diff(corners[T], axis=1)) < 0
    T[turned] = T[turned][:, [0, 2, 1, 3]]
    return SimpleNamespace(d=d, L=1.0, V_volume=corners, T=T, skeleton=SimpleNamespace(BE=np.zeros((bones, 2))))


def test_every_method_is_found_by_its_name() -> None:
    trained = ["mlp", "nasa", "nasa-rigid", "nilbs", "paper", "snarf"]
    assert list(METHODS) == [*trained, "mesh-lbs", "nearest", "rigid-parts"]
    assert [name for name, kind in METHODS.items() if issubclass(kind, TrainedMethod)] == trained
    for name, kind in METHODS.items():
        assert method_class(name) is kind
        assert kind.name == name
        assert kind.summary
        assert all(s.help for s in kind.settings())
    with pytest.raises(ValueError, match="magic") as caught:
        method_of("magic")
    assert all(name in str(caught.value) for name in METHODS)


@pytest.mark.parametrize("name", METHODS)
def test_settings_go_to_json_and_back(name: str) -> None:
    method = method_of(name, seed=7)
    assert type(method).from_settings(values_of(method)) == method
    assert {s.name: s.default for s in method.settings()} | {"seed": 7} == values_of(method)
    with pytest.raises(ValueError, match="colour"):
        method_of(name, colour="red")


def test_settings_are_changed_in_a_method_that_is_given() -> None:
    assert method_of(Nasa(width=8), steps=3) == Nasa(width=8, steps=3)
    assert method_of(Nilbs(noise=1)).noise == 1  # a whole number stands for a length


@pytest.mark.parametrize(("bones", "steps"), [(1, 1100), (4, 1400), (30, 4000), (163, 4000)])
# In space a unit cube holds 1e5 nodes of weights, with the band around it, and distance is 3.2 times as fine.
@pytest.mark.parametrize(("d", "cells", "weights"), [(2, 2048, 256), (3, 155, 48)])
def test_what_is_left_open_fits_the_character(bones: int, steps: int, d: int, cells: int, weights: int) -> None:
    open_ended = Nilbs(seed=4)
    resolved = open_ended.resolved(character(bones, d))
    assert resolved == replace(open_ended, steps=2000, cache_resolution=cells, weight_resolution=weights)
    given = Nilbs(steps=7, cache_resolution=9, weight_resolution=8)
    assert given.resolved(character(bones, d)) == given
    assert Mlp().resolved(character(bones, d)).steps == steps


@pytest.mark.parametrize(
    ("kind", "changes", "facts"),
    [
        (Nilbs, {"steps": 1.5}, ["steps", "int", "1.5"]),
        (Nilbs, {"steps": True}, ["steps", "int", "True"]),
        (Nilbs, {"steps": -1}, ["steps", "0", "-1"]),
        (Mlp, {"steps": 0}, ["steps", "1", "0"]),
        (Nilbs, {"steps": 0, "mapping": "inverse"}, ["'inverse'", "network", "0 steps"]),
        (Paper, {"steps": 0}, ["'inverse'", "network", "0 steps"]),
        (Nasa, {"width": None}, ["width", "int", "None"]),
        (Mlp, {"noise": "0.1"}, ["noise", "float", "'0.1'"]),
        (Nilbs, {"encoding": 1}, ["encoding", "str", "1"]),
        (Method, {"seed": -1}, ["seed", "-1"]),
        (Mlp, {"learning_rate": float("nan")}, ["learning_rate", "nan"]),
        (Nilbs, {"shell": float("inf")}, ["shell", "inf"]),
        (Nilbs, {"cache_resolution": -1}, ["cache_resolution", "-1"]),
        (Nilbs, {"ghost": 1}, ["ghost", "bool", "1"]),
        (Paper, {"cache_width": 0.0}, ["cache_width", "1e-06", "0.0"]),
        (Nasa, {"width": 100_000}, ["width", "4096", "100000"]),
        (Nilbs, {"depth": 1}, ["depth", "2", "1"]),
        (Mlp, {"width": 4096, "depth": 4096}, ["depth 4096", "width 4096", "1e+09"]),
        (Paper, {"mapping": "forward"}, ["mapping", *Paper.mappings, "'forward'"]),
    ],
)
def test_a_value_out_of_range_is_named(kind: type[Method], changes: dict, facts: list[str]) -> None:
    with pytest.raises(ValueError) as caught:
        kind(**changes)
    assert all(fact in str(caught.value) for fact in facts)


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
    assert getattr(Nilbs(**{name: fits}).resolved(character(3, d)), name) == fits
    with pytest.raises(ValueError, match=rf"^{name} .* {d} dimensions, got {2 * fits}$"):
        Nilbs(**{name: 2 * fits}).resolved(character(3, d))


def test_settings_of_the_last_file_version_make_the_same_method() -> None:
    old = {
        "method": "nilbs", "steps": 1200, "learning_rate": 0.01, "width": 96, "depth": 5, "poses_per_step": 64,
        "points_per_pose": 128, "samples_per_frame": 20_000, "noise": 0.006, "supervision": "volume", "shell": 0.01,
        "encoding": "local", "ghost": False, "forward": "grid", "occupancy_loss": 0.0, "weight_loss": 1.0,
        "position_loss": 20.0, "random_pose_std": 0.8, "adaptive": True, "mapping": "all-bones", "cache_resolution": 64,
        "weight_resolution": 32, "cache_width": 0.003, "seed": 3,
    }  # fmt: skip
    sizes = {"cache_resolution": 64, "weight_resolution": 32}
    changed = {"poses_per_step": 64, "encoding": "local", "random_pose_std": 0.8}
    again = Nilbs(steps=1200, ghost=False, mapping="all-bones", seed=3, **sizes, **changed)
    assert of_version_5(old) == again
    paper = of_version_5(old | {"supervision": "paper", "mapping": "inverse"})
    assert paper == Paper(steps=1200, ghost=False, occupancy_loss=0.0, noise=0.0, seed=3, **sizes)
    nothing = dict.fromkeys(("steps", "learning_rate", "width", "depth", "poses_per_step", "points_per_pose"), 0)
    assert of_version_5(old | nothing | {"method": "nearest"}) == method_of("nearest", seed=3)
    assert of_version_5(old | {"method": "nasa", "width": 12}).width == 12


def test_the_command_line_takes_the_choices_of_the_chosen_method(monkeypatch) -> None:
    @dataclass(frozen=True)
    class Other(Method):
        summary: ClassVar[str] = "another way"
        mapping: str = setting("up", "way to the canonical point", choices=("up", "down"))

    monkeypatch.setattr(Other, "name", "other", raising=False)
    monkeypatch.setitem(REGISTERED, "other", Other)

    def chosen(*options: str) -> Method:
        words = ["train", "a.glb", "-o", "a.nilbs", *options]
        return chosen_method(parser_of(words).parse_args(words))

    assert chosen("--method", "other", "--mapping", "down") == Other(mapping="down")
    assert chosen("--mapping", "all-bones") == Nilbs(mapping="all-bones")
    with pytest.raises(ValueError, match="'down'"):
        chosen("--mapping", "down")


def test_a_setting_with_the_name_of_another_option_is_one_line(monkeypatch, capsys) -> None:
    @dataclass(frozen=True)
    class Other(Method):
        summary: ClassVar[str] = "another way"
        frames: int = setting(3, "how many")

    monkeypatch.setattr(Other, "name", "other", raising=False)
    monkeypatch.setitem(REGISTERED, "other", Other)
    assert main(["train", "a.glb", "-o", "a.nilbs"]) == 2
    assert "method other " in (error := capsys.readouterr().err)
    assert "--frames" in error


def test_two_classes_have_two_names() -> None:
    with pytest.raises(ValueError, match=r"'mlp' .*nilbs\.methods\.mlp\.Mlp"):
        type("Another", (Method,), {"name": "mlp", "summary": "another", "__module__": __name__})
    with pytest.raises(ValueError, match=r"'mlp' .*nilbs\.methods\.mlp\.Mlp"):  # the same class name, elsewhere
        type("Mlp", (Method,), {"name": "mlp", "summary": "another", "__module__": __name__})
    assert method_class("mlp") is Mlp


def test_mistakes_in_a_method_of_ones_own_are_one_line() -> None:
    @dataclass(frozen=True)
    class Nameless(Method):
        radius: float = setting(0.1, "radius")

    @dataclass(frozen=True)
    class Plain(Method):
        radius: float = 0.1

    @dataclass(frozen=True)
    class Sized(Method):
        radii: tuple[()] = setting((), "radii")

    Undecorated = type("Undecorated", (Method,), {"radius": setting(0.1, "radius")})
    with pytest.raises(ValueError, match=r"Nameless .*name"):
        Nameless()
    with pytest.raises(ValueError, match=r"Plain\.radius .*setting"):
        Plain.settings()
    with pytest.raises(ValueError, match=r"Sized\.radii .*float"):
        Sized.settings()
    with pytest.raises(ValueError, match=r"Undecorated .*@dataclass"):
        Undecorated.settings()
    with pytest.raises(ValueError, match=r"'wordless' .*summary"):
        type("Wordless", (Method,), {"name": "wordless"})
    assert "wordless" not in REGISTERED


def test_defining_a_class_registers_it_and_a_subclass_inherits_settings() -> None:
    @dataclass(frozen=True)
    class Quieter(Mlp):
        name: ClassVar[str] = "quieter-mlp"
        noise: float = setting(0.001, "less noise")

    try:
        assert method_of("quieter-mlp", width=3) == Quieter(width=3)
        assert Quieter().noise == 0.001
    finally:
        del REGISTERED["quieter-mlp"]


def test_a_package_whose_method_cannot_be_imported_is_named(monkeypatch) -> None:
    from importlib.metadata import EntryPoint

    from nilbs.methods import registry

    broken = EntryPoint("broken", "no_such_package:Method", "nilbs.methods")
    monkeypatch.setattr(registry, "entry_points", lambda group: [broken])
    registry._import_methods.cache_clear()
    try:
        with pytest.raises(ValueError, match=r"'broken', no_such_package:Method"):
            all_methods()
    finally:
        registry._import_methods.cache_clear()
