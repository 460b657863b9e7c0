import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.io import FileFormatError, read_mesh
from nilbs.io.makehuman import read_mhskel, read_mhw, weights_file

V = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 0, 9.0]])


def skeleton():
    return {
        "bones": {
            "hand": {"head": "wrist", "tail": "tip", "parent": "arm", "reference": None},
            "arm": {"head": "shoulder", "tail": "wrist", "parent": None},
            "eye": {"head": "tip", "tail": "tip"},
        },
        "joints": {"shoulder": [0], "wrist": [1, 2], "tip": [3, 3, 0], "unused": [77]},
        "planes": {},
        "weights_file": "a.mhw",
    }


@pytest.fixture
def mhskel(tmp_path):
    def read(content):
        path = tmp_path / "a.mhskel"
        path.unlink(missing_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return read_mhskel(path, V)

    return read


@pytest.fixture
def mhw(tmp_path):
    def read(content, names=("arm", "hand", "eye")):
        path = tmp_path / "a.mhw"
        path.unlink(missing_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return read_mhw(path, names)

    return read


def test_joints_lie_at_means_of_vertices(mhskel):
    s = mhskel(skeleton())
    assert s.names == ("hand", "arm", "eye")
    assert s.C.tolist() == [[1, 1, 0], [0, 0, 6], [0, 0, 0]]
    assert s.BE.tolist() == [[0, 1], [2, 0], [1, 1]]
    assert s.P.tolist() == [1, -1, -1]


def changed(*keys, value):
    content = skeleton()
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", ": the file must be an object"),
        ("{}", ': "bones" must be an object'),
        (changed("joints", value=[]), ': "joints" must be an object'),
        (changed("bones", value={}), ": the rig has no bone"),
        (changed("bones", "arm", value=3), ": bone 'arm' must be an object"),
        (changed("bones", "arm", "head", value="nose"), ": bone 'arm' needs a head that is one of the joints"),
        (changed("bones", "arm", "tail", value=[0]), ": bone 'arm' needs a tail that is one of the joints"),
        (
            changed("bones", "arm", "parent", value="leg"),
            ": bone 'arm' needs a parent that is one of the bones, or null",
        ),
        (changed("bones", "arm", "parent", value=["eye"]), ": bone 'arm' needs a parent"),
        (changed("bones", "arm", "parent", value="hand"), "is its own ancestor"),
        (changed("bones", "arm", "parent", value="arm"), ": bone 'arm' is its own ancestor"),
        (changed("bones", "a\nb", value={}), ": the name 'a\\nb' holds characters that cannot be shown"),
        (changed("bones", "\ud800", value={}), ": this JSON cannot be used: "),
        (changed("joints", "wrist", value=[]), ": joint 'wrist' needs a list of vertices"),
        (changed("joints", "wrist", value=3), ": joint 'wrist' needs a list of vertices"),
        (changed("joints", "wrist", value=[1, True]), ": joint 'wrist' needs a list of vertices"),
        (
            changed("joints", "wrist", value=[1, 4]),
            ": joint 'wrist' needs vertex 4, but the mesh has 4: it must be the",
        ),
        (changed("joints", "wrist", value=[-1]), ": joint 'wrist' needs vertex -1"),
        (changed("joints", "wrist", value=[10**300]), ": joint 'wrist' needs vertex 1000"),
        ("{\n\n[", ":3: this is no JSON"),
        ("[" * 100_000, ": the JSON is nested too deep"),
    ],
)
def test_wrong_skeletons(mhskel, content, message):
    with pytest.raises(FileFormatError) as caught:
        mhskel(content)
    assert "a.mhskel:" in str(caught.value)
    assert message in str(caught.value)


def test_weights(mhw):
    content = {"weights": {"hand": [[0, 0.5], [2, 1], [2, 0.25]], "arm": [[1.0, -1]], "eye": []}, "version": 110}
    influences = mhw(content)
    assert influences.dense(3, 3, "a").tolist() == [[0, 0.5, 0], [-1, 0, 0], [0, 1.25, 0]]
    assert mhw({"weights": {}}).dense(1, 3, "a").tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("3", ": the file must be an object"),
        ("{}", ': "weights" must be an object'),
        ({"weights": {"leg": []}}, ": weights of bone 'leg', which the rig does not have"),
        ({"weights": {"arm": 3}}, ": bone 'arm' needs a list of pairs"),
        ({"weights": {"arm": [[0]]}}, ": bone 'arm' needs a list of pairs"),
        ({"weights": {"arm": [[0, "1"]]}}, ": bone 'arm' needs a list of pairs"),
        ({"weights": {"arm": [[-1, 1]]}}, ": bone 'arm' needs a list of pairs"),
        ({"weights": {"arm": [[0.5, 1]]}}, ": bone 'arm' needs a list of pairs"),
        ({"weights": {"arm": [[1e300, 1]]}}, ": bone 'arm' needs a list of pairs"),
        ('{"weights": {"arm": [[0, NaN]]}}', "NaN is not a finite number"),
    ],
)
def test_wrong_weights(mhw, content, message):
    with pytest.raises(FileFormatError) as caught:
        mhw(content)
    assert "a.mhw: " in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["a.mhw", "../a.mhw", "/etc/passwd", "", ".", "x\0", 3, None])
def test_only_a_file_beside_the_skeleton_is_named(tmp_path, name):
    (tmp_path / "rig").mkdir()
    path = tmp_path / "rig" / "a.mhskel"
    path.write_text(json.dumps({"weights_file": name}))
    (tmp_path / "a.mhw").touch()
    assert weights_file(path) is None
    (tmp_path / "rig" / "a.mhw").touch()
    assert weights_file(path) == (str(tmp_path / "rig" / "a.mhw") if name == "a.mhw" else None)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 5) | st.floats(allow_nan=False) | st.sampled_from(["arm", "wrist", ""]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["head", "arm"]), inner, max_size=3),
    max_leaves=5,
)


@given(data=st.data())
def test_any_json_is_read_or_refused(mhskel, mhw, data):
    content = skeleton()
    for _ in range(data.draw(st.integers(1, 3))):
        keys = [data.draw(st.sampled_from(["bones", "joints"]))]
        if isinstance(content[keys[0]], dict) and data.draw(st.booleans()):
            key = data.draw(st.sampled_from(["arm", "hand", "wrist", "new"]))
            content[keys[0]][key] = data.draw(VALUES)
        else:
            content[keys[0]] = data.draw(VALUES)
    for read, value in [(mhskel, content), (mhw, {"weights": data.draw(VALUES)})]:
        message = None
        try:
            read(value)
        except FileFormatError as error:
            message = str(error)
        assert message is None or "\n" not in message


def test_the_real_rig(data):
    base, _ = read_mesh(data / "makehuman" / "base.obj")
    path = data / "makehuman" / "default.mhskel"
    s = read_mhskel(path, base)
    assert s.C.shape == (326, 3)
    assert len(s.names) == 163
    assert (s.P < 0).sum() == 1
    assert weights_file(path) == str(data / "makehuman" / "default_weights.mhw")
    W = read_mhw(weights_file(path), s.names).dense(len(base), 163, path)
    assert (W.sum(axis=0) > 0).sum() == 139
    # Vertices lie, on the whole, near the bones that move them.
    middle = s.C[s.BE].mean(axis=1)
    moved = W.sum(axis=1) > 0
    far = np.linalg.norm(base[moved] - W[moved] @ middle / W[moved].sum(axis=1)[:, None], axis=1)
    assert np.median(far) < 0.05 * np.ptp(base[:, 1])
