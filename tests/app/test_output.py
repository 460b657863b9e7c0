import errno
import io
import json
from pathlib import Path

import numpy as np
import pytest

from nilbs.app.output import rows, show


def test_types_that_json_lacks_are_converted(capsys):
    values = {"a": np.arange(3), "b": np.float32(0.5), "c": np.nan, "d": [np.inf, None], "e": Path("x"), 1: (True, 2)}
    show(values, as_json=True)
    shown = json.loads(capsys.readouterr().out)
    assert shown == {"a": [0, 1, 2], "b": 0.5, "c": None, "d": [None, None], "e": "x", "1": [True, 2]}


def test_table_nests_and_aligns():
    text = rows({"a_b": 1, "inner": {"long name": [1.5, False]}, "nothing": None})
    assert text.splitlines() == ["a b      1", "inner", "  long name  1.5, no", "nothing  -"]
    assert rows({}) == ""


def test_a_table_of_its_own(capsys):
    show({"a": 1}, as_json=False, table="my table")
    assert capsys.readouterr().out == "my table\n"


def test_output_that_cannot_be_written_is_named(monkeypatch):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("sys.stdout", Full())
    with pytest.raises(OSError, match="standard output") as caught:
        show({"a": 1}, as_json=True)
    assert caught.value.errno == errno.ENOSPC
