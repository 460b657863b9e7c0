"""Characters that are prepared once, and their motion."""

import numpy as np
import pytest

from benchmarks.study.characters import SOURCES, made_of, motion_of, prepared


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("characters")


def test_a_character_is_kept_and_one_that_cannot_be_read_is_made_again(folder, monkeypatch) -> None:
    made = prepared("gingerbread-2d", folder, None)
    assert made.d == 2
    path = folder / "gingerbread-2d.character"
    whole = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("benchmarks.study.characters._loaded", None)  # it is read, not made
        again = prepared("gingerbread-2d", folder, None)
    for name, array in made.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)
    assert again.skeleton.names == made.skeleton.names
    path.write_bytes(whole[:-1])
    np.testing.assert_array_equal(prepared("gingerbread-2d", folder, None).W, made.W)
    assert len(path.read_bytes()) == len(whole)


def test_other_files_make_another_character(folder, tmp_path, monkeypatch) -> None:
    prepared("gingerbread-2d", folder, None)
    whole = (folder / "gingerbread-2d.character").read_bytes()
    # Under the name of a character that is made of files, of other sizes than those that are there.
    (folder / "arm.character").write_bytes(whole)
    (tmp_path / "arm").mkdir()
    for file in ("arm.obj", "arm.tgf"):
        (tmp_path / "arm" / file).touch()
    calls = []
    made = prepared("gingerbread-2d", folder, None)
    monkeypatch.setattr("benchmarks.study.characters._loaded", lambda *arguments: (calls.append(1), made)[1])
    prepared("arm", folder, tmp_path)
    assert calls == [1]
    prepared("arm", folder, tmp_path)
    assert calls == [1]
    (tmp_path / "arm" / "arm.obj").write_text("v 0 0 0\n")
    prepared("arm", folder, tmp_path)
    assert calls == [1, 1]
    before = made_of(SOURCES["arm"], tmp_path)
    (tmp_path / "arm" / "arm.obj").write_text("v 0 0 1\n")  # no longer than it was
    assert made_of(SOURCES["arm"], tmp_path) != before
    prepared("arm", folder, tmp_path)
    assert calls == [1, 1, 1]


def test_a_motion_has_the_given_number_of_frames_and_a_seed(folder) -> None:
    character = prepared("gingerbread-2d", folder, None)
    first, again, other = (motion_of("gingerbread-2d", character, None, frames=7, seed=seed) for seed in (0, 0, 1))
    assert len(first) == 7
    np.testing.assert_array_equal(first.B, again.B)
    assert np.abs(first.B - other.B).max() > 0.01
