"""The public names of `nilbs.geometry`."""

import importlib
import pkgutil
import subprocess
import sys

import pytest

import nilbs.geometry

SUBMODULES = [module.name for module in pkgutil.walk_packages(nilbs.geometry.__path__)]


def test_importing_the_package_loads_no_library() -> None:
    code = "import sys, nilbs.geometry; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert "nilbs.geometry" in loaded
    assert not {"numpy", "scipy", "igl", "skimage"} & set(loaded)


def test_no_name_is_also_a_module() -> None:
    assert len(nilbs.geometry.__all__) > 40
    assert not set(nilbs.geometry.__all__) & set(SUBMODULES)


@pytest.mark.parametrize("order", [1, -1])
def test_a_name_stays_its_function_after_all_modules_are_imported(order: int) -> None:
    for name in SUBMODULES[::order]:
        importlib.import_module(f"nilbs.geometry.{name}")
    for name in nilbs.geometry.__all__:
        found = getattr(nilbs.geometry, name)
        assert callable(found)
        assert found.__name__ == name
        assert found is getattr(sys.modules[found.__module__], name)
    assert set(nilbs.geometry.__all__) <= set(dir(nilbs.geometry))


@pytest.mark.parametrize("name", nilbs.geometry.__all__)
def test_a_public_docstring_has_all_parts(name: str) -> None:
    found = getattr(nilbs.geometry, name)
    parts = ["Examples"] if isinstance(found, type) else ["Parameters", "Returns", "Raises", "Examples"]
    assert [part for part in parts if f"    {part}\n    {'-' * len(part)}\n" not in found.__doc__] == []
