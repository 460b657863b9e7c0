"""What a run measures: cells, each a quantity of so many points in a pose, on a mesh of so many triangles."""

from dataclasses import dataclass
from itertools import product

from nilbs.race.contestants import DISTANCE, OCCUPANCY

NEAR, UNIFORM = "near", "uniform"
# The largest mesh of a run, in triangles, and that of --large.
TRIANGLES, LARGE = 800_000, 3_200_000
# Of a cell of one pose, and of a stream of poses: in how many parts it is measured.
REPEATS, BLOCKS = 5, 10
# Points per pose of a stream.
STREAM = 1000


@dataclass(frozen=True)
class Cell:
    """What all contestants do in turn, several times.

    Attributes
    ----------
    quantity : str
        `OCCUPANCY` or `DISTANCE`.
    level : int
        How many times triangles are divided in four.
    points : int
        Queries of each pose.
    kind : str
        `NEAR` the surface, or `UNIFORM` in a cube around it.
    threads : int
    poses : int
        Of a stream: posed and queried one after the other in each repeat. Otherwise 1, the same in every repeat.
    repeats : int
    """

    quantity: str
    level: int
    points: int
    kind: str
    threads: int
    poses: int = 1
    repeats: int = REPEATS

    def cost(self, triangles: int) -> float:
        """A rough guess of its time, in no unit, from the triangles of the mesh; shares out the time left."""
        asked = (4 if self.quantity == DISTANCE else 2) * self.points
        return (self.repeats + 1) * self.poses * (1000 + asked + triangles * 4**self.level)


def levels(triangles: int, *, most: int) -> list[int]:
    """Levels of a mesh whose triangles are not more than `most`; always level 0.

    Examples
    --------
    >>> levels(12_000, most=800_000)
    [0, 1, 2, 3]
    """
    found = [0]
    while triangles * 4 ** (found[-1] + 1) <= most:
        found.append(found[-1] + 1)
    return found


def quick(chosen: list[int], *, threads: int) -> list[Cell]:
    """The coarsest and the finest mesh at 100,000 points, and a stream of 1,000 poses on the coarsest."""
    ends = list(dict.fromkeys([chosen[0], chosen[-1]]))
    cells = [Cell(OCCUPANCY, level, 10**5, kind, threads) for kind, level in product((NEAR, UNIFORM), ends)]
    stream = Cell(OCCUPANCY, chosen[0], STREAM, NEAR, threads, poses=1000 // BLOCKS, repeats=BLOCKS)
    return _by_child([*cells, stream, *(Cell(DISTANCE, level, 10**5, NEAR, threads) for level in ends)])


def whole(chosen: list[int], *, threads: int, full: bool = False) -> list[Cell]:
    """All sizes, the most important ones first; the finest of four meshes or more at two sizes, unless `full`."""
    counts, both = [10**k for k in range(2, 8)], list(dict.fromkeys([threads, 1]))
    cells = []
    for large, used, level, quantity, kind, points in product(
        (False, True), both, chosen, (OCCUPANCY, DISTANCE), (NEAR, UNIFORM), counts
    ):
        finest = len(chosen) > 3 and level == chosen[-1] and not full
        if (points > 10**5) == large and not (finest and (used != threads or points not in (10**3, 10**5))):
            cells.append(Cell(quantity, level, points, kind, used))
    for level, quantity in product(chosen, (OCCUPANCY, DISTANCE)):
        # A stream of 1,000 poses on the coarsest mesh, and of 100 on others.
        poses = 100 if level == chosen[0] else 10
        cells.append(Cell(quantity, level, STREAM, NEAR, threads, poses=poses, repeats=BLOCKS))
    return _by_child(cells)


def _by_child(cells: list[Cell]) -> list[Cell]:
    """The cells in an order in which those of a mesh and a number of threads follow each other; large ones last."""
    place = {key: i for i, key in enumerate(dict.fromkeys(map(_child, cells)))}
    return sorted(cells, key=lambda cell: place[_child(cell)])


def _child(cell: Cell) -> tuple[bool, int, int]:
    return cell.points > 10**5, -cell.threads, cell.level
