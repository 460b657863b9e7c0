"""A chain of two bones and its field, small enough that losses can be computed by hand."""

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    import torch

    from nilbs.fields.inverse_map import InverseField


class Chain:
    """Two bones, one after the other."""

    BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])

    def joints(self, d: int) -> np.ndarray:
        return np.array([[0, 0, 0], [0.5, 0, 0], [1, 0.2, 0.1]])[:, :d]

    def field(self, d: int) -> "InverseField":
        """A field that was never trained, of a distance that grows along the axes."""
        import torch

        from nilbs.fields.cache import RestCache
        from nilbs.fields.encoding import LocalEncoding
        from nilbs.fields.inverse_map import InverseField
        from nilbs.fields.network import WeightNetwork

        torch.manual_seed(0)
        cache = RestCache.of_grid(torch.linspace(-1, 1, 4**d).reshape((4,) * d), torch.full((d,), -1.0), 0.7, width=0.1)
        network = WeightNetwork(LocalEncoding(torch.as_tensor(self.joints(d)[:2])), 2, width=8, depth=3)
        return InverseField(network, cache, root=0).double()

    def motion(self, d: int, frames: int) -> "torch.Tensor":
        """Random poses (frames, 2, d+1, d+1)."""
        import torch

        from nilbs.geometry.kinematics import forward_kinematics

        theta = np.random.default_rng(2).normal(size=(frames, 2, 3 if d == 3 else 1))
        return torch.as_tensor(forward_kinematics(self.joints(d), self.BE, self.P, theta))


@pytest.fixture
def chain() -> Chain:
    return Chain()
