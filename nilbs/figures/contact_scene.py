"""The posed meshes of a motion's worst frames side by side, with the depth of contacts as colours."""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from nilbs.characters.motion import Motion
from nilbs.contacts.pairs import contacts, skin_places
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.contacts.timeline import FrameContact, Timeline
from nilbs.geometry.plane import in_space
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io.coloured_meshes import ColouredMesh, write_coloured_meshes
from nilbs.models.model import Model

# Frames of each timeline; and what is nearer to a contact than its depth and so much of L has its colour.
WORST, BESIDE = 3, 0.005
# Red, green and blue from no contact to the deepest.
COLOURS = np.array([[205, 205, 210], [255, 200, 60], [230, 60, 20], [120, 0, 40]])


def colours_of_depth(depth: np.ndarray, deepest: float) -> np.ndarray:
    """Colours (n, 3) of depths (n,): grey without contact, then from yellow to dark red.

    Examples
    --------
    >>> colours_of_depth(np.array([0.0, 2.0]), 2.0).tolist()
    [[205, 205, 210], [120, 0, 40]]
    """
    share = np.clip(depth / max(deepest, 1e-300), 0.0, 1.0) * (len(COLOURS) - 1)
    channels = [np.interp(share, np.arange(len(COLOURS)), COLOURS[:, k]) for k in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


def depth_beside(U: np.ndarray, point: np.ndarray, depth: np.ndarray, beside: float) -> np.ndarray:
    """Depth (n,) of the deepest contact (k,) that vertices (n, d) are beside; zero where there is none.

    Examples
    --------
    >>> depth_beside(np.array([[0.0, 0], [1, 0]]), np.array([[0.1, 0]]), np.array([0.08]), 0.05).tolist()
    [0.08, 0.0]
    """
    found = np.zeros(len(U))
    if len(point):
        beside_of = cKDTree(U).query_ball_point(point, depth + beside)
        vertex = np.concatenate([np.asarray(v, dtype=np.int64) for v in beside_of])
        np.maximum.at(found, vertex, np.repeat(depth, [len(v) for v in beside_of]))
    return found


def write_contact_scene(
    path: str | Path,
    finder: SelfContactFinder,
    motion: Motion,
    timelines: list[Timeline],
    others: list[Model],
    *,
    samples: int,
) -> None:
    """Write the worst frames of timelines, the first of the body with itself and one with each other, as .glb.

    Each frame is a node of its own, or two: of the body, and of the other one. Without a contact the first frame is
    written.
    """
    model, meshes, shift = finder.model, [], 0.0
    deepest = max((f.depth for t in timelines for f in t.frames), default=0.0)
    chosen = [(t, f) for t in timelines for f in t.worst[:WORST]] or [(timelines[0], timelines[0].frames[0])]
    for timeline, frame in chosen:
        pose = motion[timeline.frames.index(frame)]
        if timeline is timelines[0]:
            found = finder(pose)
            bodies, point, depth = [(model, pose)], found.point, found.depth
        else:
            other = others[timelines.index(timeline) - 1]
            bodies = [(model, pose), (other, other.motion.at(seconds=frame.seconds))]
            skins = [skin_places(m.character.V, m.character.F, samples=samples) for m, _ in bodies]
            both = contacts(model, pose, other, bodies[1][1], skins=(skins[0], skins[1]))
            point, depth = both.point, both.depth
        group = [_mesh(m, B, point, depth, deepest) for m, B in bodies]
        corners = np.concatenate([in_space(V) for V, _, _ in group])
        low, wide = corners[:, 0].min(), np.ptp(corners[:, 0])
        offset = np.array([shift - low if len(chosen) > 1 else 0.0, 0.0, 0.0])
        for (V, E, colour), which in zip(group, ("", " (the other)"), strict=False):
            meshes.append(ColouredMesh(f"{_name(timeline, frame)}{which}", V, E, colour, offset))
        shift += wide + 0.1 * model.character.L
    write_coloured_meshes(path, meshes)


def _name(timeline: Timeline, frame: FrameContact) -> str:
    return f"frame {frame.frame} with {timeline.name}"


def _mesh(
    model: Model, B: np.ndarray, point: np.ndarray, depth: np.ndarray, deepest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Posed vertices, triangles and colours."""
    c = model.character
    V, E, W = (c.V_volume, c.T, c.W_volume) if c.d == 2 else (c.V, c.F, c.W)
    U = linear_blend_skinning(V, W, B)
    return U, E, colours_of_depth(depth_beside(U, point, depth, BESIDE * c.L), deepest)
