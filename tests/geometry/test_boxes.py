import itertools

from nilbs.geometry.boxes import overlapping_boxes


def test_boxes_against_a_slow_twin(rng):
    for m in (1, 2, 3, 5, 8, 17, 64, 65):
        lower = rng.integers(0, 9, size=(m, 3)).astype(float)
        upper = lower + rng.integers(0, 3, size=(m, 3))
        pairs = {frozenset(pair) for i, j in overlapping_boxes(lower, upper) for pair in zip(i, j, strict=True)}
        expected = {
            frozenset((i, j))
            for i, j in itertools.combinations(range(m), 2)
            if (lower[i] <= upper[j]).all() and (lower[j] <= upper[i]).all()
        }
        assert pairs == expected
