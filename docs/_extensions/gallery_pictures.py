"""How the gallery runs the examples, and which pictures it shows."""

import builtins
import re
from pathlib import Path
from shutil import copyfile
from typing import Any

from sphinx_gallery.scrapers import figure_rst

from nilbs.geometry import progress

EXAMPLES = Path(__file__).parents[2] / "examples"
OUT = EXAMPLES.parent / "out"


def written_pictures(block: tuple[Any, ...], block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Take the pictures that an example has written into out/, in the order of their names."""
    example = Path(block_vars["src_file"])
    number = re.match(r"\d+", example.name)
    paths = sorted(OUT.glob(f"{number.group()}_*.png")) if number else []
    copies = [copyfile(path, next(block_vars["image_path_iterator"])) for path in paths]
    return "".join(figure_rst([copy], gallery_conf["src_dir"]) for copy in copies)


def prepare(gallery_conf: dict[str, Any], name: str | None) -> None:
    """Define `__file__` for an example, which the gallery runs without one, and switch progress bars off."""
    progress.SHOWN = False
    if name is not None:  # None is a folder
        builtins.__file__ = str(EXAMPLES / Path(name).name)  # type: ignore[attr-defined]
