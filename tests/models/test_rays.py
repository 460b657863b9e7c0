import igl
import numpy as np
import pytest

from nilbs.models.rays import first_hits, segments


@pytest.mark.parametrize("d", [2, 3])
def test_hits_are_those_of_the_mesh(models, rng, d) -> None:
    model = models[d]
    pose, c = model.motion[3], model.character
    U = model.posed(pose).U
    middle, size = (U.min(axis=0) + U.max(axis=0)) / 2, c.L
    origin = middle + 2 * size * (lambda v: v / np.linalg.norm(v, axis=1, keepdims=True))(rng.normal(size=(400, d)))
    direction = middle + rng.uniform(-0.5, 0.5, (400, d)) * size - origin
    hits = first_hits(model, origin, direction, pose)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    true = np.array([crossing(o, u, U, c.F) for o, u in zip(origin, unit, strict=True)])
    agree = np.isclose(hits.t, true, atol=2e-3 * size) | (np.isinf(hits.t) & np.isinf(true))
    assert agree.mean() > 0.99  # all but rays that graze the skin
    assert 50 < np.isfinite(true).sum() < 390
    met = np.isfinite(hits.t)
    np.testing.assert_allclose(hits.point[met], (origin + hits.t[:, None] * unit)[met], atol=3e-4 * size)
    np.testing.assert_allclose(np.linalg.norm(hits.normal[met], axis=1), 1)
    assert ((hits.normal * unit).sum(axis=1)[met] < 0.2).mean() > 0.98  # the near side
    rest, posed = c.V[c.F[hits.facet[met]]], U[c.F[hits.facet[met]]]
    assert (hits.facet[~met] == -1).all()
    assert np.isnan(hits.x_rest[~met]).all()
    if d == 3:
        inside = igl.barycentric_coordinates(hits.point[met], *(np.ascontiguousarray(posed[:, k]) for k in range(3)))
        np.testing.assert_allclose(hits.x_rest[met], np.einsum("nc,ncd->nd", inside, rest), atol=1e-6)


def crossing(origin: np.ndarray, unit: np.ndarray, U: np.ndarray, F: np.ndarray) -> float:
    """The first crossing of a ray with edges or triangles: a loop over none, all at once."""
    a = U[F[:, 0]]
    columns = [U[F[:, k]] - a for k in range(1, U.shape[1])]
    M = np.stack([*columns, np.broadcast_to(-unit, a.shape)], axis=2)
    good = np.abs(np.linalg.det(M)) > 1e-14
    s = np.linalg.solve(M[good], (origin - a[good])[..., None])[..., 0]
    t = s[:, -1][(s[:, :-1] >= 0).all(axis=1) & (s[:, :-1].sum(axis=1) <= 1) & (s[:, -1] > 0)]
    return float(t.min(initial=np.inf))


def test_segments_end_and_rays_may_begin_inside(models) -> None:
    model = models[3]
    pose = np.tile(np.eye(4), (3, 1, 1))  # the capsule about x, radius 0.25
    up, down = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]
    hits = first_hits(
        model, [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 1]], [down, down, up, up], pose, far=np.array([0.7, 0.8, 1, 9])
    )
    np.testing.assert_allclose(hits.t, [np.inf, 0.75, 0, np.inf], atol=5e-3)
    with pytest.raises(ValueError, match=r"direction\[1\] is zero"):
        first_hits(model, np.zeros((2, 3)), np.array([[1.0, 0, 0], [0, 0, 0]]), pose)
    assert len(first_hits(model, np.empty((0, 3)), np.empty((0, 3)), pose).t) == 0


@pytest.mark.parametrize("d", [2, 3])
def test_segments_are_rays_of_their_length(models, rng, d) -> None:
    model, pose = models[d], models[d].motion[2]
    start, end = rng.uniform(-1.5, 1.5, (2, 200, d)) * model.character.L
    end[0] = start[0]
    found = segments(model, start, end, pose)
    length = np.linalg.norm(end - start, axis=1)
    rays = first_hits(model, start[1:], (end - start)[1:], pose)
    np.testing.assert_array_equal(found.t[1:], np.where(rays.t <= length[1:], rays.t, np.inf))
    assert 5 < np.isfinite(found.t).sum() < 195
    middle = pose[0, :d, :d] @ model.character.V.mean(axis=0) + pose[0, :d, d]
    point = segments(model, middle[None], middle[None], pose)
    assert point.t.tolist() == [0.0 if model.occupancy(middle[None], pose)[0] > 0.5 else np.inf]
    with pytest.raises(ValueError, match="end must be"):
        segments(model, start, end[1:], pose)
