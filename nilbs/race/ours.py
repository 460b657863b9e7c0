"""Contestants of this package."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from nilbs.models.model import Model
from nilbs.models.posed_model import PosedModel
from nilbs.race.contestants import DISTANCE, OCCUPANCY, Kind

ENGINE, BATCHES, NETWORK = "nilbs", "nilbs, poses together", "nilbs, network alone"
TORCH, TORCH_ON_GPU = "nilbs, torch", "nilbs, torch on a GPU"
GPU, GPU_ALONE = "nilbs on a GPU", "nilbs on a GPU, points there"
_NONE = np.empty((0, 3))


class _InTorch(Model):
    """A model that its field answers, even if there is an engine."""

    def engine(self, mapping: str | None = None) -> None:
        """None: the field answers."""
        return


class Own:
    """A model, by its engine or by torch on a device, and by one of its mappings."""

    def __init__(
        self, model: Model, quantity: str, threads: int, *, mapping: str | None = None, device: str | None = None
    ) -> None:
        self.quantity, self.mapping = quantity, mapping
        self.model = model
        if device is not None:
            # Another model, because `to` changes the one that it moves.
            parts = (model.character, model.motion, model.method, model.history, model.parameters, model.rest)
            self.model = _InTorch(*parts).to(device=device)
        if self.model.engine(mapping) is None:
            import torch

            torch.set_num_threads(threads)

    def points(self, x: np.ndarray) -> np.ndarray:
        """The points as they are."""
        return x

    def pose(self, B: np.ndarray) -> None:
        """Prepare starts, and for distances the tree."""
        self.posed: PosedModel = self.model.posed(B, mapping=self.mapping)
        self.posed.occupancy(_NONE)  # what is prepared at the first query belongs to the pose
        if self.quantity == DISTANCE:
            _ = self.posed.surface

    def query(self, x: np.ndarray) -> np.ndarray:
        """Occupancy above one half, or distance to the posed surface."""
        return self.posed.posed_distance(x) if self.quantity == DISTANCE else self.posed.occupancy(x) > 0.5


class Batches(Own):
    """A model that is asked for all poses of a stream's block in one call."""

    def together(self, B: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Answers in poses (p, b, 4, 4) at points (p, n, 3)."""
        if self.quantity == DISTANCE:
            return self.model.posed_distance(x, B)
        return self.model.occupancy(x, B) > 0.5


class OnGpu(Own):
    """A model on a GPU, searched by the kernel."""

    device = "cuda"

    def __init__(self, model: Model, quantity: str, threads: int) -> None:
        super().__init__(model, quantity, threads)
        self.model = replace(model).to(device=self.device)


class AloneOnGpu(OnGpu):
    """The same at points that lie on the GPU before the clock starts; occupancies are moved back."""

    def points(self, x: np.ndarray) -> Any:
        """The points on the device, in single precision."""
        import torch

        return torch.as_tensor(x, dtype=torch.float32, device=self.device)

    def pose(self, B: np.ndarray) -> None:
        """Keep the pose: what it takes is computed with the query."""
        self.B = B

    def query(self, x: Any) -> np.ndarray:
        """Whether each point is inside."""
        import torch

        with torch.inference_mode():
            return (self.model.answer(x, torch.from_numpy(self.B)).level < 0).cpu().numpy()


KINDS = (
    Kind(ENGINE, (OCCUPANCY, DISTANCE), Own, note="the model's default; exact lengths from a tree of the posed mesh"),
    Kind(BATCHES, (OCCUPANCY, DISTANCE), Batches, note="the same, with the poses of a block in one call", streams=True),
    Kind(NETWORK, (OCCUPANCY,), partial(Own, mapping="inverse"), note="the paper's inverse map, by torch"),
    Kind(TORCH, (OCCUPANCY,), partial(Own, device="cpu"), note="the same search in torch, which has derivatives"),
    Kind(TORCH_ON_GPU, (OCCUPANCY,), partial(Own, device="cuda"), note="the same; points and answers are moved"),
    Kind(GPU, (OCCUPANCY,), OnGpu, note="one kernel of Triton; points and answers are moved to and fro"),
    Kind(GPU_ALONE, (OCCUPANCY,), AloneOnGpu, note="the same; points are there before, and answers are moved"),
)


def missing(kind: Kind, model: Model) -> str | None:
    """Why one of these cannot take part, in one line; None if it can."""
    if kind.name == NETWORK and ("inverse" not in model.method.mappings or not model.parameters):
        return "the model has no network"
    if kind.name == TORCH and model.engine() is None:
        return "the model is queried in torch anyway"
    if kind.name != ENGINE and find_spec("torch") is None:
        return "not installed: pip install torch"
    if kind.name in (TORCH_ON_GPU, GPU, GPU_ALONE):
        import torch

        if not torch.cuda.is_available():
            return "there is no GPU"
    if kind.name in (GPU, GPU_ALONE) and model.engine() is None:
        return "the model is queried in torch anyway"
    if kind.name in (GPU, GPU_ALONE) and find_spec("triton") is None:
        return "not installed: pip install triton"
    return None


def kept_bytes(kind: Kind, model: Model) -> int:
    """Bytes of what a contestant reads of the model's file; a mesh contestant reads nothing but the mesh."""
    if kind.package:
        return 0
    arrays = [*model.rest.arrays.values(), *model.parameters.values()]
    return sum(array.nbytes for array in arrays)
