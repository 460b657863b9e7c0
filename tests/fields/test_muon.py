import numpy as np
import pytest
import torch

from nilbs.fields.muon import Muon, orthogonal


@pytest.mark.parametrize("shape", [(5, 5), (3, 8), (8, 3), (1, 6), (6, 1)])
def test_updates_are_nearly_orthogonal(shape: tuple[int, int], rng: np.random.Generator) -> None:
    G = torch.as_tensor(rng.normal(size=(4, *shape)))
    for one, many in zip(G, orthogonal(G), strict=True):
        torch.testing.assert_close(orthogonal(one), many)
        u, _, vt = torch.linalg.svd(one, full_matrices=False)
        turned = u.T @ many @ vt.T
        # The same singular vectors; values between two thirds and one and a quarter.
        stretch = turned.diagonal()
        assert 0.65 < stretch.min() <= stretch.max() < 1.25
        assert (turned - torch.diag(stretch)).abs().max() < 1e-9


@pytest.mark.parametrize("shape", [(5, 5), (3, 8), (8, 3)])
def test_a_stack_of_matrices_moves_as_by_torch_s_own_optimizer(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    start, targets = (torch.as_tensor(rng.normal(size=(3, *shape)), dtype=torch.float32) for _ in range(2))
    stack = torch.nn.Parameter(start.clone())
    single = [torch.nn.Parameter(matrix.clone()) for matrix in start]
    ours = Muon([stack], lr=0.05)
    theirs = torch.optim.Muon(single, lr=0.05, weight_decay=0.0)
    for _ in range(20):
        stack.grad = stack.detach() - targets
        for matrix, target in zip(single, targets, strict=True):
            matrix.grad = matrix.detach() - target
        ours.step()
        theirs.step()
    # torch's own rounds to bfloat16 on the way.
    torch.testing.assert_close(stack.detach(), torch.stack([m.detach() for m in single]), rtol=0, atol=0.03)
    assert (stack.detach() - start).norm() > 1


def test_a_gradient_of_none_or_zero_changes_nothing() -> None:
    still, flat = torch.nn.Parameter(torch.ones(2, 2)), torch.nn.Parameter(torch.ones(2, 2))
    flat.grad = torch.zeros(2, 2)
    Muon([still, flat], lr=0.1).step()
    assert torch.equal(still, torch.ones(2, 2))
    assert torch.equal(flat, torch.ones(2, 2))
