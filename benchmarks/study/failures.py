"""Where linear blend skinning and its learned inverse fail: pictures, with what was measured while drawing them."""

from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.patches import Patch

from benchmarks.study.twist import EDGES_AROUND, MAPS, turned, twist_model, twist_motion
from nilbs.figures.canvas import (
    BODY,
    FALSE_INSIDE,
    FALSE_OUTSIDE,
    INK,
    OUTSIDE,
    RIGHT_INSIDE,
    plain,
    sheet,
    write_png,
)
from nilbs.figures.surfaces import draw_body
from nilbs.figures.views import Section, View
from nilbs.geometry.diagnosis import enclosed_volume
from nilbs.geometry.grids import Grid
from nilbs.geometry.metrics import intersection_over_union
from nilbs.geometry.skeleton import skeleton_of_bones
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy, winding_number
from nilbs.methods.nilbs import Nilbs
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.models.model import Model

Failure = tuple[str, str, Path]

_NAMES = {"inverse": "inverse map", "reverse": "reverse map", "search": "root search"}

TWISTS = (90.0, 170.0)  # degrees
STRIPES = 4  # around the twisted body, painted at rest
DARK = "#8a5a2b"
# Degrees by which the gingerbread man's left arm is turned: until it presses into the body, and until it lies there.
ARM, TURNS, SWING_FRAMES = 4, (-85.0, -150.0), 31
ONCE, TWICE = "#9a9a9a", "#555555"
# Cells of the rest cache of the finned bar, as many as in space; its thinnest fins are half as thin as the finest.
FIN_CELLS = 512
# Of the finned bar, in lengths of the bar.
FINS = (0.00025, 0.0004, 0.0006, 0.001, 0.002, 0.004, 0.008, 0.012, 0.016, 0.024)
FIN_HEIGHT, BAR_HEIGHT, SLANT, BEND = 0.2, 0.08, 0.2, 40.0
FIN_POINTS = 4000
PIXELS, FIN_PIXELS = 320, 900  # along the edge of a picture of occupancy


def failure_figures(
    folder: str | Path,
    *,
    models: "Mapping[str, Model] | None" = None,
    seed: int = 0,
    minutes: float | None = None,
    steps: int | None = None,
    resolution: int = RESOLUTION,
    progress: bool = False,
    **changes: Any,
) -> list[Failure]:
    """Train on hard cases and draw them; returns (title, caption, path) of each figure, with this run's numbers.

    `models` are trained models at hand: "capsule", "gingerbread" (flat) and "fins"; the others are trained here,
    for so many `minutes` or `steps`, with the settings `changes`.
    """
    from nilbs.characters.capsule import capsule
    from nilbs.models.fitting import fit

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    models = models or {}
    budget = {name: value for name, value in (("steps", steps), ("minutes", minutes)) if value is not None}
    options = {**changes, **budget, "seed": seed, "progress": progress}
    twisted = models.get("capsule") or twist_model(capsule(resolution=EDGES_AROUND), **options)
    figures = [_candy_wrapper(twisted, folder / "candy-wrapper.png", resolution)]
    touching = models.get("gingerbread")
    if touching is None:
        man = gingerbread_man()
        touching = fit(man, turned(man, ARM, np.linspace(0, TURNS[-1], SWING_FRAMES)), **options)
    figures.append(_self_contact(touching, folder / "self-contact.png"))
    finned = models.get("fins")
    if finned is None:
        bar = finned_bar()
        finned = fit(
            bar, turned(bar, 1, np.linspace(-BEND, BEND, SWING_FRAMES)), **{"cache_resolution": FIN_CELLS, **options}
        )
    figures.append(_thin_parts(finned, folder / "thin-parts.png", resolution, np.random.default_rng(seed)))
    return figures


def gingerbread_man() -> "Character":
    """The flat gingerbread man with bounded biharmonic weights."""
    from nilbs.characters.character import assemble
    from nilbs.characters.gingerbread import gingerbread

    V, E, C, BE = gingerbread(2)
    return assemble(V, E, skeleton_of_bones(C, BE), name="gingerbread")


def finned_bar() -> "Character":
    """A flat bar of length 1 with slanted fins of the thicknesses `FINS`, and one joint in its middle.

    The fins are slanted so that each crosses the lines of a grid at all places of a cell. The weights are a smooth step
    along the bar.

    Returns
    -------
    character : Character
        Its fins are the vertices above y = 0.

    Examples
    --------
    >>> character = finned_bar()
    >>> character.d, character.L, len(character.skeleton.BE)
    (2, 1.0, 2)
    """
    from nilbs.characters.character import assemble

    columns = np.unique(np.concatenate([np.linspace(-0.5, 0.5, 41), *(_fin_base(k) for k in range(len(FINS)))]))
    rows = np.concatenate([np.linspace(-BAR_HEIGHT, 0, 4), np.linspace(0, FIN_HEIGHT, 9)[1:]])
    middle = (columns[:-1] + columns[1:]) / 2
    finned = np.any([(middle > low) & (middle < high) for low, high in map(_fin_base, range(len(FINS)))], axis=0)
    cell = np.argwhere(np.ones((len(columns) - 1, len(rows) - 1), dtype=bool))
    cell = cell[finned[cell[:, 0]] | (cell[:, 1] < 3)]
    corner = [(cell + offset) @ [len(rows), 1] for offset in ([0, 0], [1, 0], [1, 1], [0, 1])]
    E = np.concatenate([np.column_stack([corner[0], corner[k], corner[k + 1]]) for k in (1, 2)])
    V = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1).reshape(-1, 2)
    used, E = np.unique(E, return_inverse=True)
    V = V[used]
    V[:, 0] += SLANT * np.clip(V[:, 1], 0, None)
    C = np.array([[-0.45, -BAR_HEIGHT / 2], [0.0, -BAR_HEIGHT / 2], [0.45, -BAR_HEIGHT / 2]])
    skeleton = skeleton_of_bones(C, np.array([[0, 1], [1, 2]]))
    return assemble(V, E.reshape(-1, 3), skeleton, _bar_weights(V), name="finned bar")


def _fin_base(fin: int) -> tuple[float, float]:
    """Where a fin stands on the bar."""
    width = FINS[fin] * np.hypot(1, SLANT)
    middle = np.linspace(-0.42, 0.38, len(FINS))[fin]
    return float(middle - width / 2), float(middle + width / 2)


def _bar_weights(x_rest: np.ndarray) -> np.ndarray:
    s = np.clip(0.5 + x_rest[:, 0] / 0.3, 0, 1)
    right = s * s * (3 - 2 * s)
    return np.column_stack([1 - right, right])


def _candy_wrapper(model: "Model", path: Path, resolution: int) -> Failure:
    character = model.character
    figure, panels = sheet(2, 4, title="A limb twisted about its own axis", width=2.1, height=3.3, beside=0.1)
    rest = enclosed_volume(character.V, character.F)
    sentences = []
    for row, degrees in zip(panels, TWISTS, strict=True):
        found = _twisted(model, degrees, resolution)
        kept = {name: enclosed_volume(U, F) / rest for name, (U, F, _) in found.items()}
        for panel, (name, (U, F, x_rest)) in zip(row, found.items(), strict=True):
            _draw_striped(
                panel, character, U, F, x_rest, title=f"{_NAMES.get(name, name)}\nvolume {kept[name]:.3f} of rest"
            )
        row[0].set_ylabel(f"twisted by {degrees:g}°", fontsize=9)
        sentences.append(
            f"Twisted by {degrees:g}°, linear blend skinning keeps {kept['skinned mesh']:.1%} of the volume: the candy "
            f"wrapper. The inverse map (eq. 6) gives {kept['inverse']:.1%} and the root search {kept['search']:.1%}; "
            f"the reverse map, which blends the bones' inverses, gives {kept['reverse']:.1%}."
        )
    write_png(figure, path)
    caption = (
        f"Stripes painted along the body at rest show how it turns. {' '.join(sentences)} What skinning lost is no "
        "fault of an inverse, and none can repair it: a good one returns the thin waist. The reverse map moves posed "
        "points towards the axis once more, so that points outside land inside and the body swells where it "
        "should be thin; what would swell beyond the cube around the body is cut off and not counted."
    )
    return "The candy wrapper", caption, path


def _twisted(model: "Model", degrees: float, resolution: int) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The skinned mesh and what each map reconstructs of it: vertices, facets and the vertices' canonical points."""
    character = model.character
    pose = twist_motion(character, [degrees])[0]
    U = character.skin(pose)
    grid, found = Grid.cube(U, resolution), {"skinned mesh": (U, character.F, character.V)}
    for mapping in MAPS:
        posed = model.posed(pose, mapping=mapping)
        U, F = posed.extract_on(grid)
        found[mapping] = U, F, posed.rest_points(U)
    return found


def _draw_striped(
    panel: Any, character: "Character", U: np.ndarray, F: np.ndarray, x_rest: np.ndarray, *, title: str
) -> None:
    view = View.front(character.V).turned(azimuth=0, elevation=12)
    paint = ScalarMappable(cmap=LinearSegmentedColormap.from_list("stripes", [BODY, DARK]))
    paint.set_clim(0.3, 0.7)
    draw_body(panel, view, U, F, values=_stripes(x_rest, character), colours=paint)
    middle = view.project((character.V.min(axis=0) + character.V.max(axis=0)) / 2)
    half = np.array([0.34, 0.54]) * character.L
    plain(panel, title=title, lower=middle - half, upper=middle + half)


def _stripes(x_rest: np.ndarray, character: "Character") -> np.ndarray:
    """Between 0 and 1 by the angle around the y axis; the caps are plain."""
    middle = (character.V.min(axis=0) + character.V.max(axis=0)) / 2
    x = x_rest - middle
    return 0.5 + 0.5 * np.cos(STRIPES * np.arctan2(x[:, 0], x[:, 2]))


def _self_contact(model: "Model", path: Path) -> Failure:
    character = model.character
    figure, panels = sheet(2, 3, title="An arm that is turned into the body", width=3.1, height=3.1, beside=0.1)
    sentences = []
    for row, degrees in zip(panels, TURNS, strict=True):
        pose = turned(character, ARM, [degrees])[0]
        U = character.skin(pose)
        section = Section.through(View.front(character.V), U, scale=1.15, pixels=PIXELS)
        x = section.points()
        times = np.clip(np.abs(winding_number(U, character.F, x)).round(), 0, 2).astype(int)
        found = {mapping: model.occupancy(x, pose, mapping=mapping) > 0.5 for mapping in ("inverse", "search")}
        _draw_contact(row, section, times, found)
        row[0].set_ylabel(f"arm turned by {abs(degrees):g}°", fontsize=9)
        for panel in row:
            panel.add_collection(LineCollection(list(U[character.F]), colors=INK, linewidths=0.5))
        parts = "; ".join(_contact_words(_NAMES[mapping], times, inside) for mapping, inside in found.items())
        sentences.append(f"Arm turned by {abs(degrees):g}°: {parts}.")
    keys = [
        Patch(facecolor=ONCE, label="inside (covered once)"),
        Patch(facecolor=TWICE, label="covered twice"),
        Patch(facecolor=FALSE_INSIDE, label="wrongly inside"),
        Patch(facecolor=FALSE_OUTSIDE, label="wrongly outside"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    write_png(figure, path)
    caption = (
        "Skinning lets a body pass through itself. A place that is covered twice counts as inside, once: inside is "
        "where the winding number of the skinned outline is not zero. Where two parts overlap the truth does not "
        "separate them, and their contact has no surface. Such a place has two canonical points. The inverse map gives "
        "one blend of bones for each place and must pass from the arm's to the body's somewhere; the root search "
        f"starts in every part that lies there and takes one that is inside. {' '.join(sentences)}"
    )
    return "Self-contact", caption, path


def _draw_contact(row: Any, section: Section, times: np.ndarray, found: Mapping[str, np.ndarray]) -> None:
    """How often the pixels are covered (0, 1, 2), and the answers of maps there."""

    def draw(panel: Any, colours: np.ndarray, title: str) -> None:
        panel.imshow(section.image(colours), origin="lower", extent=section.extent, interpolation="nearest")
        plain(panel, title=title)

    true = times > 0
    share = np.mean(times[true] == 2)
    draw(
        row[0], np.array([to_rgb(OUTSIDE), to_rgb(ONCE), to_rgb(TWICE)])[times], f"truth: {share:.1%} is covered twice"
    )
    palette = np.array([[to_rgb(OUTSIDE), to_rgb(FALSE_INSIDE)], [to_rgb(FALSE_OUTSIDE), to_rgb(RIGHT_INSIDE)]])
    for panel, (mapping, inside) in zip(row[1:], found.items(), strict=True):
        score = intersection_over_union(inside, true)
        draw(panel, palette[true.astype(int), inside.astype(int)], f"{_NAMES[mapping]}: IoU of the pixels {score:.4f}")


def _contact_words(name: str, times: np.ndarray, inside: np.ndarray) -> str:
    """How much of what is covered once and twice a map finds, in words.

    Examples
    --------
    >>> _contact_words("map", np.array([0, 1, 1]), np.array([True, True, False]))
    'the map finds 50.0% of what is covered once, and its wrong pixels amount to 100.00% of the body'
    """
    twice = f" and {np.mean(inside[times == 2]):.1%} of what is covered twice" if (times == 2).any() else ""
    wrong = np.count_nonzero(inside != (times > 0)) / np.count_nonzero(times)
    return (
        f"the {name} finds {np.mean(inside[times == 1]):.1%} of what is covered once{twice}, and its wrong pixels "
        f"amount to {wrong:.2%} of the body"
    )


def _thin_parts(model: "Model", path: Path, resolution: int, rng: np.random.Generator) -> Failure:
    from nilbs.engine.rest_state import PARTS

    character = model.character
    pose = turned(character, 1, [-BEND])[0]
    U_true = character.skin(pose)
    assert isinstance(model.method, Nilbs)
    finest = (model.method.cache_resolution or 0) * prod(PARTS[character.d][1:])
    cache, grid = Grid.box(character.V, finest).spacing, Grid.cube(U_true, resolution)
    U, F = model.posed(pose).extract_on(grid)
    found, extracted = _found_of_fins(model, pose, U, F, rng)

    figure, panels = sheet(2, 2, title="Fins that are as thin as the grids' cells", width=4.6, height=3.0, beside=0.1)
    *shapes, chart = panels.ravel()
    _draw_fins(shapes, model, pose, U_true, U, F, resolution)
    L, thickness = character.L, np.array(FINS)
    for parts, cell, colour, style, name, whose in (
        (found, cache, "#0072b2", "o-", "field", "cache's finest"),
        (extracted, grid.spacing, "#d55e00", "s-", "extracted surface", "extraction's"),
    ):
        chart.semilogx(100 * thickness / L, 100 * parts, style, color=colour, markersize=3, label=name)
        edge = f"edge of the {whose} cell"
        chart.axvline(100 * cell / L, color=colour, linestyle=":", linewidth=1, label=edge)
    ticks = 100 * thickness[[0, 2, 4, 6, 8]] / L
    chart.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=7)
    chart.set_xticks([], minor=True)
    chart.tick_params(axis="y", labelsize=7)
    chart.set_ylim(-3, 103)
    chart.set_xlabel("thickness of a fin, % of L", fontsize=8)
    chart.set_title("part of each fin that is found, %", fontsize=9, color=INK)
    chart.legend(fontsize=7, frameon=False, loc="lower right")
    write_png(figure, path)

    def listed(edge: float, parts: np.ndarray) -> str:
        return ", ".join(f"{fin / edge:.2g} ({part:.0%})" for fin, part in zip(FINS, parts, strict=True))

    caption = (
        f"A bar with {len(FINS)} fins, bent by {BEND:g}°. The rest distance is on a grid with cells of "
        f"{cache / L:.3%} of L where it bends, and the surface is extracted on one with cells of "
        f"{grid.spacing / L:.2%}. How much of a fin the field finds, by its thickness in cells of the first grid: "
        f"{listed(cache, found)}. A fin that passes between the nodes leaves no negative distance at any, and for the "
        "field it does not exist there. "
        "How much of it the surface holds, by its thickness in cells of the second: "
        f"{listed(grid.spacing, extracted)}. Fins that are found but not extracted come back on a finer grid of the "
        "extraction; the others need a finer cache (the setting cache_resolution)."
    )
    return "Thin parts", caption, path


def _found_of_fins(
    model: "Model", pose: np.ndarray, U: np.ndarray, F: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Shares of each fin that the field finds, and that an extracted surface holds: by points inside the fin."""
    found, extracted = np.zeros(len(FINS)), np.zeros(len(FINS))
    for fin in range(len(FINS)):
        low, high = _fin_base(fin)
        y = rng.uniform(0, FIN_HEIGHT, FIN_POINTS)
        x_rest = np.column_stack([rng.uniform(low, high, FIN_POINTS) + SLANT * y, y])
        x = linear_blend_skinning(x_rest, _bar_weights(x_rest), pose)
        found[fin] = np.mean(model.occupancy(x, pose) > 0.5)
        extracted[fin] = np.mean(occupancy(U, F, x)) if len(F) else 0.0
    return found, extracted


def _draw_fins(
    panels: Sequence[Any],
    model: "Model",
    pose: np.ndarray,
    U_true: np.ndarray,
    U: np.ndarray,
    F: np.ndarray,
    resolution: int,
) -> None:
    """The skinned mesh, the field at the picture's pixels, and an extracted surface."""
    truth, field, surface = panels
    view = View.front(model.character.V)
    section = Section.through(view, U_true, scale=1.05, pixels=FIN_PIXELS)
    inside = model.occupancy(section.points(), pose) > 0.5
    colours = np.array([to_rgb(OUTSIDE), to_rgb(BODY)])[inside.astype(int)]
    draw_body(truth, view, U_true, model.character.F)
    field.imshow(section.image(colours), origin="lower", extent=section.extent, interpolation="antialiased")
    draw_body(surface, view, U, F)
    titles = (
        "skinned mesh",
        f"field at {section.pixels} × {section.pixels} pixels",
        f"surface extracted on {resolution} × {resolution} cells",
    )
    margin = 0.03 * section.edge
    lower, upper = view.project(U_true).min(axis=0) - margin, view.project(U_true).max(axis=0) + margin
    for panel, title in zip(panels, titles, strict=True):
        plain(panel, title=title, lower=lower, upper=upper)
