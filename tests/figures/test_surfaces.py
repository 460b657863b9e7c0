"""What lands on paper: pixels of bodies whose picture is known."""

import io

import numpy as np
import pytest
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import imread

from nilbs.figures.canvas import evenly_spaced, plain, sheet, write_png
from nilbs.figures.surfaces import draw_body, draw_bones
from nilbs.figures.views import View

BOX = (np.array([-1.0, -1.0]), np.array([1.0, 1.0]))


def drawn(draw) -> np.ndarray:
    """Pixels (rows from the top, columns, 3) of the square [-1, 1]^2 after draw(panel)."""
    figure, panels = sheet(1, 1, title="")
    panel = panels[0, 0]
    draw(panel)
    plain(panel, lower=BOX[0], upper=BOX[1])
    file = io.BytesIO()
    figure.savefig(file, format="png")
    image = imread(io.BytesIO(file.getvalue()))[..., :3]
    x0, y0, x1, y1 = panel.get_window_extent().extents.astype(int)
    return image[len(image) - y1 + 3 : len(image) - y0 - 3, x0 + 3 : x1 - 3]


def covered(image: np.ndarray) -> float:
    """The share of the pixels that are not white."""
    return float((image.min(axis=-1) < 0.99).mean())


def square(half: float, *, reverse: bool = False) -> tuple[np.ndarray, np.ndarray]:
    U = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    F = np.column_stack([np.arange(4), np.roll(np.arange(4), -1)])
    return U, F[:, ::-1] if reverse else F


def cube(half: float) -> tuple[np.ndarray, np.ndarray]:
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corner, np.array([[a, b, c] for a, b, c, _ in quads] + [[a, c, e] for a, _, c, e in quads])


def test_square_and_cube_cover_their_own_area():
    for U, F in (square(0.5), cube(0.5)):
        view = View(np.eye(U.shape[1]))
        assert covered(drawn(lambda panel, U=U, F=F, view=view: draw_body(panel, view, U, F))) == pytest.approx(
            0.25, abs=0.02
        )


def test_hole_stays_empty_and_an_overlap_is_filled():
    outer, inner = square(0.8), square(0.4, reverse=True)
    U, F = np.vstack([outer[0], inner[0]]), np.vstack([outer[1], inner[1] + 4])
    assert covered(drawn(lambda panel: draw_body(panel, View(np.eye(2)), U, F))) == pytest.approx(0.48, abs=0.04)
    # The same inner square the same way round is a body that overlaps itself: inside, where the winding number is 2.
    F[4:] = F[4:, ::-1]
    assert covered(drawn(lambda panel: draw_body(panel, View(np.eye(2)), U, F))) == pytest.approx(0.64, abs=0.03)


@pytest.mark.parametrize("order", [1, -1])
def test_nearer_surface_hides_the_farther_one(order):
    V, F = cube(0.5)
    U = np.vstack([0.5 * V + [0, 0, 2], V][::order])
    both = np.vstack([F, F + 8])
    values = np.repeat([1.0, 0.0][::order], 8)
    colours = ScalarMappable(Normalize(0, 1), "coolwarm")
    image = drawn(lambda panel: draw_body(panel, View(np.eye(3)), U, both, values=values, colours=colours))
    middle, side = image[len(image) // 2, image.shape[1] // 2], image[len(image) // 2, int(image.shape[1] * 0.3)]
    assert middle[0] > middle[2]  # the small cube in front is red
    assert side[2] > side[0]  # the large one behind it is blue


def test_open_sheet_is_seen_from_both_sides():
    U = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.0]])
    F = np.array([[0, 1, 2], [0, 2, 3]])
    front = drawn(lambda panel: draw_body(panel, View(np.eye(3)), U, F))
    back = drawn(lambda panel: draw_body(panel, View(np.eye(3)), U, F[:, ::-1]))
    assert covered(front) == pytest.approx(0.25, abs=0.02)
    np.testing.assert_allclose(front, back, atol=0.01)


def test_face_turned_to_the_light_is_brighter():
    U, F = cube(0.5)
    image = drawn(lambda panel: draw_body(panel, View(np.eye(3)).turned(azimuth=45, elevation=30), U, F))
    height, width = image.shape[:2]
    left, right = image[int(0.55 * height), int(0.35 * width)], image[int(0.55 * height), int(0.65 * width)]
    assert left.sum() > right.sum() > 0


def test_an_empty_surface_is_labelled_empty():
    for d in (2, 3):
        empty = np.empty((0, d)), np.empty((0, d), dtype=int)
        image = drawn(lambda panel, empty=empty, d=d: draw_body(panel, View(np.eye(d)), *empty))
        assert 0 < covered(image) < 0.1


@pytest.mark.parametrize("d", [2, 3])
def test_posed_bone_is_drawn_where_its_transform_takes_it(d):
    C = np.zeros((2, d))
    C[1, 0] = 0.8
    B = np.eye(d + 1)[None].copy()
    B[0, :2, :2] = [[0, -1], [1, 0]]  # a quarter turn: from the right to the top
    rest = drawn(lambda panel: draw_bones(panel, View(np.eye(d)), C, np.array([[0, 1]])))
    posed = drawn(lambda panel: draw_bones(panel, View(np.eye(d)), C, np.array([[0, 1]]), B=B))
    half = len(rest) // 2
    assert covered(rest[:, half + 20 :]) > 0
    assert covered(rest[: half - 20]) == 0
    assert covered(posed[: half - 20]) > 0
    assert covered(posed[:, half + 20 :]) == 0


def test_file_is_written_whole_or_not_at_all(tmp_path):
    figure, _ = sheet(1, 1, title="a figure")
    path = write_png(figure, tmp_path / "figure.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(OSError, match="missing"):
        write_png(figure, tmp_path / "missing" / "figure.png")
    assert [file.name for file in tmp_path.iterdir()] == ["figure.png"]


def test_frames_shown_do_not_repeat_the_first_pose_of_a_loop():
    assert evenly_spaced(100, 4) == [0, 25, 50, 75]
    assert evenly_spaced(1, 4) == [0]
