"""The root search on a GPU: tables that are uploaded once, what a pose adds to them, and queries.

It answers as `nilbs.engine.search` does, from the same starts; roots are the same but for rounding. Closest points of
the posed skin, and so distances where there is no canonical point, stay with the processor.
"""

import threading
from collections.abc import Iterable
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from nilbs.engine.answer import Answer
from nilbs.engine.lattice import Images
from nilbs.engine.search import SearchEngine
from nilbs.engine.weights import transforms
from nilbs.fields.gpu_kernel import Blends, Bricks, Voxels, search_kernel
from nilbs.geometry.weight_blocks import ONE

# Voxels along the longest edge of a posed body: more hold fewer cells each, and take more of the cache. At most 8 MiB.
VOXELS = 96
# Points of a program: one warp. The interpreter, which runs on a processor, takes many at a time.
LANES, INTERPRETED = 32, 4096
# Of one table: the kernel counts in 32 bits.
MOST_NUMBERS = 2**31
# Instead of an infinite reach, which must not be multiplied by zero.
UNBOUNDED = 3e38


class GpuSearch:
    """What a search reads in every pose, on a device.

    Parameters
    ----------
    engine : SearchEngine
    device : str
        A GPU; or "cpu", where Triton interprets its code (TRITON_INTERPRET=1), for tests.

    Raises
    ------
    ValueError
        If a table is too large.
    """

    has_distance: ClassVar[bool] = True
    has_canonical_points: ClassVar[bool] = True
    near_skin: ClassVar[bool] = True

    def __init__(self, engine: SearchEngine, device: str) -> None:
        self.engine, self.device = engine, torch.device(device)
        w, t = engine.weights, engine.distances
        nodes, bones = int(np.prod(np.array(w.cells) + 1)), np.diff(w.first)
        if max(12 * nodes * len(bones), nodes * w.first[-1], len(t.values)) >= MOST_NUMBERS:
            raise ValueError("the model's grids are too large for the search on a GPU: query it on the processor")
        # Entries of a node follow each other, and nodes of a block have the same bones.
        count = np.repeat(bones, nodes)
        block_first = np.repeat(w.first[:-1], nodes * bones)
        place = (np.arange(len(block_first)) - nodes * block_first) % np.repeat(count, count)
        self._bone = self._upload(w.bone[block_first + place])
        self._weight = self._upload(w.weight[: len(place)].astype(np.float32) / np.float32(ONE))
        self._first = self._upload(np.cumsum(count) - count, np.int32)
        self._block = self._upload(np.concatenate([w.block[..., None], w.place[w.block]], axis=-1), np.int32)
        divisions = np.column_stack([t.parts, t.first_value, t.first_brick])
        self._bricks = Bricks(
            self._frame(t.origin, 1 / float(t.spacing), t.brick.shape),
            self._upload(np.append(len(divisions), divisions), np.int32),
            *(self._upload(array) for array in (t.brick, t.divided.view(np.int64), t.below, t.values, t.unit)),
        )
        self._rest_cells = self._upload(np.stack([engine.lattice.center, engine.lattice.edge], axis=1))
        # Queries may come from several threads; a GPU takes one after the other anyway.
        self._lock = threading.Lock()

    def __call__(self, B: np.ndarray) -> "PosedGpuSearch":
        """The search in a pose (b, d+1, d+1) of the unit frame."""
        pose = transforms(B)
        images = Images.of(self.engine.lattice, pose)
        with self._lock:
            return PosedGpuSearch(self, self.voxels(images), self.blends(pose))

    def voxels(self, images: Images) -> Voxels:
        """Lists of the cells whose boxes reach into each voxel, in the order of cells."""
        low, high = images.low, images.high
        scale = np.float32(VOXELS) / np.maximum((high - low).max(), np.float32(1e-6))
        shape = ((high - low) * scale).astype(np.int64) + 1
        cell = self._upload(images.cell)
        # Rounded as in the kernel, so that no point of a box lies in a voxel beyond those of the box.
        corners = ((cell[:, :6].view(-1, 2, 3) - self._upload(low)) * float(scale)).long()
        begin, end = torch.minimum(corners, self._upload(shape) - 1).unbind(1)
        extent = end - begin + 1
        count = extent.prod(dim=1)
        number = torch.repeat_interleave(count)
        rank = torch.arange(len(number), device=self.device) - (count.cumsum(0) - count)[number]
        _, e1, e2 = extent[number].unbind(1)
        i, j, k = (begin[number] + torch.stack([rank // (e1 * e2), rank // e2 % e1, rank % e2], dim=1)).unbind(1)
        voxel = (i * int(shape[1]) + j) * int(shape[2]) + k
        first = torch.zeros(int(shape.prod()) + 1, dtype=torch.int32, device=self.device)
        first[1:] = torch.bincount(voxel, minlength=len(first) - 1).cumsum(0)
        order = torch.sort(voxel, stable=True).indices
        return Voxels(self._frame(low, float(scale), shape), first, number[order].int(), self._records(cell))

    def blends(self, pose: np.ndarray) -> Blends:
        """Blended transforms of a pose (b, 12) at all nodes of blocks."""
        w, d = self.engine.weights, self.engine.d
        rows = self._upload(pose.reshape(-1, 3, 4)[:, :d].reshape(-1, 4 * d))
        row = embedding_bag(self._bone, rows, self._first, mode="sum", per_sample_weights=self._weight)
        return Blends(self._frame(w.origin, 1 / float(w.spacing), w.block.shape), self._block, row)

    def roots(self, x: Tensor, voxels: Voxels, blends: Blends) -> tuple[Tensor, Tensor]:
        """Smallest distances (n,) at roots of points (n, d) of the unit frame, and the roots; inf and nan for none."""
        x = x.to(self.device, torch.float32).contiguous()
        distance, x_rest = torch.empty(len(x), device=self.device), torch.empty_like(x)
        lanes = LANES if self.device.type == "cuda" else INTERPRETED
        if len(x):
            with self._lock, torch.cuda.device_of(x):
                search_kernel[(-(-len(x) // lanes),)](
                    x, len(x), distance, x_rest, voxels, blends, self._bricks,
                    D=self.engine.d, LANES=lanes, num_warps=1,
                )  # fmt: skip
        return distance, x_rest

    def _records(self, cell: Tensor) -> Tensor:
        """Records (c, 8, 4) of cells (c, 21) of `Images`, for tiles of points (x, y, z, 1).

        The box, from 0 to 2 in the last column; the image's centre; the map from there into edges of the cell, with its
        reach in the last column; the centre and the edges at rest.
        """
        found = torch.zeros((len(cell), 8, 4), device=self.device)
        found[:, :2, :3], found[:, 1, 3] = cell[:, :6].view(-1, 2, 3), 2
        found[:, 2, :3], found[:, 2, 3] = cell[:, 6:9], 1
        found[:, 3:6, :3], found[:, 3:6, 3] = cell[:, 9:18].view(-1, 3, 3), cell[:, 18:].clamp(max=UNBOUNDED)
        found[:, 6:, :3], found[:, 6, 3] = self._rest_cells, 1
        return found

    def _frame(self, low: np.ndarray, scale: float, shape: Iterable[int]) -> Tensor:
        """What places points in a grid. As numbers in memory: one that is an argument may be compiled into a kernel."""
        return self._upload(np.array([*low, scale, *shape]), np.float32)

    def _upload(self, array: np.ndarray, kind: type | None = None) -> Tensor:
        return torch.tensor(np.ascontiguousarray(array, dtype=kind), device=self.device)


class PosedGpuSearch:
    """A search in one pose."""

    def __init__(self, search: GpuSearch, voxels: Voxels, blends: Blends) -> None:
        self._search, self._voxels, self._blends = search, voxels, blends

    def __call__(self, x: np.ndarray, to_unit: np.ndarray) -> Answer[np.ndarray]:
        """The answer at points (n, d), which the transform (d, d+1) moves into the unit frame.

        A point without a canonical point is infinitely far outside, and its canonical point is nan.
        """
        x = x if x.flags.writeable else x.copy()  # torch shares only what may be written
        points, move = (torch.from_numpy(array).to(self._search.device) for array in (x, to_unit))
        found = self.roots(points @ move[:, :-1].T + move[:, -1])
        distance, x_rest = (tensor.cpu().numpy() for tensor in found)
        return Answer(distance, distance, x_rest, self._search.engine.width)

    def roots(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Smallest distances (n,) at roots of points (n, d) of the unit frame, and the roots, left on the device."""
        return self._search.roots(x, self._voxels, self._blends)
