"""Parts of the body at a posed point: starts for its canonical points, one from each part."""

import torch
from torch import Tensor

from nilbs.fields.forward import affine

# Edge of a posed cell in cells at rest: wide enough that a body stretched to twice its length leaves none empty.
CELL = 2.25
# In the same: nodes this far apart at rest are of different parts. Nearer ones, down to the second figure, may be of
# one that folds, and stay where there is room.
APART, NEAR = 4.0, 2.0
PARTS = 6  # the most parts of one cell
# The most cells along an edge of the grid around the posed body, however far a pose stretches it.
CELLS = 128


class Overlap:
    """Parts of the body in the cells of a grid around it, for one pose.

    Nodes of the rest grid are posed once and sorted into cells; of the nodes in a cell a few stay that lie apart at
    rest. Where the body neither overlaps nor folds itself all are near each other and one stays.

    Parameters
    ----------
    x_rest : (s, d) tensor
        Nodes in the body and just outside; of those that lie near each other the first stays.
    blends : (s, d (d+1)) tensor
        Their blended transforms.
    spacing : float
        Of the nodes.
    """

    def __init__(self, x_rest: Tensor, blends: Tensor, spacing: float) -> None:
        d = x_rest.shape[-1]
        x = affine(blends.reshape(-1, d, d + 1), x_rest)
        if not len(x):  # a body thinner than a cell has no node inside
            x, x_rest = (torch.full((1, d), value, dtype=x.dtype, device=x.device) for value in (0.0, torch.nan))
        self.origin = x.amin(dim=0)
        extent = x.amax(dim=0) - self.origin
        self.edge = max(CELL * spacing, float(extent.max()) / CELLS)
        self.shape = [int(size) + 1 for size in extent / self.edge]
        key = self._key(x)
        occupied, cell = torch.unique(key, return_inverse=True)
        self.cell = torch.full((int(torch.tensor(self.shape).prod()),), -1, dtype=torch.int64, device=x.device)
        self.cell[occupied] = torch.arange(len(occupied), device=x.device)
        parts = torch.full((len(occupied), PARTS, d), torch.nan, dtype=x.dtype, device=x.device)
        left = torch.arange(len(x), device=x.device)
        away = torch.full((len(x),), torch.inf, dtype=x.dtype, device=x.device)  # from all that stay in the cell
        for part in range(PARTS):
            # The first that is apart, or else the first that is not near.
            rank = left + torch.where(away[left] > APART * spacing, 0, len(x))
            first = torch.full((len(occupied),), 2 * len(x), device=x.device)
            first.scatter_reduce_(0, cell[left], rank, "amin")
            found = first < 2 * len(x)
            parts[found, part] = x_rest[first[found] % len(x)]
            away[left] = torch.minimum(away[left], (x_rest[left] - parts[cell[left], part]).norm(dim=-1))
            left = left[away[left] > NEAR * spacing]
        self.parts = parts

    def __call__(self, x: Tensor) -> Tensor:
        """Rest places (n, parts, d) near whose posed places the points (n, d) lie; nan where there is none."""
        last = torch.tensor(self.shape, dtype=x.dtype, device=x.device) * self.edge
        within = ((x >= self.origin) & (x < self.origin + last)).all(dim=-1)
        cell = torch.full((len(x),), -1, dtype=torch.int64, device=x.device)
        cell[within] = self.cell[self._key(x[within])]
        places = self.parts[cell.clamp_min(0)]
        return torch.where((cell >= 0)[:, None, None], places, torch.nan)

    def _key(self, x: Tensor) -> Tensor:
        index = ((x - self.origin) / self.edge).long()
        key = torch.zeros_like(index[:, 0])
        for axis, size in enumerate(self.shape):
            key = key * size + index[:, axis].clamp(0, size - 1)
        return key
