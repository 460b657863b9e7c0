"""NASA: one small network for each bone, in that bone's frame, and the body is the union of what they hold."""

import numpy as np
import torch
from torch import Tensor, nn

from nilbs.fields.encoding import LocalEncoding
from nilbs.fields.field import CACHED, Field
from nilbs.fields.samples import RestSamples

# Slope of a unit where it is negative, and how many numbers of the pose a part sees: as in the authors' code.
LEAK = 0.1
POSE_SIZE = 4
# The weights of the point begin this much larger than a linear layer's: a part is some tenths of the body long, and
# there its network should bend, not far beyond.
SHARPNESS = 6.0


class NasaField(Field):
    """O(x | theta) = max_b O_b(B_b^-1 x | theta) [1]_; `Nasa` lists what differs from the paper.

    Each part has a network of its own, which sees the point in its bone's frame. In the rigid model that is all it
    sees, so a part moves with its bone and never bends. In the deformable model it also sees the pose, as four numbers
    Pi_b z: z stacks the root joint as every bone sees it, B_b^-1 t_0, and Pi_b is learned.

    The root joint t_0 is the first joint of the root bone, moved by that bone. In the unit frame the root stays where
    it is, and so does t_0; the field is the same for a character that is moved as a whole.

    Parameters
    ----------
    centers : (b, d) tensor
        First joint of every bone at rest.
    deformable : bool
        Whether parts see the pose.
    width, depth : int
        Units and number of a part's hidden layers; all but the first add to what they receive, and a linear layer
        follows.
    root : int
        Bone whose first joint is t_0.

    References
    ----------
    .. [1] Deng et al., NASA: Neural Articulated Shape Approximation, 2020, arXiv:1912.03207.
    """

    def __init__(self, centers: Tensor, *, deformable: bool, width: int = 40, depth: int = 4, root: int = 0) -> None:
        super().__init__()
        if depth < 1:
            raise ValueError(f"a part needs at least 1 hidden layer, got {depth}")
        b, d = centers.shape
        self.encoding = LocalEncoding(centers)
        self.deformable, self.root = deformable, root
        self.piece = max(128, CACHED // (b * width))
        self.projection = _uniform(b, POSE_SIZE, b * d, inputs=b * d) if deformable else None
        inputs = d + POSE_SIZE if deformable else d
        # Layers of all parts side by side, in stacks of one matrix a part.
        self.first_weight = _uniform(b, width, inputs, inputs=inputs)
        with torch.no_grad():
            self.first_weight[..., :d] *= SHARPNESS
        self.first_bias = _uniform(b, width, 1, inputs=inputs)
        self.weights = nn.ParameterList(_uniform(b, width, width, inputs=width) for _ in range(depth - 1))
        self.biases = nn.ParameterList(_uniform(b, 1, width, inputs=width) for _ in range(depth - 1))
        self.last_weight = _uniform(b, 1, width, inputs=width)
        self.last_bias = _uniform(b, 1, 1, inputs=width)

    def part_logits(self, x: Tensor, B: Tensor) -> Tensor:
        """Logits (p, b, n) of occupancy by every part, of points (p, n, d) in poses (p, b, d+1, d+1)."""
        (p, n, d), b = x.shape, B.shape[1]
        linear, offset = self.encoding(B)
        # The encoding is affine in the point and so is the first layer: for a pose they are one small matrix a part.
        weight = self.first_weight[..., :d]
        first = weight @ linear.reshape(p, b, d, d)
        start = weight @ offset.reshape(p, b, d, 1) + self.first_bias
        if self.projection is not None:
            pose = (self.projection @ self._root_joint(B, linear, offset)[:, None]).reshape(p, b, POSE_SIZE, 1)
            start = start + self.first_weight[..., d:] @ pose
        # Parts first, then all points of all poses: each further layer is one batched product.
        points = x.mT.expand(b, p, d, n)
        hidden = (start.transpose(0, 1) + first.transpose(0, 1) @ points).mT.flatten(1, 2)
        hidden = nn.functional.leaky_relu(hidden, LEAK)
        for weight, bias in zip(self.weights, self.biases, strict=True):
            hidden = nn.functional.leaky_relu(hidden + torch.baddbmm(bias, hidden, weight), LEAK)
        logits = torch.baddbmm(self.last_bias, hidden, self.last_weight.mT)
        return logits.reshape(b, p, n).transpose(0, 1)

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy (p, n) of points (p, n, d) in poses (p, b, d+1, d+1): that of the largest part."""
        return self.part_logits(x, B).amax(dim=1)

    def _root_joint(self, B: Tensor, linear: Tensor, offset: Tensor) -> Tensor:
        """The root joint as every bone sees it, (p, b d, 1)."""
        d = B.shape[-1] - 1
        root = B[:, self.root]
        joint = root[:, :d, :d] @ self.encoding.centers[self.root] + root[:, :d, d]
        return linear @ joint[..., None] + offset[..., None]


class NasaWeightTerm:
    """The paper's weight loss: a vertex lies on the surface of the part whose weight is largest, and in no other.

    Mean over vertices of the rest surface and parts of (O_b(x) - I_b)^2, with I_b one half for that part and zero for
    all others. The mean is over parts too, as in the authors' code; where a sum over parts is written, the factor
    counts b times less here.
    """

    def __init__(
        self,
        field: NasaField,
        points: RestSamples,
        poses: Tensor,
        *,
        poses_per_step: int,
        points_per_pose: int,
        factor: float,
    ) -> None:
        like = next(field.parameters())
        self.field, self.poses, self.factor = field, poses.to(like), factor
        self.V, self.W = (torch.as_tensor(array).to(like) for array in (points.x_rest, points.W))
        self.part = self.W.argmax(dim=1)
        self.poses_per_step, self.points_per_pose = poses_per_step, points_per_pose

    def __call__(self, rng: np.random.Generator) -> Tensor:
        """The loss on a batch, a scalar."""
        shape = (self.poses_per_step, self.points_per_pose)
        pose = torch.as_tensor(rng.integers(0, len(self.poses), self.poses_per_step), device=self.poses.device)
        vertex = torch.as_tensor(rng.integers(0, len(self.V), shape), device=self.poses.device)
        B, d = self.poses[pose], self.V.shape[1]
        blend = (self.W[vertex] @ B[:, :, :d].flatten(2)).unflatten(-1, (d, d + 1))
        x = (blend[..., :d] @ self.V[vertex][..., None])[..., 0] + blend[..., d]
        occupancy = torch.sigmoid(self.field.part_logits(x, B))
        expected = 0.5 * nn.functional.one_hot(self.part[vertex], B.shape[1]).to(occupancy).mT
        return self.factor * ((occupancy - expected) ** 2).mean()


def _uniform(*shape: int, inputs: int) -> nn.Parameter:
    """Random parameters, as large as those of a linear layer with as many inputs."""
    return nn.Parameter((2 * torch.rand(shape) - 1) / inputs**0.5)
