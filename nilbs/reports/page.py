"""One page of HTML: facts, tables that are sorted by a click, pictures, and a scene to turn."""

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from nilbs.io.atomic import replacing

_TEMPLATES = Path(__file__).parent / "templates"


class Cell(NamedTuple):
    """A value in a table: a number, a text or None, with a note below it."""

    value: Any
    note: str = ""
    marked: bool = False


@dataclass(frozen=True)
class Table:
    """A table; `folded` hides it behind its title."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    text: str = ""
    folded: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture of a PNG file."""

    title: str
    path: Path
    text: str = ""


@dataclass(frozen=True)
class Scene:
    """Meshes to turn, a GLB file whose meshes are called `STATE|KIND`: one state is shown, and any of its kinds."""

    title: str
    glb: bytes
    text: str = ""


@dataclass(frozen=True)
class Page:
    """What a page shows, in this order."""

    title: str
    summary: str
    facts: Mapping[str, Any]
    tables: Sequence[Table]
    scene: Scene | None = None
    pictures: Sequence[Picture] = field(default_factory=tuple)
    more: Sequence[Table] = field(default_factory=tuple)

    def html(self) -> str:
        """The page as text; names are escaped, and everything is inside."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined

        templates = Environment(
            loader=FileSystemLoader(_TEMPLATES),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        templates.filters |= {"shown": shown, "base64": lambda data: base64.b64encode(data).decode()}
        return templates.get_template("page.html").render(page=self)

    def write(self, path: str | os.PathLike) -> None:
        """Write the page; the file appears whole or not at all."""
        with replacing(path, "w") as file:
            file.write(self.html())


def shown(value: Any) -> str:
    """A value as a person reads it.

    Examples
    --------
    >>> [shown(value) for value in (0.98765432, 12000, None, True, "nilbs")]
    ['0.9877', '12,000', '–', 'yes', 'nilbs']
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "–"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
