import numpy as np
import pytest

from nilbs.geometry.nearest_names import alike_names, nearest_name
from nilbs.geometry.retargeting import followed_bones
from nilbs.geometry.skeleton import Skeleton
from nilbs.io.bundle import Mesh, select_group
from nilbs.io.motion import read_motion_json
from nilbs.io.rignet import read_rignet
from nilbs.methods.registry import method_of
from nilbs.race.runner import _chosen

ARM = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))


def test_the_most_alike_comes_first_whatever_the_case() -> None:
    assert alike_names("LOWR", ["upper", "flower", "lower"]) == ["lower", "flower"]


def test_a_word_of_a_name_is_enough() -> None:
    assert nearest_name("wlak", ["Run", "Armature|Walk_01"]) == " (the nearest: 'Armature|Walk_01')"


@pytest.mark.parametrize("names", [[], ["", "_"], ["upper", "lower"]])
def test_nothing_is_named_where_nothing_is_alike(names: list[str]) -> None:
    assert nearest_name("q", names) == nearest_name("", names) == ""


def test_long_and_many_names_are_cut() -> None:
    assert nearest_name("b" * 10**7, ["a" * 10**7, "b" * 10**7]) == f" (the nearest: {'b' * 80!r})"
    assert nearest_name("bone", ["x"] * 2000 + ["bone"]) == ""


def motion_of_another_bone(folder) -> None:
    (folder / "wave.json").write_text('{"frames": [{"lowr": 3}]}')
    read_motion_json(folder / "wave.json", ARM.names, 2)


def joint_of_no_line(folder) -> None:
    (folder / "rig.txt").write_text("joints hips 0 0 0\njoints knee 0 1 0\nroot hips\nhier hips kne\n")
    read_rignet(folder / "rig.txt")


@pytest.mark.parametrize(
    ("look_up", "meant"),
    [
        (lambda folder: followed_bones(ARM, ARM, {"uper": "upper"}), "upper"),
        (lambda folder: followed_bones(ARM, ARM, {"upper": "Lowwer"}), "lower"),
        (lambda folder: select_group(Mesh(np.eye(3), np.array([[0, 1, 2]]), {"body": np.array([0])}), "bdoy"), "body"),
        (motion_of_another_bone, "lower"),
        (joint_of_no_line, "knee"),
        (lambda folder: method_of("nasaa"), "nasa"),
        (lambda folder: method_of("nasa", widht=8), "width"),
        (lambda folder: method_of("nilbs", encoding="locl"), "local"),
        (lambda folder: method_of("nilbs").check_mapping("serach"), "search"),
        (lambda folder: _chosen(["Opne3D"]), "Open3D"),
    ],
)
def test_an_error_names_the_nearest(look_up, meant: str, tmp_path) -> None:
    with pytest.raises(ValueError, match=rf"\(the nearest: '{meant}'\)"):
        look_up(tmp_path)
