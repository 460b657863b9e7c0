import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

from nilbs.io import FileFormatError
from nilbs.io.npz import NpzFile
from nilbs.io.smpl import read_smpl


def body(rng, b=4, n=9):
    regressor = np.zeros((b, n))
    regressor[np.arange(b), np.arange(b)] = regressor[np.arange(b), np.arange(b) + 2] = 0.5
    weights = rng.dirichlet(np.ones(b), size=n)
    weights[weights < 0.1] = 0
    return {
        "v_template": rng.normal(size=(n, 3)),
        "f": rng.integers(0, n, size=(5, 3)).astype(np.uint32),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 0], [0, 1, 2, 3]]),
    }


@pytest.fixture
def smpl(tmp_path):
    def read(arrays):
        path = tmp_path / "body.npz"
        path.unlink(missing_ok=True)
        np.savez(path, **arrays)
        return read_smpl(path)

    return read


def test_a_body(smpl, rng):
    arrays = body(rng)
    parts = smpl(arrays)
    V = arrays["v_template"]
    assert np.array_equal(parts.mesh.V, V)
    assert np.array_equal(parts.mesh.E, arrays["f"])
    assert np.array_equal(parts.influences.dense(9, 4, "a"), arrays["weights"])
    s = parts.skeleton
    assert s.names == ("joint0", "joint1", "joint2", "joint3")
    assert s.P.tolist() == [-1, 0, 1, 0]
    assert s.BE.tolist() == [[0, 1], [1, 2], [2, 2], [3, 3]]
    assert np.abs(s.C - [(V[j] + V[j + 2]) / 2 for j in range(4)]).max() < 1e-15
    assert parts.notes == ()


@pytest.mark.parametrize("kind", [np.int64, np.uint32, np.uint64, np.int32])
def test_roots_of_any_integer_type(smpl, rng, kind):
    table = np.array([[-1, 0, 1, -1], [0, 1, 2, 3]]).astype(kind)
    assert smpl({**body(rng), "kintree_table": table}).skeleton.P.tolist() == [-1, 0, 1, -1]


@pytest.mark.parametrize("table", [[[0, 0, 1, 3], [0, 1, 2, 3]], [[7, 7, 9, 6], [7, 9, 5, 6]]])
def test_a_root_may_be_its_own_parent(smpl, rng, table):
    assert smpl({**body(rng), "kintree_table": np.array(table)}).skeleton.P.tolist() == [-1, 0, 1, -1]


def test_joints_are_found_by_their_number(smpl, rng):
    table = np.array([[-1, 7, 9, 7], [7, 9, 5, 6]])
    assert smpl({**body(rng), "kintree_table": table}).skeleton.P.tolist() == [-1, 0, 1, 0]


@pytest.mark.parametrize("form", ["csr", "csc", "J"])
def test_joints_in_every_form(smpl, rng, form):
    arrays = body(rng)
    C = smpl(arrays).skeleton.C
    regressor = arrays.pop("J_regressor")
    if form == "J":
        arrays["J"] = C
    else:
        sparse = scipy.sparse.csr_array(regressor).asformat(form)
        arrays |= {f"J_regressor_{part}": getattr(sparse, part) for part in ("data", "indices", "indptr", "shape")}
    assert np.abs(smpl(arrays).skeleton.C - C).max() < 1e-15


def test_correctives_are_left_out_and_noted(smpl, rng):
    arrays = body(rng) | {"posedirs": np.zeros((9, 3, 27)), "shapedirs": np.zeros((9, 3, 10))}
    parts = smpl(arrays | {"joint2num": np.array({"pelvis": 0}, dtype=object)})
    assert parts.notes == ("posedirs and shapedirs left out: the body bends by its weights alone, without correctives",)


def sparse(**changed):
    parts = {"data": [1.0] * 4, "indices": [0, 1, 2, 3], "indptr": [0, 1, 2, 3, 4], "shape": [4, 9]}
    return {"J_regressor": None} | {f"J_regressor_{name}": value for name, value in (parts | changed).items()}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"v_template": None},
            "the file holds no array v_template, but 'J_regressor', 'f', 'kintree_table', 'weights'",
        ),
        ({"J_regressor": None}, "the file holds no array J, but"),
        ({"v_template": np.eye(4)}, "v_template must be (any, 3), this file holds (4, 4)"),
        ({"v_template": np.zeros((0, 3))}, "v_template must be (any, 3), this file holds (0, 3)"),
        ({"weights": np.zeros((8, 4))}, "weights must be (9, any), this file holds (8, 4)"),
        ({"weights": np.zeros(9)}, "weights must be (9, any), this file holds (9,)"),
        ({"weights": np.zeros((9, 0))}, "weights must be (9, any)"),
        ({"J_regressor": np.zeros((4, 8))}, "J_regressor must be (4, 9)"),
        ({"J_regressor": np.full((4, 9), 1e308), "v_template": np.full((9, 3), 10)}, "the joints are farther apart"),
        ({"f": [[0, 1, 9]]}, "f holds 9, which is none of the 9 vertices"),
        ({"f": [[0, 1, -1]]}, "f holds -1"),
        ({"f": [[0, 1, 0.5]]}, "f holds 0.5"),
        ({"f": [[0, 1, np.nan]]}, "f holds a number that is not finite"),
        ({"kintree_table": np.zeros((2, 3))}, "kintree_table must be (2, 4)"),
        ({"kintree_table": [[-1, 0, 1, 8], [0, 1, 2, 3]]}, "kintree_table names the parent 8, which is no joint"),
        ({"kintree_table": [[-1, 0.5, 1, 0], [0, 1, 2, 3]]}, "kintree_table names the parent 0.5, which is no joint"),
        ({"kintree_table": [[-1, 2, 1, 0], [0, 1, 2, 3]]}, "kintree_table makes joint"),
        (
            {"weights": np.array([print], dtype=object)},
            "weights is not a plain array of numbers but a pickle, which is",
        ),
        (sparse(shape=[4, 8]), "J_regressor must be (4, 9)"),
        (sparse(indptr=[0, 1, 2, 4]), "J_regressor_indptr does not cut"),
        (sparse(indptr=[1, 1, 2, 3, 4]), "J_regressor_indptr does not cut"),
        (sparse(indptr=[0, 1, 2, 3, 3]), "J_regressor_indptr does not cut"),
        (sparse(indptr=[0, 3, 2, 3, 4]), "J_regressor_indptr does not cut"),
        (sparse(indptr=[0, 1, 2, 3, 5]), "J_regressor_indptr holds 5, which is none of the 5 ends of a row"),
        (sparse(indices=[0, 1, 2, 9]), "J_regressor_indices holds 9, which is none of the 9 vertices or joints"),
        (sparse(indices=[0, 1, 2]), "J_regressor_indices must be (4)"),
    ],
)
def test_wrong_bodies(smpl, rng, changed, message):
    arrays = {name: value for name, value in (body(rng) | changed).items() if value is not None}
    with pytest.raises(FileFormatError) as caught:
        smpl(arrays)
    assert f"body.npz: {message}" in str(caught.value)


@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(smpl, tmp_path, data):
    path = tmp_path / "body.npz"
    smpl(body(np.random.default_rng(0)))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        stop = at + data.draw(st.sampled_from([0, 1, 1, 8, 500]))
        content[at:stop] = data.draw(st.binary(max_size=8))
    path.unlink()
    path.write_bytes(content)
    message = None
    try:
        read_smpl(path)
    except FileFormatError as error:
        message = str(error)
    assert message is None or "body.npz: " in message


SHAPES = st.sampled_from([(0,), (1,), (4,), (2, 4), (4, 9), (9, 4), (9, 3), (4, 3), (3, 3, 3)])


@given(data=st.data())
def test_any_arrays_are_read_or_refused(smpl, data):
    arrays = body(np.random.default_rng(0)) | {name: value for name, value in sparse().items() if value is not None}
    for name in data.draw(st.lists(st.sampled_from(sorted(arrays)), max_size=3)):
        if data.draw(st.booleans()):
            arrays.pop(name, None)
        else:
            values = data.draw(st.sampled_from([0, 1, -1, 5, 1e308, np.inf, 2**63]))
            arrays[name] = np.full(data.draw(SHAPES), values, dtype=float)
    message = None
    try:
        parts = smpl(arrays)
    except FileFormatError as error:
        message = str(error)
    assert ("body.npz: " in message) if message else np.isfinite(parts.skeleton.C).all()


def test_names_in_an_archive_are_shown_safely(tmp_path):
    np.savez(tmp_path / "a.npz", **{"a\nb": np.eye(2)})
    with pytest.raises(FileFormatError, match=r"no array W, but 'a\\nb'"):
        NpzFile(tmp_path / "a.npz").array("W")
