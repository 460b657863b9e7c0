"""Fewer repetitions of a map until it changes nothing."""

import numpy as np

# Of the size of the steps: added, so that steps which hardly differ do no harm.
SAFE = 1e-10
# A step that is so many times as long as the one before was extrapolated too far.
LONGER = 1.5


class Anderson:
    """Points that lead to the fixed point of a map in fewer steps than the map alone.

    Parameters
    ----------
    scale : (n, 1) float array
        How much each row counts in the length of a step.
    memory : int
        So many differences of steps are used; with none, the map goes on alone.

    Notes
    -----
    Type II of [1]_: of the last points, the weighted combination whose step is the shortest, as if the map were linear.
    Where that made the step longer, the steps before are dropped and the map goes on alone.

    References
    ----------
    .. [1] Walker, Ni, Anderson acceleration for fixed-point iterations, SIAM Journal on Numerical Analysis 2011,
       doi:10.1137/10078356X.

    Examples
    --------
    >>> A, b, x = np.array([[0.9, 0.1], [0.0, 0.8]]), np.ones((2, 1)), np.zeros((2, 1))
    >>> following = Anderson(np.ones((2, 1)))
    >>> for _ in range(4):
    ...     x = following(x, A @ x + b)
    >>> x.round(6).tolist()
    [[15.0], [5.0]]
    """

    def __init__(self, scale: np.ndarray, memory: int = 6) -> None:
        self.scale = scale
        self.largest = np.inf  # entry of the last step
        self._length = np.inf
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._count = 0
        self._products = np.zeros((memory, memory))
        # Differences of successive steps, scaled, and of the images, the oldest replaced first.
        self._steps = self._images = np.zeros((memory, 0))

    def __call__(self, point: np.ndarray, image: np.ndarray) -> np.ndarray:
        """The next point, of one and what the map made of it."""
        step = image - point
        self.largest = float(np.abs(step).max(initial=0))
        step = (step * self.scale).ravel()
        before, self._length = self._length, float(np.linalg.norm(step))
        last, self._last = self._last, (step, image)
        memory = len(self._products)
        if not memory or last is None or self._length > LONGER * before:
            self._count = 0
            return image
        if not self._count:
            self._steps, self._images = (np.zeros((memory, step.size), dtype=step.dtype) for _ in range(2))
            self._products[:] = 0
        new = self._count % memory
        self._steps[new], self._images[new] = step - last[0], (image - last[1]).ravel()
        self._products[new] = self._products[:, new] = self._steps @ self._steps[new]
        self._count += 1
        used = slice(min(self._count, memory))
        products = self._products[used, used]
        share = np.linalg.lstsq(
            products + SAFE * np.trace(products) * np.eye(len(products)), self._steps[used] @ step, rcond=None
        )[0]
        return image - (share.astype(image.dtype) @ self._images[used]).reshape(image.shape)
