from nilbs.io.names import text_of, unique_names


def test_undecodable_bytes_are_replaced():
    assert text_of(b"H\xfcfte") == "H\ufffdfte"


def test_many_equal_names_are_numbered_without_clashes():
    names, notes = unique_names(["a", "a_3", *["a"] * 5000])
    assert len(set(names)) == 5002
    assert names[:5] == ("a", "a_3", "a_2", "a_4", "a_5")
    assert notes == (
        "names used twice were numbered: 'a' became 'a_2', 'a' became 'a_4', 'a' became 'a_5', 'a' became 'a_6', "
        "'a' became 'a_7' and 4995 more",
    )
    assert unique_names(["a", "a", "a_2"])[0] == ("a", "a_3", "a_2")
    assert unique_names(["x", "y"]) == (("x", "y"), ())
