"""The study as a page: in Markdown, and as one HTML file with its pictures inside."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from benchmarks.study.tables import Cell, Table

HEADINGS = {
    "overview": "All methods",
    "methods": "Accuracy by pose set",
    "distance": "Distances",
    "frames": "Number of training poses",
    "amplitude": "Amplitude of the pose",
    "time": "Training time",
    "ablation": "Ablations",
    "noise": "Distance from the surface",
    "twist": "Volume under twist",
    "controls": "Controls",
}
PROTOCOL = (
    "Truth is the mesh skinned by ordinary linear blend skinning (LBS): a point is inside where the absolute winding "
    "number of the posed mesh exceeds one half. Lengths are in % of L, the longest edge of the rest mesh's box.",
    "For each frame there are as many points uniform in a cube around the posed mesh (bbox IoU) as near its surface, "
    "moved by Gaussian noise of 0.006 L (surface IoU). Scores are means over the poses of a set.",
    "Chamfer distance is exact from samples of one surface to the other surface, both ways, on a surface that was "
    "extracted on the grid named below; where a body overlaps itself, the skin inside it is part of the true mesh and "
    "of no reconstruction, which the row floor shows.",
    "Surfaces are extracted in blocks of four cells: by a method with distances where a distance shows that the "
    "surface may be near, by the others (NASA, SNARF, the MLP) in blocks whose corners lie on both sides and beside.",
    "Weight lookups count evaluations of skinning weights for a query by a root search or an iteration, on a grid or "
    "by a network, with that of the network where it starts; the inverse and the reverse map evaluate the network "
    "once. The work of nilbs for a pose before its first point (blends at the grid's nodes, posed parts) is "
    "no lookup, but counts in the seconds.",
    "Seconds are of 100,000 points of a pose on one thread while another job ran, with their share of the time to set "
    "the pose: half if both sets of points are queried; mean over all poses that the row is scored on.",
    "Pose sets, ten poses each: seen, training frames; interpolated, the middles between neighbouring training "
    "frames; unseen and far, random poses whose joints turn by angles of 0.28 and 0.8 rad standard deviation. Motion "
    "that is random, of the gingerbread men and the arm, turns joints by 0.4 rad (root mean square), so that unseen "
    "poses are new, but milder than seen ones.",
    "The seed is that of the training, of random training motion, and of all that the scores draw; all methods with "
    "one seed are trained on the same frames and scored on the same poses and points. So rows are compared seed by "
    "seed; a row of one seed stands beside means of several, whose poses are others.",
    "The steps of all trainings of a character in one table take about the same minutes, but for the table of training "
    "times: a trial measures how many they are, and beside other work it is a tenth or two off. The trial, labelling "
    "points and the grids of nilbs and paper come on top; all of it is the column of training seconds. All trainings "
    "are far shorter than those of the baselines' papers. Where the steps are a few dozen (SNARF with 163 bones) a "
    "network has hardly begun to learn, and its score means no more than that.",
    "Given besides the labelled points of the training frames: to nilbs the rest mesh's distance, and the "
    "weights in its volume, posed in the training frames and in random poses too, whose angles have a standard "
    "deviation of up to 0.8 rad, as those of the scores may (the ablations have one without); to paper the rest mesh's "
    "distance and the weights of its vertices at rest; to NASA the weights of vertices; to SNARF the skeleton; to "
    "nearest and rigid-parts the rest mesh and its weights; to the MLP nothing.",
    "The row parts, which searches on the same grids without a network, shows how much nilbs gains by its network; so "
    "do one-search and inverse, which depend on it. The given weights and the rest distance are on the grids.",
    "How methods are trained: matrices of every network by Muon, all else by Adam, at one rate for all, which rises "
    "and falls once; occupancy by cross-entropy (paper: absolute difference); half of the labelled points at the "
    "surface, a quarter around it, a quarter uniform (paper: all uniform). Only nilbs draws half of its labelled "
    "points where it errs (the ablations have one without). The width of the step by which paper reads occupancy from "
    "distance is ours, 0.3 % of L; the ablations have a wider one.",
    "SNARF's networks are smaller than its authors', and so are NASA's where bones are few; SNARF's searches take at "
    "most ten steps, in training and in scores. All other differences of baselines from their papers are listed where "
    "they are defined, in nilbs/methods.",
    "Spread is half the range over the seeds, (max - min) / 2. A gain smaller than the spread is no gain.",
)


@dataclass(frozen=True)
class Picture:
    """A picture with its title and a description."""

    title: str
    caption: str
    path: Path


@dataclass(frozen=True)
class Page:
    """The content of a report.

    Attributes
    ----------
    title : str
    facts : mapping of str to str
        Machine, time, command and the like, in the order of the report.
    tables : sequence of Table
    pictures : mapping of str to sequence of Picture
        By the part that they stand in; "failures" have a section of their own.
    missing : sequence of str
        A sentence on everything that was left out, failed or has not been run.
    notes : sequence of str
        Notes that come first.
    """

    title: str
    facts: Mapping[str, str]
    tables: Sequence[Table]
    pictures: Mapping[str, Sequence[Picture]] = field(default_factory=dict)
    missing: Sequence[str] = ()
    notes: Sequence[str] = ()


def markdown(page: Page) -> str:
    """The page without its pictures.

    Examples
    --------
    >>> print(markdown(Page("Study", {"cores": "2"}, ())).splitlines()[0])
    # Study
    """
    lines = [f"# {_plain(page.title)}", "", *(f"**{_plain(note)}**\n" for note in page.notes)]
    lines += ["## What was measured", "", *(f"- {_plain(line)}" for line in PROTOCOL), ""]
    lines += [
        "| | |",
        "|---|---|",
        *(f"| {_plain(name)} | {_plain(value)} |" for name, value in page.facts.items()),
        "",
    ]
    for part, tables in _by_part(page).items():
        lines += [f"## {HEADINGS[part]}", ""]
        for table in tables:
            note = [_plain(table.note), ""] if table.note else []
            lines += [f"### {_plain(table.title)}", "", *note, *_markdown_table(table), ""]
    if page.missing:
        lines += ["## What is missing", "", *(f"- {_plain(line)}" for line in page.missing), ""]
    return "\n".join(lines)


def html(page: Page) -> str:
    """The page as one file that needs no other: styles and pictures are in it.

    Returns
    -------
    text : str
        HTML that is well-formed XML too.
    """
    body = [f"<h1>{escape(page.title)}</h1>", *(f'<p class="note">{escape(note)}</p>' for note in page.notes)]
    body += ["<h2>What was measured</h2>", "<ul>", *(f"<li>{escape(line)}</li>" for line in PROTOCOL), "</ul>"]
    facts = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in page.facts.items())
    body += ['<table class="facts">', "<tbody>", *facts, "</tbody>", "</table>"]
    by_part = _by_part(page)
    for part, heading in HEADINGS.items():
        tables, pictures = by_part.get(part, []), page.pictures.get(part, ())
        if not tables and not pictures:
            continue
        body.append(f'<h2 id="{part}">{escape(heading)}</h2>')
        body += [line for picture in pictures if part != "methods" for line in _figure(picture)]
        body += [line for table in tables for line in _html_table(table)]
        body += [line for picture in pictures if part == "methods" for line in _figure(picture)]
    if page.pictures.get("failures"):
        body.append('<h2 id="failures">Where it fails</h2>')
        body += [line for picture in page.pictures["failures"] for line in _figure(picture)]
    if page.missing:
        body += ["<h2>What is missing</h2>", "<ul>", *(f"<li>{escape(line)}</li>" for line in page.missing), "</ul>"]
    head = f'<head><meta charset="utf-8"/><title>{escape(page.title)}</title><style>{_STYLE}</style></head>'
    lines = ["<!DOCTYPE html>", '<html lang="en">', head, "<body>", *body, "</body>", "</html>", ""]
    # What no text may hold, XML least of all: control characters, from an error's message for example.
    return "".join(letter for letter in "\n".join(lines) if letter >= " " or letter in "\n\t")


def _by_part(page: Page) -> dict[str, list[Table]]:
    return {part: tables for part in HEADINGS if (tables := [table for table in page.tables if table.part == part])}


def _markdown_table(table: Table) -> list[str]:
    lines = [f"| {' | '.join(map(_plain, table.columns))} |", f"|{'---|' * len(table.columns)}"]
    for name, cells in table.rows:
        shown = (f"**{cell.text}**" if cell.best else cell.text for cell in cells)
        lines.append(f"| {' | '.join([_plain(name), *shown])} |")
    return lines


def _plain(text: str) -> str:
    """Text on one line, without what ends a cell or begins a tag."""
    return " ".join(text.split()).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")


def _html_table(table: Table) -> list[str]:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    rows = [f"<tr><th>{escape(name)}</th>{''.join(map(_html_cell, cells))}</tr>" for name, cells in table.rows]
    words = ' class="words"' if table.words else ""
    return [
        f"<h3>{escape(table.title)}</h3>",
        f'<div class="wide"><table{words}>',
        f"<thead><tr>{head}</tr></thead>",
        "<tbody>",
        *rows,
        "</tbody>",
        "</table></div>",
        *([f'<p class="caption">{escape(table.note)}</p>'] if table.note else []),
    ]


def _html_cell(cell: Cell) -> str:
    mean, plus_minus, spread = cell.text.partition(" ± ")
    text = f"<strong>{escape(mean)}</strong>" if cell.best else escape(mean)
    return f"<td>{text} <small>± {escape(spread)}</small></td>" if plus_minus else f"<td>{text}</td>"


def _figure(picture: Picture) -> list[str]:
    try:
        data = base64.b64encode(picture.path.read_bytes()).decode()
    except OSError:
        return [f'<p class="caption">{escape(picture.title)}: the picture is missing.</p>']
    title = escape(picture.title, quote=True)
    return [
        f'<figure><img alt="{title}" src="data:image/png;base64,{data}"/>',
        f"<figcaption><strong>{title}.</strong> {escape(picture.caption)}</figcaption></figure>",
    ]


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 76em; margin: 2em auto; padding: 0 1.5em; }
h1, h2, h3 { font-weight: 600; line-height: 1.25; }
h2 { margin-top: 2.2em; border-bottom: 1px solid #ccc; padding-bottom: .2em; }
h3 { margin: 1.6em 0 .5em; font-size: 1.05em; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
td, th { padding: .25em .7em; text-align: right; vertical-align: top; }
thead th { vertical-align: bottom; }
th:first-child, .facts td { text-align: left; }
tbody th, thead th { font-weight: normal; color: #444; }
tbody th { white-space: nowrap; }
.words td, .words th { text-align: left; }
td small { display: block; color: #555; white-space: nowrap; }
thead th { border-bottom: 1px solid #888; }
tbody tr:nth-child(even) { background: #f6f6f4; }
.wide { overflow-x: auto; }
.caption, figcaption { color: #555; font-size: 13px; }
.note { border-left: 4px solid #d55e00; padding: .3em 1em; background: #fbf3ec; }
figure { margin: 1.2em 0; }
img { max-width: 100%; }
"""
