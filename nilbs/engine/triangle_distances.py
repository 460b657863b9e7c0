"""Distances of points from triangles and boxes, several at a time in registers."""

from typing import Any

import numpy as np

from nilbs.engine.compiled import PROBLEM, inlined

if PROBLEM is None:
    from nilbs.engine.lanes import both, choose, larger, load, smaller, spread

# Several numbers in one register; nilbs.engine.lanes has the type.
Lanes = Any


@inlined
def box_distances(
    boxes: np.ndarray, i: int, low_x: Lanes, low_y: Lanes, low_z: Lanes, high_x: Lanes, high_y: Lanes, high_z: Lanes
) -> Lanes:
    """Squared distances of a box from those of eight children."""
    zero = spread(np.float32(0))
    a = larger(larger(load(boxes, i, 0) - high_x, low_x - load(boxes, i, 3)), zero)
    b = larger(larger(load(boxes, i, 1) - high_y, low_y - load(boxes, i, 4)), zero)
    c = larger(larger(load(boxes, i, 2) - high_z, low_z - load(boxes, i, 5)), zero)
    return a * a + b * b + c * c


@inlined
def distances_of_box(boxes: np.ndarray, child: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distances of eight points from the box of a child."""
    i, k, zero = child >> 3, child & 7, spread(np.float32(0))
    a = larger(larger(spread(boxes[i, 0, k]) - x, x - spread(boxes[i, 3, k])), zero)
    b = larger(larger(spread(boxes[i, 1, k]) - y, y - spread(boxes[i, 4, k])), zero)
    c = larger(larger(spread(boxes[i, 2, k]) - z, z - spread(boxes[i, 5, k])), zero)
    return a * a + b * b + c * c


@inlined
def squares_of_eight(t: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distances of a point from eight triangles.

    Inside a triangle it is the distance from its plane, outside that from an edge: near the border, where rounding
    decides, the two differ by no more than rounding.
    """
    qx, qy, qz = x - load(t, i, 0), y - load(t, i, 1), z - load(t, i, 2)
    ex, ey, ez = load(t, i, 3), load(t, i, 4), load(t, i, 5)
    fx, fy, fz = load(t, i, 6), load(t, i, 7), load(t, i, 8)
    v = _dot(qx, qy, qz, load(t, i, 9), load(t, i, 10), load(t, i, 11))
    w = _dot(qx, qy, qz, load(t, i, 12), load(t, i, 13), load(t, i, 14))
    off = _dot(qx, qy, qz, load(t, i, 15), load(t, i, 16), load(t, i, 17))
    zero, one = spread(np.float32(0)), spread(np.float32(1))
    inside = both(both(zero <= v, zero <= w), v + w <= one)
    squared = _square_of_edge(qx, qy, qz, ex, ey, ez, load(t, i, 18))
    squared = smaller(_square_of_edge(qx, qy, qz, fx, fy, fz, load(t, i, 19)), squared)
    squared = smaller(_square_of_edge(qx - ex, qy - ey, qz - ez, fx - ex, fy - ey, fz - ez, load(t, i, 20)), squared)
    return choose(inside, off * off, squared)


@inlined
def _square_of_edge(qx: Lanes, qy: Lanes, qz: Lanes, ex: Lanes, ey: Lanes, ez: Lanes, inverse: Lanes) -> Lanes:
    """Squared distance of q from the places t e, 0 <= t <= 1."""
    t = _dot(qx, qy, qz, ex, ey, ez) * inverse
    t = smaller(larger(t, spread(np.float32(0))), spread(np.float32(1)))
    rx, ry, rz = qx - t * ex, qy - t * ey, qz - t * ez
    return _dot(rx, ry, rz, rx, ry, rz)


@inlined
def closest_of_four(triangles: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Closest place a + v (b - a) + w (c - a) of each of four triangles abc: v, w and the squared distance.

    Every place that is compared lies on its triangle, so that a triangle without area is no special case: where the
    division by its normal's square means nothing, one of its edges is closest.
    """
    ax, ay, az = load(triangles, i, 0), load(triangles, i, 1), load(triangles, i, 2)
    ex, ey, ez = load(triangles, i, 3) - ax, load(triangles, i, 4) - ay, load(triangles, i, 5) - az
    fx, fy, fz = load(triangles, i, 6) - ax, load(triangles, i, 7) - ay, load(triangles, i, 8) - az
    qx, qy, qz = x - ax, y - ay, z - az
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    zero, one = spread(0.0), spread(1.0)
    inverse = one / _dot(nx, ny, nz, nx, ny, nz)
    v = inverse * _dot(qx, qy, qz, fy * nz - fz * ny, fz * nx - fx * nz, fx * ny - fy * nx)
    w = inverse * _dot(qx, qy, qz, ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex)
    rx, ry, rz = qx - v * ex - w * fx, qy - v * ey - w * fy, qz - v * ez - w * fz
    squared = _dot(rx, ry, rz, rx, ry, rz)
    t, other = _closest_of_edge(qx, qy, qz, ex, ey, ez)
    keep = both(both(both(zero <= v, zero <= w), v + w <= one), squared <= other)
    v, w, squared = choose(keep, v, t), choose(keep, w, zero), choose(keep, squared, other)
    t, other = _closest_of_edge(qx, qy, qz, fx, fy, fz)
    keep = squared <= other
    v, w, squared = choose(keep, v, zero), choose(keep, w, t), choose(keep, squared, other)
    t, other = _closest_of_edge(qx - ex, qy - ey, qz - ez, fx - ex, fy - ey, fz - ez)
    keep = squared <= other
    return choose(keep, v, one - t), choose(keep, w, t), choose(keep, squared, other)


@inlined
def _closest_of_edge(qx: Lanes, qy: Lanes, qz: Lanes, ex: Lanes, ey: Lanes, ez: Lanes) -> tuple[Lanes, Lanes]:
    """Closest place t e, 0 <= t <= 1, to q, and the squared distance."""
    t = _dot(qx, qy, qz, ex, ey, ez) / _dot(ex, ey, ez, ex, ey, ez)
    t = smaller(larger(t, spread(0.0)), spread(1.0))
    rx, ry, rz = qx - t * ex, qy - t * ey, qz - t * ez
    return t, _dot(rx, ry, rz, rx, ry, rz)


@inlined
def _dot(ax: Lanes, ay: Lanes, az: Lanes, bx: Lanes, by: Lanes, bz: Lanes) -> Lanes:
    return ax * bx + ay * by + az * bz
