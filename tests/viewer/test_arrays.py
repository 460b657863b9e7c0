"""What layers show, as arrays: each against the model's own answers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from nilbs.characters.motion import load_motion
from nilbs.figures.views import View
from nilbs.geometry.distance import closest_points
from nilbs.viewer.colours import DISTANCE, GHOST, OCCUPANCY, Scale
from nilbs.viewer.meeting import Meetings, inside
from nilbs.viewer.picking import first_on_section, first_on_skin, roots
from nilbs.viewer.reconstruction import reconstruction
from nilbs.viewer.saving import mesh_file, pose_file, turntable
from nilbs.viewer.section import cut, plane
from nilbs.viewer.state import Body, PageFrame, Scene


def test_colours_between_and_beyond_the_ends():
    scale = Scale("gray", -1.0, 1.0)
    assert scale(np.array([-5.0, -1, 1, 5]))[:, 0].tolist() == [0, 0, 255, 255]
    assert scale(np.array([[np.nan, np.inf]])).tolist() == [[[128] * 3] * 2]
    assert "rgb(255,255,255)" in scale.bar()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("quantity", "scale"), [("occupancy", OCCUPANCY), ("distance", DISTANCE), ("ghost bone", GHOST)]
)
def test_colours_of_the_plane_are_those_of_the_field(models, d, quantity, scale):
    model = models[d]
    c, pose = model.character, model.motion[2]
    section = plane(PageFrame(c.center, c.L), 2, 0.05, edge=1.2, pixels=12)
    found = cut(model.posed(pose), section, quantity)
    picture = found.picture(scale)
    assert picture.shape == (12, 12, 3)
    right, up = section.view.axes[:2]
    for row, column in ((0, 0), (3, 7), (6, 5), (11, 11)):  # from the top left
        x = section.centre + section.edge * (((column + 0.5) / 12 - 0.5) * right - ((row + 0.5) / 12 - 0.5) * up)
        value = {
            "occupancy": lambda x: model.occupancy(x, pose),
            "distance": lambda x: model.distance(x, pose) / c.L,
            "ghost bone": lambda x: model.weights(x, pose)[:, -1],
        }[quantity](x[None])
        np.testing.assert_allclose(found.values[11 - row, column], value[0], atol=1e-5)
        assert np.abs(picture[row, column].astype(int) - scale(value)[0]).max() <= 1
    if d == 3:
        np.testing.assert_allclose((section.points() - c.center)[:, 2], 0.05 * c.L)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_planes_lie_across_their_axis(axis):
    section = plane(PageFrame(np.array([1.0, 2, 3]), 2.0), axis, 0.5, edge=1.0, pixels=4)
    np.testing.assert_allclose(section.points()[:, axis], [1, 2, 3][axis] + 1.0)
    assert np.linalg.det(section.view.axes) == pytest.approx(1)


@pytest.mark.parametrize("d", [2, 3])
def test_the_reconstruction_is_the_models_surface_with_its_error(models, d):
    model, pose = models[d], models[d].motion[2]
    found = reconstruction(model.posed(pose), 24)
    U, F = model.extract(pose, 24)
    np.testing.assert_array_equal(found.U, U)
    np.testing.assert_array_equal(found.F, F)
    c = model.character
    distance, _, _ = closest_points(c.skin(pose), c.F, U[:50])
    np.testing.assert_allclose(found.error[:50], distance / c.L, atol=1e-6)


def test_a_ray_meets_the_nearest_triangle():
    U = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    F = np.array([[0, 1, 2], [3, 4, 5]])
    down = np.array([0, 0, -2.0])
    assert first_on_skin(U, F, np.array([0.2, 0.2, 3.0]), down) == pytest.approx(1)
    assert first_on_skin(U, F, np.array([0.2, 0.2, 0.5]), down) == pytest.approx(0.25)
    assert first_on_skin(U, F, np.array([0.9, 0.9, 3.0]), down) == np.inf
    assert first_on_skin(U, F, np.array([0.2, 0.2, -1.0]), down) == np.inf


def test_a_ray_meets_the_square_of_a_plane():
    section = plane(PageFrame(np.zeros(3), 1.0), 2, 0.25, edge=1.0, pixels=4)
    assert first_on_section(section, np.array([0.4, 0, 1.25]), np.array([0, 0, -1.0])) == pytest.approx(1)
    assert first_on_section(section, np.array([0.6, 0, 1.25]), np.array([0, 0, -1.0])) == np.inf
    assert first_on_section(section, np.array([0.4, 0, 1.25]), np.array([0, 1.0, 0])) == np.inf


@pytest.mark.parametrize("d", [2, 3])
def test_roots_of_a_point_are_its_canonical_points(models, d, rng):
    model, pose = models[d], models[d].motion[2]
    posed, c = model.posed(pose), model.character
    for i in rng.choice(len(c.T), 5):
        x = posed.posed_points(c.V_volume[c.T[i]].mean(axis=0)[None])[0]
        found = roots(posed, x)
        assert len(found.x_rest)
        assert (found.residual < 1e-3).all()
        np.testing.assert_allclose(found.x_rest[0], posed.rest_points(x[None])[0], atol=1e-3 * c.L)
    far = roots(posed, c.skin(pose).max(axis=0) + 9 * c.L)
    assert far.x_rest.shape == (0, d)


def test_a_baseline_has_one_root_without_a_residual(body):
    one = body(3)
    pose = one.motion[2]
    x = one.character.skin(pose).mean(axis=0)
    found = roots(one.posed(pose, "nearest"), x)
    np.testing.assert_allclose(found.x_rest, one.posed(pose, "nearest").rest_points(x[None]))
    assert np.isnan(found.residual).all()


def test_bodies_meet_where_contacts_are(body):
    from nilbs.contacts.pairs import contacts

    a, b = body(3, "a"), body(3, "b")
    b.offset[1] = 0.2
    meetings, poses = Meetings((a, b)), (a.motion[2], b.pose(0.0))
    ((name, found),) = meetings.pairs(poses).items()
    expected = contacts(a.model, poses[0], b.model, poses[1])
    assert name == "a and b"
    assert len(found.point) == len(expected.point) > 0
    np.testing.assert_allclose(found.depth, expected.depth / a.character.L)
    assert set(meetings.themselves(poses)) == {"a and itself", "b and itself"}


def test_points_are_inside_one_body_or_the_other(body):
    a, b = body(3, "a"), body(3, "b")
    b.offset[1] = 5.0
    poses = (a.motion[0], b.pose(0.0))
    x = np.array([a.character.skin(poses[0]).mean(axis=0), b.character.skin(poses[1]).mean(axis=0), [9.0, 9, 9]])
    assert inside((a, b), poses, x, "search").tolist() == [True, True, False]


def test_a_saved_pose_is_a_motion(body, tmp_path):
    one = body(3)
    one.theta[1] = 0.1, 0.2, 0.3
    pose = one.pose(0.1)
    (tmp_path / "pose.json").write_bytes(pose_file(one, pose))
    np.testing.assert_allclose(load_motion(tmp_path / "pose.json", one.character.skeleton)[0], pose, atol=1e-9)


def test_a_saved_surface_is_the_mesh(models):
    import io

    import trimesh

    c = models[3].character
    glb = trimesh.load(io.BytesIO(mesh_file(c.V, c.F, ".glb")), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(glb.vertices, c.V, atol=1e-6)
    assert mesh_file(c.V, c.F, ".obj").count(b"\nf ") == len(c.F)
    with pytest.raises(ValueError, match=r"save it as \.obj"):
        mesh_file(c.V[:, :2], c.F[:, :2], ".glb")


def test_a_turntable_turns_and_keeps_its_size(models):
    import io

    from PIL import Image, ImageSequence

    from nilbs.figures.views import View

    c = models[3].character
    film = Image.open(io.BytesIO(turntable(c.V, c.F, View.front(c.V), pixels=48, turns=4)))
    frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]
    assert len(frames) == 4
    assert np.abs(frames[0].astype(int) - frames[1]).max() > 50
    rows = [np.ptp(np.flatnonzero((frame < 250).any(axis=(1, 2)))) for frame in frames]
    assert max(rows) < 47


def test_an_empty_surface_cannot_turn():
    with pytest.raises(ValueError, match="nothing to turn"):
        turntable(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), View(np.eye(3)))


def test_an_outline_is_no_glb():
    with pytest.raises(ValueError, match="outline"):
        mesh_file(np.eye(2), np.array([[0, 1]]), ".glb")


def test_bodies_of_one_name_are_numbered_and_their_contacts_kept(body):
    scene = Scene([body(2), body(2), body(2, "villain")])
    assert [one.name for one in scene.bodies] == ["hero 1", "hero 2", "villain"]
    assert len(Meetings(scene.bodies).themselves(scene.shot().poses)) == 3


def test_all_bodies_are_posed_at_one_time(body):
    """As `nilbs check` does, whenever the motion of another one begins."""
    a, b = body(3, "a"), body(3, "b")
    b.motion = replace(b.motion, times=b.motion.times + 0.05, curves=())
    scene = Scene([a, b])
    with scene.changing(moves=True):
        scene.player.time = 0.1
    for pose, one in zip(scene.shot().poses, (a, b), strict=True):
        np.testing.assert_array_equal(pose, one.motion.at(seconds=0.1))
    assert isinstance(json.loads(pose_file(a, scene.shot().poses[0])), dict)


def test_a_body_of_files_answers_by_nearest(characters, models):
    one = Body.of_character(characters[2], models[2].motion)
    assert one.posed(one.motion[0], "nearest").occupancy(one.character.V[:1]).shape == (1,)
