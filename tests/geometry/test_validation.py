import numpy as np
import pytest

from nilbs.geometry.validation import arrays, check_indices, listed


def test_lists_become_float_and_int_arrays_in_order() -> None:
    V, F = arrays(V=([[0, 0], [1, 0]], "n d"), F=([[0.0, 1.0]], "m d", int))
    assert V.dtype == np.float64
    assert F.dtype == np.int64
    np.testing.assert_array_equal(V, [[0, 0], [1, 0]])
    np.testing.assert_array_equal(F, [[0, 1]])


def test_an_array_of_the_right_type_is_not_copied() -> None:
    V = np.zeros((4, 3))
    assert arrays(V=(V, "n d"))[0] is V


@pytest.mark.parametrize("d", [2, 3])
def test_letters_sums_numbers_and_leading_dimensions(d: int) -> None:
    B, theta = arrays(B=(np.zeros((5, 4, d + 1, d + 1)), "... b d+1 d+1"), theta=(np.zeros((4, 1)), "b 1"))
    assert B.shape == (5, 4, d + 1, d + 1)
    assert theta.shape == (4, 1)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"V": (np.zeros((0, 2)), "n d"), "W": (np.zeros((5, 3)), "n b")}, "W must be (n, b) = (0, b), got (5, 3)"),
        ({"W": (np.zeros((5, 3)), "5 2")}, "W must be (5, 2), got (5, 3)"),
        ({"V": (np.zeros((2, 2)), "n d"), "B": (np.zeros((1, 4, 4)), "b d+1 d+1")}, "B must be (b, d+1, d+1) = (1, 3,"),
        ({"V": (np.zeros((2, 2)), "n d"), "x": (np.zeros(3), "d")}, "x must be (d,) = (2,), got (3,)"),
        ({"x": (np.zeros(3), "n d")}, "x must be (n, d), got (3,)"),
        ({"B": (np.zeros(3), "... d d")}, "B must be (..., d, d), got (3,)"),
        ({"B": (np.zeros((2, 2, 3)), "... d d")}, "B must be (..., d, d) = (..., 2, 2), got (2, 2, 3)"),
        ({"V": (np.zeros((2, 4)), "n d")}, "V has d = 4; d must be 2 or 3"),
        ({"V": ([["a", "b"]], "n d")}, "V must be an array of numbers, got list"),
        ({"V": ({}, "n d")}, "V must be an array of numbers, got dict"),
        ({"V": ([[0, 1], [2]], "n d")}, "V must be an array of numbers, got list"),
        ({"F": ([[0.5, 1]], "m d", int)}, "F must hold whole numbers"),
        ({"F": ([[np.nan, 1]], "m d", int)}, "F must hold whole numbers"),
        ({"V": ([[0, 1], [np.nan, 2]], "n d")}, "V[1, 0] is nan; every number must be finite"),
        ({"V": ([[0, -np.inf]], "n d")}, "V[0, 1] is -inf; every number must be finite"),
    ],
)
def test_every_error_has_one_wording(named: dict[str, tuple], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        arrays(**named)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("shape", [(0,), (0, 2), (0, 4), (3, 0)])
def test_no_indices_are_all_right(shape: tuple[int, ...]) -> None:
    check_indices("F", np.zeros(shape, dtype=np.int64), 0, "vertices")


def test_an_index_outside_is_named_with_its_row() -> None:
    check_indices("F", np.array([[0, 1], [1, 2]]), 3, "vertices")
    with pytest.raises(ValueError, match=r"^F\[1\] = \[1, 3\] does not index the 3 vertices$"):
        check_indices("F", np.array([[0, 1], [1, 3]]), 3, "vertices")
    with pytest.raises(ValueError, match=r"^P\[0\] = -1 does not index the 3 bones$"):
        check_indices("P", np.array([-1, 0]), 3, "bones")


def test_indices_are_checked_against_the_array_that_they_index() -> None:
    V, F = arrays(V=(np.zeros((3, 2)), "n d"), F=([[0, 2]], "m d", "V"))
    assert F.dtype == np.int64
    assert arrays(V=(V, "n d"), F=(np.zeros((0, 2)), "m d", "V"))[1].shape == (0, 2)
    with pytest.raises(ValueError, match=r"^F\[1\] = \[1, 3\] does not index the 3 vertices$"):
        arrays(V=(V, "n d"), F=([[0, 1], [1, 3]], "m d", "V"))
    with pytest.raises(ValueError, match=r"^BE\[0\] = \[-1, 0\] does not index the 3 joints$"):
        arrays(C=(V, "k d"), BE=([[-1, 0]], "b 2", "C"))


def test_words_for_a_sentence() -> None:
    assert listed([]) == ""
    assert listed("abcde") == "a, b, c, d, e"
    assert listed("abcdef") == "a, b, c, d, e and 1 more"
