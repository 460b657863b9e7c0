"""Every figure, drawn from models with a known picture: a perfect one and wrong ones."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from nilbs.characters.character import Character
from nilbs.characters.gingerbread import gingerbread
from nilbs.characters.motion import random_motion
from nilbs.figures import figure_files, ghost_figure, reconstruction_figure, write_figures
from nilbs.figures.canvas import FALSE_INSIDE, FALSE_OUTSIDE
from nilbs.figures.training import running_median
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy
from nilbs.methods.nearest import Nearest
from nilbs.methods.nilbs import Nilbs

NAMES = ["notation.png", "weights.png", "ghost.png", "training.png", "reconstruction.png"]


def two_bones(d: int) -> Character:
    """The gingerbread man with weights that pass from one bone to the other over a few hundredths of its height."""
    V, E, _, _ = gingerbread(d)
    F = E
    if d == 2:
        edges = {tuple(edge) for edge in E[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
        F = np.array([edge for edge in sorted(edges) if edge[::-1] not in edges])
    C = np.pad([[0.0, -0.3], [0.0, 0.0], [0.0, 0.4]], ((0, 0), (0, d - 2)))
    upper = 1 / (1 + np.exp(-V[:, 1] / 0.03))
    W = np.column_stack([1 - upper, upper])
    BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])
    return Character("man", V, F, Skeleton(C, BE, P, ("low", "high")), W, V, np.empty((0, d + 1), dtype=int), W)


class Truth:
    """A model that answers with the skinned mesh itself."""

    def __init__(self, d: int) -> None:
        self.character = two_bones(d)
        self.motion = random_motion(self.character, frames=4, seed=1)
        self.history = np.exp(-np.arange(200) / 50)
        self.method = Nilbs()
        self.parameters = {"of a network": np.zeros(1)}

    def posed(self, pose: np.ndarray) -> np.ndarray:
        return linear_blend_skinning(self.character.V, self.character.W, pose)

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        return occupancy(self.posed(pose), self.character.F, x).astype(float)

    def weights(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        return np.tile([0.5, 0.5, 0.0], (len(x), 1))

    def extract(self, pose: np.ndarray, resolution: int = 128) -> tuple[np.ndarray, np.ndarray]:
        return self.posed(pose), self.character.F


class Inverted(Truth):
    """A model whose every answer is wrong without the ghost bone, and which finds no surface."""

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        return super().occupancy(x, pose) if ghost else 1 - super().occupancy(x, pose)

    def extract(self, pose: np.ndarray, resolution: int = 128) -> tuple[np.ndarray, np.ndarray]:
        return np.empty((0, self.character.d)), np.empty((0, self.character.d), dtype=int)


def share(path, colour: str) -> float:
    """The share of a picture's pixels that have a colour."""
    return float((np.abs(imread(path)[..., :3] - to_rgb(colour)).max(axis=-1) < 0.02).mean())


@pytest.mark.parametrize("d", [2, 3])
def test_all_figures_are_written_in_order(d, tmp_path):
    paths = write_figures(Truth(d), tmp_path / "new" / "folder")
    assert [path.name for path in paths] == NAMES
    for path in paths:
        image = imread(path)
        assert min(image.shape[:2]) > 300
        assert image[..., :3].std() > 0.05


def test_a_model_without_a_network_has_no_figures_of_one():
    model = Truth(2)
    model.parameters = {}
    assert figure_files(model) == [name for name in NAMES if name not in ("weights.png", "ghost.png")]


def test_figures_without_data_are_not_drawn(tmp_path):
    baseline = Truth(2)
    baseline.method, baseline.history = Nearest(), np.zeros(0)
    paths = write_figures(baseline, tmp_path, resolution=16)
    assert [path.name for path in paths] == ["notation.png", "reconstruction.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notation.png", "reconstruction.png"]


@pytest.mark.parametrize("d", [2, 3])
def test_ghost_figure_colours_only_what_is_wrong(d, tmp_path):
    perfect = ghost_figure(Truth(d), tmp_path / "perfect.png")
    wrong = ghost_figure(Inverted(d), tmp_path / "wrong.png")
    keys = 0.002  # the legend's own patches
    assert share(perfect, FALSE_INSIDE) < keys
    assert share(perfect, FALSE_OUTSIDE) < keys
    assert share(wrong, FALSE_INSIDE) > 0.1
    assert share(wrong, FALSE_OUTSIDE) > 0.015


def test_ghost_figure_chooses_the_frame_that_changes_most(tmp_path):
    class OneFrame(Truth):
        def occupancy(self, x, pose, *, mapping=None, ghost=True):
            inside = super().occupancy(x, pose)
            return 1 - inside if not ghost and np.array_equal(pose, self.motion[2]) else inside

    assert share(ghost_figure(OneFrame(2), tmp_path / "chosen.png"), FALSE_INSIDE) > 0.1
    model = OneFrame(2)
    given = ghost_figure(model, tmp_path / "given.png", pose=model.motion[1], label="frame 1")
    assert share(given, FALSE_INSIDE) < 0.002


@pytest.mark.parametrize("d", [2, 3])
def test_empty_reconstruction_is_drawn_as_empty(d, tmp_path):
    model = Inverted(d)
    path = reconstruction_figure(model, tmp_path / "empty.png", poses={"a": model.motion[0]})
    assert imread(path)[..., :3].std() > 0.05  # the true surface is still there


def test_given_surfaces_are_not_extracted_again(tmp_path):
    class Unwilling(Truth):
        def extract(self, pose, resolution=128):
            raise AssertionError("extracted again")

    model = Unwilling(2)
    surfaces = {"a": (model.posed(model.motion[0]), model.character.F)}
    reconstruction_figure(model, tmp_path / "a.png", poses={"a": model.motion[0]}, surfaces=surfaces)
    with pytest.raises(AssertionError, match="extracted again"):
        reconstruction_figure(model, tmp_path / "b.png", poses={"b": model.motion[0]}, surfaces=surfaces)


def test_no_pose_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="poses is empty"):
        reconstruction_figure(Truth(2), tmp_path / "a.png", poses={})


def test_running_median_against_a_loop(rng):
    values = rng.normal(size=31)
    at, median = running_median(values, 5)
    for k, (where, value) in enumerate(zip(at, median, strict=True)):
        assert where == k + 3  # steps count from 1
        assert value == sorted(values[k : k + 5])[2]
