import numpy as np
import pytest

from nilbs.geometry.acceleration import Anderson


def contraction(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A linear map A x + b that shrinks little, and its fixed point."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    A = Q @ np.diag(np.linspace(0.1, 0.99, n)) @ Q.T
    b = rng.normal(size=(n, 2))
    return A, b, np.linalg.solve(np.eye(n) - A, b)


def test_fewer_steps_than_the_map_alone(rng: np.random.Generator) -> None:
    A, b, fixed = contraction(rng, 30)
    alone = guessed = np.zeros((30, 2))
    following = Anderson(np.ones((30, 1)))
    for _ in range(60):
        alone, guessed = A @ alone + b, following(guessed, A @ guessed + b)
    assert np.abs(guessed - fixed).max() < 1e-2 * np.abs(alone - fixed).max()


@pytest.mark.parametrize("memory", [1, 3, 6])
def test_the_shortest_combined_step_by_least_squares(memory: int, rng: np.random.Generator, monkeypatch) -> None:
    monkeypatch.setattr("nilbs.geometry.acceleration.SAFE", 1e-15)
    A, b, _ = contraction(rng, 8)
    scale = rng.uniform(0.5, 2, (8, 1))
    following = Anderson(scale, memory)
    points, images = [np.zeros((8, 2))], []
    for _ in range(8):
        images.append(A @ points[-1] + b)
        recent = range(max(0, len(points) - memory - 1), len(points))
        step = np.stack([((images[k] - points[k]) * scale).ravel() for k in recent], axis=1)
        image = np.stack([images[k].ravel() for k in recent], axis=1)
        share = np.linalg.lstsq(np.diff(step, axis=1), step[:, -1], rcond=None)[0]
        expected = (image[:, -1] - np.diff(image, axis=1) @ share).reshape(8, 2)
        points.append(following(points[-1], images[-1]))
        np.testing.assert_allclose(points[-1], expected, atol=1e-5)


def test_a_wrong_guess_is_forgotten() -> None:
    following = Anderson(np.ones((1, 1)))
    for point, image in ((0.0, 1.0), (1.0, 1.5)):
        following(np.array([[point]]), np.array([[image]]))
    assert following.largest == 0.5
    # A step eight times as long: the map goes on alone.
    assert following(np.array([[0.0]]), np.array([[4.0]])) == 4


def test_a_point_that_stays(rng: np.random.Generator) -> None:
    x = rng.normal(size=(5, 3))
    following = Anderson(np.ones((5, 1)))
    for _ in range(10):
        np.testing.assert_array_equal(following(x, x), x)
    assert following.largest == 0


def test_without_memory_the_map_goes_on_alone(rng: np.random.Generator) -> None:
    following = Anderson(np.ones((5, 1)), 0)
    for _ in range(3):
        x, image = rng.normal(size=(2, 5, 3))
        np.testing.assert_array_equal(following(x, image), image)
        assert following.largest == np.abs(image - x).max()
