"""A command's results on standard output: one JSON object, or a table."""

import json
from collections.abc import Mapping
from typing import Any

from nilbs.io.strict_json import plain


def show(values: Mapping[str, Any], *, as_json: bool, table: str | None = None) -> None:
    """Print the results of a command, as one JSON object or as a table, by default with a row for each value.

    Examples
    --------
    >>> show({"seconds": 1.25, "energy": float("nan")}, as_json=True)
    {"seconds": 1.25, "energy": null}
    >>> show({"seconds": 1.25, "energy": 3.0}, as_json=False)
    seconds  1.25
    energy   3
    """
    if as_json:
        text = json.dumps(plain(values), allow_nan=False)
    else:
        text = rows(values) if table is None else table
    write_text(text)


def write_text(text: str) -> None:
    """Print a text on standard output; an error names it."""
    try:
        print(text, flush=True)
    except OSError as error:
        error.filename = "standard output"
        raise


def rows(values: Mapping[str, Any], indent: str = "") -> str:
    """Values as aligned lines: a list in one line, a mapping one level deeper.

    Examples
    --------
    >>> print(rows({"vertices": 6034, "watertight": True, "box": [0.0, 1.5]}))
    vertices    6034
    watertight  yes
    box         0, 1.5
    """
    width = max(map(len, values), default=0)
    lines = []
    for name, value in plain(values).items():
        if isinstance(value, dict):
            lines += [f"{indent}{name}", rows(value, indent + "  ")]
        else:
            lines.append(f"{indent}{name.replace('_', ' '):<{width}}  {_text(value)}")
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "-"
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
