"""Curves of the sweeps as PNG files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.study.results import Score, series
from benchmarks.study.scale import SWEEP_SETS
from nilbs.figures.canvas import sheet, write_png

# Okabe and Ito's colours, distinct for readers of any colour vision; the line's style separates the rest.
_LINES = {
    "nilbs": ("#0072b2", "-"),
    "search": ("#0072b2", "-"),
    "nilbs, no random poses": ("#56b4e9", "-"),
    "inverse": ("#0072b2", "--"),
    "nilbs, no random poses: inverse": ("#56b4e9", "--"),
    "reverse": ("#d55e00", "--"),
    "nasa": ("#d55e00", "-"),
    "snarf": ("#009e73", "-"),
    "mlp": ("#cc79a7", "-"),
    "lbs": ("#333333", ":"),
    "nearest": ("#888888", ":"),
}
_OTHERS = ("#000000", "#666666", "#999999")
_TITLES = {
    "frames": ("Accuracy against the number of training poses", "training poses", "log"),
    "amplitude": (
        "Accuracy against the amplitude of the pose",
        "standard deviation of the joint angles, rad",
        "linear",
    ),
    "time": ("Accuracy against training time", "training minutes", "log"),
    "noise": ("Surface IoU against the distance of its points", "surface noise, in units of 0.006 L", "linear"),
}


def sweep_curves(known: Sequence[Score], folder: Path) -> dict[str, Path]:
    """Draw surface IoU over each quantity that a sweep varies.

    Parameters
    ----------
    known : sequence of Score
    folder : path
        It must exist.

    Returns
    -------
    files : dict of str to path
        By part; parts without any score have none.
    """
    files = {}
    for part, (title, x_label, scale) in _TITLES.items():
        sets: tuple[str | None, ...] = (None,) if part == "amplitude" else SWEEP_SETS
        panels_of = {poses: series(known, part, poses, "iou_surface") for poses in sets}
        panels_of = {poses: lines for poses, lines in panels_of.items() if lines}
        if not panels_of:
            continue
        figure, panels = sheet(1, len(panels_of), title=title, width=3.6, height=3.0, beside=2.0)
        for panel, (poses, lines) in zip(panels[0], panels_of.items(), strict=True):
            for name, line in lines.items():
                panel.plot(list(line), list(line.values()), label=name, marker="o", markersize=3, **_style(name))
            panel.set_xscale(scale)
            xs = sorted({x for line in lines.values() for x in line})
            panel.set_xticks(xs, [f"{x:g}" for x in xs])
            panel.minorticks_off()
            _finish(panel, f"{poses} poses" if poses else "random poses", x_label, "surface IoU")
        _legend(figure, panels)
        files[part] = write_png(figure, folder / f"{part}.png")
    return files


def twist_curve(table: Sequence[Mapping[str, Any]], path: Path) -> Path | None:
    """Draw the volume of a twisted capsule over the angle.

    Parameters
    ----------
    table : sequence of mapping
        Of `benchmarks.study.twist.twist_table`.
    path : path

    Returns
    -------
    path : path
        None where there is nothing to draw.
    """
    if not table:
        return None
    figure, panels = sheet(1, 1, title="Volume of a twisted capsule", width=4.8, height=3.0, beside=1.4)
    for name in (name for name in table[0] if name != "degrees"):
        known = [(row["degrees"], row[name]) for row in table if isinstance(row.get(name), int | float)]
        if known:
            panels[0, 0].plot(*zip(*known, strict=True), label=name, marker="o", markersize=3, **_style(name))
    _finish(panels[0, 0], "", "twist, degrees", "volume ratio")
    _legend(figure, panels)
    return write_png(figure, path)


def _style(name: str) -> dict[str, Any]:
    """One style for a method in all curves; rows that learn nothing are grey."""
    if name in _LINES:
        colour, style = _LINES[name]
    else:
        colour, style = _OTHERS[sum(name.encode()) % len(_OTHERS)], "-."
    return {"color": colour, "linestyle": style, "linewidth": 1.4}


def _finish(panel: Any, title: str, x_label: str, y_label: str) -> None:
    panel.set_title(title, fontsize=9)
    panel.set_xlabel(x_label, fontsize=8)
    panel.set_ylabel(y_label, fontsize=8)
    panel.tick_params(labelsize=8)
    panel.grid(color="#e5e5e5", linewidth=0.6)


def _legend(figure: Any, panels: Any) -> None:
    """One legend for all panels, on the right."""
    found: dict[str, Any] = {}
    for panel in panels.ravel():
        handles, names = panel.get_legend_handles_labels()
        found.update(zip(names, handles, strict=True))
    figure.legend(list(found.values()), list(found), loc="outside right center", fontsize=8, frameon=False)
