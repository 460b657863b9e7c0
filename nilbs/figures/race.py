"""Times of the benchmark over the number of points, with the places where two curves cross."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from nilbs.figures.canvas import sheet, write_png

# Okabe and Ito's palette, as far as it is legible on white; nilbs is the first contestant.
_COLOURS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#999999")
_MARKS = "os^Dv<>P"


def race_figures(values: Mapping[str, Any], folder: str | Path) -> list[Path]:
    """Draw the results of `nilbs benchmark`, a file for each quantity and number of threads with two sizes or more.

    Parameters
    ----------
    values : mapping
        What its JSON file holds.
    folder : path
        Where files `occupancy-2-threads.png` and so on are written.

    Returns
    -------
    paths : list of Path
    """
    rows = [row for row in values["rows"] if row["status"] == "measured" and row["poses"] == 1]
    names = list(dict.fromkeys(row["contestant"] for row in rows))
    paths = []
    for quantity, threads in dict.fromkeys((row["quantity"], row["threads"]) for row in rows):
        chosen = [row for row in rows if (row["quantity"], row["threads"]) == (quantity, threads)]
        if len({row["points"] for row in chosen}) < 2:
            continue
        kinds = list(dict.fromkeys(row["kind"] for row in chosen))
        meshes = sorted({row["triangles"] for row in chosen})
        title = f"{values['model']['name']}: {quantity}, time of a pose, {threads} thread{'s' if threads > 1 else ''}"
        figure, panels = sheet(len(kinds), len(meshes), title=title, width=3.6, height=3.2, beside=1.6)
        for i, kind in enumerate(kinds):
            for j, triangles in enumerate(meshes):
                there = [row for row in chosen if (row["kind"], row["triangles"]) == (kind, triangles)]
                _panel(panels[i, j], there, names)
                _crossings(panels[i, j], values["crossovers"], there)
                panels[i, j].set_title(f"{kind}, {triangles:,} triangles", fontsize=9)
        handles, labels = [], []
        for panel in panels.flat:
            for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
                if label not in labels:
                    handles.append(handle)
                    labels.append(label)
        figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
        paths.append(write_png(figure, Path(folder) / f"{quantity}-{threads}-thread{'s' if threads > 1 else ''}.png"))
    return paths


def _panel(panel: Axes, rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        curve = sorted((row["points"], 1000 * row["total_s"]) for row in rows if row["contestant"] == name)
        if curve:
            x, y = zip(*curve, strict=True)
            colour, mark = _COLOURS[k % len(_COLOURS)], _MARKS[k % len(_MARKS)]
            width = 2.0 if k == 0 else 1.1
            panel.plot(x, y, label=name, color=colour, marker=mark, markersize=3.5, linewidth=width)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel("points of a pose", fontsize=8)
    panel.set_ylabel("milliseconds", fontsize=8)
    panel.tick_params(labelsize=7)
    panel.grid(color="#e5e5e5", linewidth=0.6)


def _crossings(panel: Axes, found: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]) -> None:
    """A dotted line where nilbs and another contestant change places."""
    if not rows:
        return
    for crossing in found:
        if all(crossing[name] == rows[0][name] for name in ("quantity", "triangles", "kind", "threads")):
            for points, _ in crossing["faster"][1:]:
                panel.axvline(points, color="#777777", linewidth=0.8, linestyle=":")
                place = (points, 0.02)
                panel.annotate(
                    crossing["contestant"], place, xycoords=panel.get_xaxis_transform(), fontsize=6, rotation=90,
                    ha="right", va="bottom", color="#555555",
                )  # fmt: skip
