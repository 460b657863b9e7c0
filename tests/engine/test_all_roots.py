import numpy as np

from nilbs.characters.capsule import capsule
from nilbs.characters.motion import random_motion
from nilbs.engine.all_roots import all_roots
from nilbs.engine.unit_frame import UnitFrame, at_rest
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.models.fitting import fit

REACH = 0.015  # in L: how near a rest point lands


def test_roots_are_all_rest_places_that_skinning_sends_to_a_point(rng):
    # Its slow twin is a cloud of rest points, of which those count that land near a point.
    c = capsule(length=1.0, radius=0.15, resolution=32, d=2)
    model, s = fit(c, random_motion(c, frames=2), steps=0, device="cpu"), c.skeleton
    pose = forward_kinematics(s.C, s.BE, s.P, np.array([[0.0], [2.6]]))  # folded: its ends overlap
    frame = UnitFrame(c, pose)
    search = model.engine()(frame.B)
    corners = c.V_volume[c.T[rng.choice(len(c.T), 50_000)]]
    cloud = at_rest(c, np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), len(corners)), corners))
    images = search.images(cloud).astype(np.float64)
    joint, counts = at_rest(c, s.C[s.BE[1, 0]]), []
    chosen = rng.choice(len(cloud), 300)
    roots, distance = all_roots(search, frame.points_back(images[chosen]), frame.to_unit)
    for i, k in enumerate(chosen):
        landed = cloud[np.linalg.norm(images - images[k], axis=1) < REACH]
        if np.linalg.norm(landed - joint, axis=1).min() < 0.25:  # where the fold crushes it, many land in one place
            continue
        found, inside = roots[i][~np.isnan(distance[i])], roots[i][distance[i] < -2 * REACH]
        apart = np.linalg.norm(landed[:, None] - found[None], axis=2)
        assert apart.min(axis=1).max() < 3 * REACH
        if len(inside):
            assert np.linalg.norm(landed[:, None] - inside[None], axis=2).min(axis=0).max() < 3 * REACH
        counts.append(len(inside))
    assert counts.count(1) > 10
    assert counts.count(2) > 10


def test_points_far_away_have_no_roots(models):
    model = models[2]
    frame = UnitFrame(model.character, model.motion[1])
    roots, distance = all_roots(model.engine()(frame.B), np.full((3, 2), 50.0), frame.to_unit)
    assert roots.shape == (3, 0, 2)
    assert distance.shape == (3, 0)
