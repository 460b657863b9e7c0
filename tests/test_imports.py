"""What importing loads: the promise that geometry and files need neither torch nor trimesh, and queries no torch."""

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import nilbs
import nilbs.characters
import nilbs.engine
import nilbs.geometry
import nilbs.io
import nilbs.models


def submodules(package) -> list[str]:
    return [module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_importing_nilbs_loads_no_heavy_library() -> None:
    loaded = python("import sys, nilbs; print(*sys.modules)").split()
    assert "nilbs" in loaded
    assert not {"numpy", "torch", "trimesh", "igl", "skimage", "scipy", "matplotlib"} & set(loaded)


def test_geometry_and_files_import_without_torch_and_trimesh() -> None:
    names = submodules(nilbs.geometry) + submodules(nilbs.io)
    assert {"nilbs.geometry.weights", "nilbs.geometry.copyleft.tetrahedra", "nilbs.io.mesh"} <= set(names)
    blocked = "import sys; sys.modules['torch'] = sys.modules['trimesh'] = None; "
    loaded = python(f"{blocked}import {', '.join(names)}; print(*sys.modules)").split()
    assert set(names) <= set(loaded)


def test_what_answers_queries_imports_without_torch() -> None:
    names = [name for package in (nilbs.characters, nilbs.engine, nilbs.models) for name in submodules(package)]
    names.remove("nilbs.models.torch_field")
    assert {"nilbs.engine.search", "nilbs.models.model", "nilbs.models.fitting"} <= set(names)
    methods = "from nilbs.methods.registry import all_methods; all_methods(); "
    loaded = python(f"import sys; sys.modules['torch'] = None; import {', '.join(names)}; {methods}print(*sys.modules)")
    assert set(names) <= set(loaded.split())


# What each folder may import of the others, in functions and for types too; itself besides.
ALLOWED = {
    "geometry": set(),
    "io": {"geometry"},
    "characters": {"geometry", "io"},
    "engine": {"geometry", "characters"},
    "fields": {"geometry", "characters", "engine"},
    "methods": {"geometry", "characters", "engine", "fields"},
    "models": {"geometry", "io", "characters", "engine", "fields", "methods"},
    "contacts": {"geometry", "characters", "engine", "models"},
    "figures": {"geometry", "io", "characters", "methods", "models", "contacts"},
    "race": {"geometry", "io", "characters", "engine", "fields", "methods", "models"},
    "reports": {"geometry", "io", "characters", "models", "figures", "race"},
    "viewer": {"geometry", "io", "characters", "engine", "methods", "models", "contacts", "figures"},
    "app": {"geometry", "io", "characters", "methods", "models", "contacts", "figures", "race", "reports", "viewer"},
}
PACKAGE = Path(nilbs.__file__).parent


def imported(path: Path) -> set[str]:
    """The project's modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 or (node.level == 1 and path.suffix == ".pyi")  # a stub of lazy names
            above = ".".join([*path.relative_to(PACKAGE.parent).parts[:-1], ""]) if node.level else ""
            found |= {f"{above}{node.module}.{name.name}" for name in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found.add(ast.unparse(node.args[0]).strip("f'"))
    return {name for name in found if name.split(".")[0] in ("nilbs", "benchmarks")}


def test_every_folder_has_its_row() -> None:
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(ALLOWED)
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("folder", ALLOWED)
def test_a_folder_imports_what_its_row_allows(folder: str) -> None:
    files = [*(PACKAGE / folder).rglob("*.py"), *(PACKAGE / folder).rglob("*.pyi")]
    assert files
    for path in files:
        for name in imported(path):
            top, *rest = name.split(".")
            assert top == "nilbs", path
            # All names are attributes of the package, so that only the topmost folder imports it whole.
            allowed = {folder, *ALLOWED[folder]}
            assert rest[0] in allowed if rest else folder == "app", (path, name)


def test_arrows_point_down_only() -> None:
    done: set[str] = set()
    for folder, below in ALLOWED.items():  # each row stands after those that it names: no circle
        assert below <= done
        done.add(folder)


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


def test_names_are_loaded_when_they_are_used() -> None:
    assert nilbs.method_of("nasa", seed=3).seed == 3
    assert set(nilbs.__all__) <= set(dir(nilbs))
    for name in nilbs.__all__:
        assert getattr(nilbs, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing"):
        _ = nilbs.nothing
