"""Values as colours, and the bar that explains them."""

from typing import NamedTuple

import numpy as np


class Scale(NamedTuple):
    """A colour map between two values; outside them its ends.

    Examples
    --------
    >>> Scale("gray", 0.0, 2.0)([0.0, 1.0, 9.0]).tolist()
    [[0, 0, 0], [128, 128, 128], [255, 255, 255]]
    """

    name: str
    low: float
    high: float
    unit: str = ""

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Colours (..., 3) of values (...), from 0 to 255; grey where they are not finite."""
        from matplotlib import colormaps

        share = (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)
        known = np.isfinite(share)
        colour = colormaps[self.name](np.where(known, share, 0.0), bytes=True)[..., :3]
        return np.where(known[..., None], colour, np.uint8(128))

    def bar(self) -> str:
        """The scale as a bar of HTML."""
        stops = self(np.linspace(self.low, self.high, 12))
        colours = ", ".join(f"rgb({r},{g},{b})" for r, g, b in stops.tolist())
        return (
            f'<div style="margin:0.4em 1em;font-size:0.75em"><div style="height:0.9em;border-radius:0.2em;'
            f'background:linear-gradient(to right, {colours})"></div><div style="display:flex;'
            f'justify-content:space-between"><span>{self.low:g}</span><span>{self.unit}</span>'
            f"<span>{self.high:g}</span></div></div>"
        )


def linear(colours: np.ndarray) -> np.ndarray:
    """Colours (n, 3) of a screen as glTF has them at vertices: shares of light, both from 0 to 255.

    Examples
    --------
    >>> linear(np.array([[0, 128, 255]])).tolist()
    [[0, 55, 255]]
    """
    share = np.asarray(colours) / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.round(255 * light).astype(np.uint8)


def rounded_up(value: float) -> float:
    """The next 1, 2 or 5 times a power of ten, at least a thousandth: the end of a scale.

    Examples
    --------
    >>> rounded_up(0.03), rounded_up(1.2), rounded_up(0.0)
    (0.05, 2.0, 0.001)
    """
    steps = [m * 10.0**k for k in range(-3, 3) for m in (1, 2, 5)]
    return next((round(step, 3) for step in steps if step >= value), 1000.0)


OCCUPANCY = Scale("viridis", 0.0, 1.0, "occupancy")
DISTANCE = Scale("RdBu", -0.1, 0.1, "distance, in L")
GHOST = Scale("magma", 0.0, 1.0, "weight of the ghost bone")
WEIGHT = Scale("viridis", 0.0, 1.0, "weight")
ERROR = Scale("YlOrRd", 0.0, 1.0, "distance to the skin, % of L")
DEPTH = Scale("plasma", 0.0, 3.0, "depth, % of L")
