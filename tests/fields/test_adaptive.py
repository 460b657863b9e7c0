import numpy as np
import pytest
import torch

from nilbs.fields.adaptive import AdaptiveSampler


def refreshed(error: np.ndarray) -> AdaptiveSampler:
    sampler = AdaptiveSampler(*error.shape)
    sampler.refresh(lambda frame, seen: torch.as_tensor(error[frame, seen]))
    return sampler


def shares(sampler: AdaptiveSampler, rng: np.random.Generator, *, draws: int = 20_000) -> np.ndarray:
    """How often each point of each frame is drawn, as a share of all draws."""
    count = np.zeros((sampler.frames, sampler.points))
    frame, point = sampler.draw(draws, 10, rng)
    np.add.at(count, (frame[:, None], point), 1)
    return count / count.sum()


def test_all_points_are_equally_likely_before_the_first_refresh(rng: np.random.Generator) -> None:
    np.testing.assert_allclose(shares(AdaptiveSampler(3, 4), rng), 1 / 12, rtol=0.05)


def test_half_of_the_draws_are_in_proportion_to_the_error(rng: np.random.Generator) -> None:
    error = np.array([[0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(shares(refreshed(error), rng), 0.5 / 12 + 0.5 * error / 12, rtol=0.05)


def test_the_last_refresh_counts(rng: np.random.Generator) -> None:
    sampler = refreshed(np.array([[1.0, 0.0], [0.0, 0.0]]))
    last = np.array([[0.0, 0.0], [0.0, 1.0]])
    sampler.refresh(lambda frame, seen: torch.as_tensor(last[frame, seen]))
    np.testing.assert_allclose(shares(sampler, rng), 0.125 + 0.5 * last, rtol=0.05)


def test_a_refresh_may_take_some_of_the_points(rng: np.random.Generator) -> None:
    error = np.array([[1.0, 50.0, 3.0, 50.0], [0.0, 50.0, 4.0, 50.0]])
    sampler = AdaptiveSampler(2, 4)
    sampler.refresh(lambda frame, seen: torch.as_tensor(error[frame, seen]), slice(0, None, 2))
    found = shares(sampler, rng)
    np.testing.assert_allclose(found[:, 1::2], 0.5 / 8, rtol=0.05)
    np.testing.assert_allclose(found[:, ::2], 0.5 / 8 + 0.5 * error[:, ::2] / 8, rtol=0.05)
    sampler.forget()
    np.testing.assert_allclose(shares(sampler, rng), 1 / 8, rtol=0.05)


def test_all_points_are_equally_likely_if_none_is_wrong(rng: np.random.Generator) -> None:
    np.testing.assert_allclose(shares(refreshed(np.zeros((3, 4))), rng), 1 / 12, rtol=0.05)


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (5, 1), (3, 1000)])
def test_every_index_exists_and_the_last_ones_are_reached(size: tuple[int, int], rng: np.random.Generator) -> None:
    # Nearly all of the error is in the last points; a rounded sum could exceed the last index.
    error = np.full(size, 1e-9)
    error[-1, -1] = 1.0
    frame, point = refreshed(error).draw(500, 20, rng)
    assert frame.shape == (500,)
    assert point.shape == (500, 20)
    assert frame.min() >= 0
    assert point.min() >= 0
    assert frame.max() == size[0] - 1
    assert point.max() == size[1] - 1


class Ends:
    """A generator that draws one end of each interval only; the upper end is excluded, as in numpy."""

    def __init__(self, *, upper: bool) -> None:
        self.upper = upper

    def uniform(self, low: float, high: float, size: object) -> np.ndarray:
        return np.full(size, np.nextafter(high, low) if self.upper else low, dtype=np.float64)


@pytest.mark.parametrize("upper", [False, True])
def test_the_ends_of_the_intervals_stay_in_their_frame(upper: bool, rng: np.random.Generator) -> None:
    sampler = refreshed(rng.random((7, 333)))
    frame, point = sampler.draw(2, 3, Ends(upper=upper))
    np.testing.assert_array_equal(frame, 6 if upper else 0)
    np.testing.assert_array_equal(point, 332 if upper else 0)


def test_the_same_generator_draws_the_same(rng: np.random.Generator) -> None:
    sampler = refreshed(rng.random((3, 20)))
    first, again, other = (sampler.draw(50, 6, np.random.default_rng(seed)) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first[1], other[1])


def test_a_refresh_keeps_no_gradient() -> None:
    weight = torch.ones(4, requires_grad=True)
    evaluated: list[torch.Tensor] = []

    def error(frame: int, seen: slice) -> torch.Tensor:
        evaluated.append(weight * frame)
        return evaluated[-1]

    AdaptiveSampler(2, 4).refresh(error)
    assert [tensor.requires_grad for tensor in evaluated] == [False, False]
