import pytest

from nilbs.io.words import finite_numbers, is_finite_number, listed, text_of, unique_names


@pytest.mark.parametrize("word", [b"", b"x", b"nan", b"-inf", b"1_0", b"1e999", b"\xff", "\u0661".encode()])
def test_what_is_no_finite_number(word):
    assert finite_numbers([b"1", word]) is None


def test_numbers():
    assert finite_numbers([b"1", b"-.5", b"2.", b"1E-3"]).tolist() == [1, -0.5, 2, 0.001]
    assert finite_numbers([]).shape == (0,)


@pytest.mark.parametrize("value", [True, None, "1", [1], 10**400, float("nan"), float("inf")])
def test_what_is_no_finite_number_of_json(value):
    assert not is_finite_number(value)


def test_undecodable_bytes_are_replaced():
    assert text_of(b"H\xfcfte") == "H\ufffdfte"


def test_many_equal_names_are_numbered_fast_and_without_clashes():
    names, notes = unique_names(["a", "a_3", *["a"] * 5000])
    assert len(set(names)) == 5002
    assert names[:5] == ("a", "a_3", "a_2", "a_4", "a_5")
    assert notes == (
        "names used twice were numbered: 'a' became 'a_2', 'a' became 'a_4', 'a' became 'a_5', 'a' became 'a_6', "
        "'a' became 'a_7' and 4995 more",
    )
    assert unique_names(["x", "y"]) == (("x", "y"), ())
    assert listed([]) == ""
