"""The kept files are read or refused, and so are all that a few changes make of them."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from nilbs.io.bundle import Bundle, Mesh

from .readers import CORPUS, READERS, corpus, read_or_refused


@pytest.mark.parametrize("name", READERS)
def test_kept_files_are_read_or_refused(name, tmp_path):
    read = [read_or_refused(name, file.read_bytes(), tmp_path) for file in corpus(name)]
    assert any(read)


@pytest.mark.parametrize("name", READERS)
def test_changed_files_are_read_or_refused(name, tmp_path):
    read = 0
    rng = Random(7)

    def mutate(part: bytes) -> bytes:
        at = rng.randrange(len(part) + 1)
        return part[:at] + rng.randbytes(rng.randrange(3)) + part[at + rng.randrange(4) :]

    for file in corpus(name):
        content = file.read_bytes()
        for _ in range(20):
            read += read_or_refused(name, READERS[name].mutate(content, rng, mutate), tmp_path)
    assert read, "no change keeps the form"


def _raise(error):
    raise error


ANSWERS = {
    "not a number": lambda path: np.array([np.nan]),
    "no face": lambda path: Bundle(Mesh(np.eye(3), np.array([[0, 1, 3]]))),
    "no text": lambda path: ["\ud800"],
    "another error": lambda path: _raise(KeyError("x")),
    "a warning": lambda path: np.float64(1e308) * 10,
}


@pytest.mark.parametrize("what", ANSWERS)
def test_anything_else_is_an_error(what, tmp_path, monkeypatch):
    monkeypatch.setitem(READERS, "obj", replace(READERS["obj"], read=ANSWERS[what]))
    with pytest.raises((AssertionError, UnicodeError, KeyError, RuntimeWarning)):
        read_or_refused("obj", b"", tmp_path)


def test_every_folder_of_the_corpus_is_of_a_reader():
    assert sorted(folder.name for folder in CORPUS.iterdir()) == sorted(READERS)
