import pytest

from nilbs.io import FileFormatError
from nilbs.io.bone_map import read_bone_map, write_bone_map


def test_round_trip(tmp_path):
    bone_map = {"arm.L": "Arm_L", "Füße": "脚", "jaw": None, "hand": "Arm_L"}
    write_bone_map(tmp_path / "map.json", bone_map, ["jaw", "tail", "arm.L"])
    assert read_bone_map(tmp_path / "map.json") == ({**bone_map, "tail": None}, {})


def test_options_stand_beside_the_bones(tmp_path):
    (tmp_path / "map.json").write_text('{"arm.L": "Arm_L", "--rest-frame": 3, "--up": "-z"}')
    assert read_bone_map(tmp_path / "map.json") == ({"arm.L": "Arm_L"}, {"--rest-frame": 3, "--up": "-z"})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[]", "a bone map is one object"),
        (b'{"--rest-frame": "3"}', "--rest-frame must be a whole number"),
        (b'{"--rest-frame": true}', "--rest-frame must be a whole number"),
        (b'{"--up": 2}', "--up must be an axis"),
        (b'{"a": 3}', "'a' must follow a bone, by name, or null"),
        (b'{"a": ["b"]}', "'a' must follow a bone"),
        (b'{"a": "b", "a": "c"}', "'a' stands twice in one object"),
        (b'{"a": "b"\n', ":2: this is no JSON"),
        (b"", "the file is empty"),
        (b"\xff\xfe", "this is no JSON"),
        (b"[" * 100_000, "nested too deep"),
    ],
)
def test_damaged_maps_are_refused(tmp_path, content, message):
    path = tmp_path / "map.json"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_bone_map(path)
    assert message in str(caught.value)
    assert "map.json" in str(caught.value)
