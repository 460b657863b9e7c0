import numpy as np
import pytest
import torch

from nilbs.fields.objective import Objective
from nilbs.fields.occupancy_term import OccupancyTerm
from nilbs.fields.samples import OccupancySamples

REFRESH = 5


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nilbs.fields.objective.REFRESH", REFRESH)


class Scale(torch.nn.Module):
    """A field with one parameter: inside where the first coordinate, scaled, is positive."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.tensor(1.0))

    def logit(self, x: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
        return self.scale * x[..., 0] + 0 * B.sum()


def objective(*, seed: int = 11, others: tuple = ()) -> tuple[Scale, Objective]:
    rng = np.random.default_rng(4)
    field, poses = Scale(), torch.eye(3).expand(3, 2, 3, 3)
    labelled = OccupancySamples(rng.normal(size=(3, 20, 2)).astype(np.float32), rng.random((3, 20)) < 0.5)
    term = OccupancyTerm(field.logit, poses, labelled, poses_per_step=4, points_per_pose=6, adaptive=True)
    return field, Objective(term, *others, seed=seed)


def learn(field: Scale) -> None:
    with torch.no_grad():
        field.scale += 0.5


def test_a_step_depends_on_its_number_and_the_last_refresh() -> None:
    _, loss = objective()
    first = [loss(step).item() for step in range(REFRESH)]
    assert len(set(first)) == REFRESH
    # It does not depend on earlier steps since the last refresh, nor on an earlier run.
    _, again = objective()
    again(REFRESH)
    assert again(0).item() == first[0]
    assert [again(step).item() for step in reversed(range(1, REFRESH))] == first[:0:-1]
    assert objective(seed=12)[1](0).item() != first[0]


def test_a_loss_that_continues_at_a_refresh_is_unchanged() -> None:
    (field, loss), (other, fresh) = objective(), objective()
    loss(0)
    learn(field)
    learn(other)
    stretch = range(REFRESH, 2 * REFRESH)
    assert [loss(step).item() for step in stretch] == [fresh(step).item() for step in stretch]
    # Between two refreshes it cannot: a new objective has no errors yet.
    assert objective()[1](REFRESH + 1).item() != fresh(REFRESH + 1).item()


def test_errors_are_refreshed_every_so_many_steps() -> None:
    field, loss = objective()
    for step in range(REFRESH):
        loss(step)
        np.testing.assert_array_equal(loss.occupancy.sampler.mass, 1)
    loss(REFRESH)
    seen = loss.occupancy.sampler.mass
    assert np.abs(seen - 1).max() > 1e-3
    learn(field)
    for step in range(REFRESH + 1, 2 * REFRESH):
        loss(step)
        np.testing.assert_array_equal(loss.occupancy.sampler.mass, seen)
    loss(2 * REFRESH)
    assert np.abs(loss.occupancy.sampler.mass - seen).max() > 1e-3


def test_losses_are_added_and_draw_from_one_generator() -> None:
    drawn = []

    def other(rng: np.random.Generator) -> torch.Tensor:
        drawn.append(rng.random())
        return torch.tensor(100.0)

    alone, both = objective()[1](3).item(), objective(others=(other, other))[1](3).item()
    assert both == pytest.approx(alone + 200)
    assert len(set(drawn)) == 2
    # Without the first loss the generator is as it was.
    assert Objective(None, other, seed=11)(3).item() == 100
    assert drawn[2] == np.random.default_rng([11, 3]).random()


def test_without_any_loss_there_is_nothing_to_train_for() -> None:
    with pytest.raises(ValueError, match=r"^every loss is off: there is nothing to train for$"):
        Objective(None, seed=0)
