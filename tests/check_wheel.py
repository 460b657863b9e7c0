"""Run in a bare environment with nilbs installed from its wheel: the wheel is whole, and holds nothing else.

python check_wheel.py FOLDER, which holds the wheel and the sdist.
"""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path


def check(folder: Path) -> None:
    """Exit with a line on standard error if anything is missing or too much."""
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    if tops != {"nilbs"}:
        sys.exit(f"{wheel}: it must hold nilbs/ alone, and holds {sorted(tops)}")
    with tarfile.open(sdist) as archive:
        source = {name.partition("/")[2] for name in archive.getnames()}
    needed = {
        name
        for name in source
        if name.startswith("nilbs/") and name.endswith((".py", ".pyi", "py.typed", ".html", ".css", ".js"))
    }
    if not {"nilbs/__init__.pyi", "nilbs/py.typed"} <= needed or needed - set(names):
        sys.exit(f"{wheel}: it lacks {sorted((needed | {'nilbs/__init__.pyi', 'nilbs/py.typed'}) - set(names))}")
    if not {"LICENSE", "README.md", "pyproject.toml"} <= source:
        sys.exit(f"{sdist}: it lacks the licence, the README or pyproject.toml")


def use() -> None:
    """Import the installed package and run its program."""
    import nilbs

    if Path(nilbs.__file__).parents[1].name != "site-packages":
        sys.exit(f"{nilbs.__file__}: this is not the installed nilbs")
    for name in nilbs.__all__:
        getattr(nilbs, name)
    program = Path(sys.executable).with_name("nilbs")
    shown = subprocess.run([program, "--help"], check=True, capture_output=True, text=True).stdout
    if "train" not in shown:
        sys.exit(f"nilbs --help does not list the command train: {shown}")
    from nilbs.characters.capsule import capsule

    character = capsule(d=2)
    motion = nilbs.random_motion(character, frames=2)
    model = nilbs.fit(character, motion, steps=0)
    if (model.occupancy(character.V_volume[:1], motion.B[0]) < 0.5).all() or "torch" in sys.modules:
        sys.exit("a model without a network does not answer, or needs torch")


if __name__ == "__main__":
    check(Path(sys.argv[1]))
    use()
