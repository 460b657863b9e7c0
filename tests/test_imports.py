"""What importing loads: the promise that geometry and files need neither torch nor trimesh."""

import pkgutil
import subprocess
import sys

import pytest

import nilbs
import nilbs.geometry
import nilbs.io


def submodules(package) -> list[str]:
    return [module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_importing_nilbs_loads_no_heavy_library() -> None:
    loaded = python("import sys, nilbs; print(*sys.modules)").split()
    assert "nilbs" in loaded
    assert not {"torch", "trimesh", "igl", "skimage", "scipy", "matplotlib"} & set(loaded)


def test_geometry_and_files_import_without_torch_and_trimesh() -> None:
    names = submodules(nilbs.geometry) + submodules(nilbs.io)
    assert {"nilbs.geometry.weights", "nilbs.geometry.copyleft.tetrahedra", "nilbs.io.mesh"} <= set(names)
    blocked = "import sys; sys.modules['torch'] = sys.modules['trimesh'] = None; "
    loaded = python(f"{blocked}import {', '.join(names)}; print(*sys.modules)").split()
    assert set(names) <= set(loaded)


def test_names_are_loaded_when_they_are_asked_for() -> None:
    assert nilbs.Settings().seed == 0
    assert set(nilbs.__all__) <= set(dir(nilbs))
    for name in nilbs.__all__:
        assert getattr(nilbs, name).__name__ == name
    with pytest.raises(AttributeError, match=r"^module 'nilbs' has no attribute 'nothing'$"):
        _ = nilbs.nothing
