"""Methods with nothing to learn, in double precision on arrays, behind the interface of every engine."""

from collections.abc import Callable

import numpy as np

from nilbs.engine.answer import Answer, PosedEngine

# Posed points (n, d) -> their signed distances (n,) and canonical points (n, d), nan if the method has none.
ArrayAnswers = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# In units of the body's longest edge: the step by which occupancy is read from distance.
WIDTH = 0.003


class ArrayEngine:
    """An engine that asks a function of poses and points.

    Parameters
    ----------
    in_pose : function of (b, d+1, d+1) array
        The method in a pose.
    canonical_points : bool
        Whether its answers have them.
    """

    has_distance = True

    def __init__(self, in_pose: Callable[[np.ndarray], ArrayAnswers], *, canonical_points: bool = True) -> None:
        self.in_pose, self.has_canonical_points = in_pose, canonical_points

    def __call__(self, B: np.ndarray) -> PosedEngine:
        """The method in a pose (b, d+1, d+1) of the unit frame."""
        answers = self.in_pose(B)

        def answer(x: np.ndarray, to_unit: np.ndarray) -> Answer[np.ndarray]:
            d = x.shape[1]
            distance, x_rest = answers(x @ to_unit[:, :d].T + to_unit[:, d])
            return Answer(distance, distance, x_rest, WIDTH)

        return answer
