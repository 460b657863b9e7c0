"""What importing loads: the promise that geometry and files need neither torch nor trimesh."""

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

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


# What each layer may import of the project.
BELOW = {
    "geometry": {"geometry"},
    "io": {"geometry", "io"},
    "fields": {"geometry", "fields", "settings"},
}


def imported(path: Path) -> set[str]:
    """The project's modules that a file imports, in functions and for types too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return {name for name in found if name.split(".")[0] == "nilbs"}


@pytest.mark.parametrize("layer", BELOW)
def test_a_layer_imports_nothing_above_it(layer: str) -> None:
    files = list(Path(nilbs.__file__).with_name(layer).rglob("*.py"))
    assert files
    for path in files:
        above = {name for name in imported(path) if name.split(".")[1] not in BELOW[layer]}
        assert not above, path


def test_nothing_but_commands_imports_commands() -> None:
    root = Path(nilbs.__file__).parent
    files = [path for path in root.rglob("*.py") if path.parent.name != "app" and path.name != "__main__.py"]
    assert not [path for path in files if any(name.startswith("nilbs.app") for name in imported(path))]


COPYLEFT = ("pymeshlab", "igl.copyleft", "triangle", "tetgen")


def copyleft(path: Path) -> set[str]:
    """Libraries of `COPYLEFT` that a file imports or reaches through another."""
    named = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            named |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            named |= {f"{node.module}.{name.name}" for name in node.names}
        elif isinstance(node, ast.Attribute):
            named.add(ast.unparse(node))
    return {library for library in COPYLEFT if any(f"{name}.".startswith(f"{library}.") for name in named)}


def test_what_is_copyleft_is_imported_in_its_folder_only() -> None:
    found = {path: copyleft(path) for path in Path(nilbs.__file__).parent.rglob("*.py")}
    assert {library for libraries in found.values() for library in libraries} >= {"pymeshlab", "igl.copyleft"}
    assert {path.parent.name for path, libraries in found.items() if libraries} == {"copyleft"}


@pytest.mark.parametrize(
    "line",
    ["import pymeshlab as ml", "from pymeshlab import MeshSet", "from igl import copyleft", "igl.copyleft.tetgen.f()"],
)
def test_copyleft_in_any_form_is_seen(line: str, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(f"{line}\n")
    assert copyleft(tmp_path / "a.py")


def test_names_are_loaded_when_they_are_asked_for() -> None:
    assert nilbs.Settings().seed == 0
    assert set(nilbs.__all__) <= set(dir(nilbs))
    for name in nilbs.__all__:
        assert getattr(nilbs, name).__name__ == name
    with pytest.raises(AttributeError, match=r"^module 'nilbs' has no attribute 'nothing'$"):
        _ = nilbs.nothing
