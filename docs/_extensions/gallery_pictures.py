"""Pictures of the gallery: the PNG files that an example prints the names of."""

import re
from pathlib import Path
from shutil import copyfile
from typing import Any

from sphinx_gallery.scrapers import figure_rst

OUT = Path(__file__).parents[2] / "out"


def written_pictures(block: tuple[Any, ...], block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Take the pictures that an example has written into out/, in the order of their names."""
    example = Path(block_vars["src_file"])
    if block_vars.get("example_globals", {}).get("main") is None:
        return ""
    number = re.match(r"\d+", example.name)
    paths = sorted(OUT.glob(f"{number.group()}_*.png")) if number else []
    copies = []
    for path in paths:
        copy = next(block_vars["image_path_iterator"])
        copyfile(path, copy)
        copies.append(copy)
    return str(figure_rst(copies, gallery_conf["src_dir"]))
