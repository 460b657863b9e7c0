"""Root search where all canonical points are known: in a rod that is bent until it lies on itself."""

from functools import partial

import numpy as np
import pytest
import torch

from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import LocalEncoding
from nilbs.fields.fixed_point import fixed_point
from nilbs.fields.forward import ForwardField, packed_weights
from nilbs.fields.inverse_map import InverseField
from nilbs.fields.network import WeightNetwork
from nilbs.fields.newton import newton
from nilbs.fields.overlap import APART, NEAR, Overlap
from nilbs.fields.search import ITERATIONS, SEARCHES, Found, Search, SearchField
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices

HALF, RADIUS = (
    0.5,
    0.08,
)  # half length and radius of a rod along the first axis, with a bone on either side of the origin
BLEND = 0.1  # length over which one bone's weights give way to the other's


def weights(x_rest: np.ndarray) -> np.ndarray:
    second = np.clip(x_rest[:, 0] / BLEND + 0.5, 0, 1)
    return np.stack([1 - second, second], axis=1)


def distance(x_rest: np.ndarray) -> np.ndarray:
    along = x_rest.copy()
    along[:, 0] -= np.clip(along[:, 0], -HALF + RADIUS, HALF - RADIUS)
    return np.linalg.norm(along, axis=1) - RADIUS


def rod(d: int) -> SearchField:
    """A rod with exact grids and a network that was never trained."""
    torch.manual_seed(1)
    box = np.array([[-HALF] + [-RADIUS] * (d - 1), [HALF] + [RADIUS] * (d - 1)])
    fine, grid = Grid.box(box, 100, pad=0.1), Grid.box(box, 60, pad=0.1)
    cache = RestCache.of_grid(
        torch.as_tensor(distance(fine.points()).reshape(fine.shape)), torch.as_tensor(fine.origin), fine.spacing,
        width=0.003,
    )  # fmt: skip
    packed = packed_weights(np.arange(grid.size), weights(grid.points()), grid.shape)
    arrays = {name: torch.as_tensor(array) for name, array in packed.items()}
    forward = ForwardField(**arrays, origin=torch.as_tensor(grid.origin), spacing=grid.spacing)
    centers = torch.zeros((2, d))
    centers[0, 0] = -HALF
    network = WeightNetwork(LocalEncoding(centers), 2, width=8, depth=2)
    return SearchField(InverseField(network, cache, root=0), forward).double()


def bent(d: int, angle: float) -> torch.Tensor:
    """The second bone turned about the origin."""
    theta = np.zeros((2, 3 if d == 3 else 1))
    theta[1, -1] = angle
    return torch.as_tensor(rigid_transforms(rotation_matrices(theta), np.zeros((2, d))))


def posed_rigidly(x_rest: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
    """By one bone alone."""
    d = x_rest.shape[-1]
    return x_rest @ B[:d, :d].mT + B[:d, d]


def posed(x_rest: np.ndarray, B: torch.Tensor) -> np.ndarray:
    homogeneous = np.concatenate([x_rest, np.ones((len(x_rest), 1))], axis=1)
    d = x_rest.shape[1]
    return np.einsum("nb,bij,nj->ni", weights(x_rest), B.numpy()[:, :d], homogeneous)


def points(d: int, n: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (n, d)) * ([HALF] + [RADIUS] * (d - 1))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 0.8, -1.5])
def test_posed_points_of_the_rod_are_found_inside(d: int, angle: float, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, angle)
    x_rest = points(d, 2000, rng)
    x_rest = x_rest[np.abs(distance(x_rest)) > 0.003]
    inside = distance(x_rest) < 0
    # At the inner side of the bend the rod folds over itself: a point there has several canonical points.
    far = np.abs(x_rest[:, 0]) > 0.12
    x = torch.as_tensor(posed(x_rest, B))
    with torch.no_grad():
        answer = field.posed(B)(x)
    np.testing.assert_array_equal(answer.level.numpy()[far] < 0, inside[far])
    np.testing.assert_allclose(answer.x_rest.numpy()[far & inside], x_rest[far & inside], atol=1.5e-3)
    assert (answer.level.numpy() < 0)[inside].mean() > 0.99
    assert (answer.distance < 0).eq(answer.level < 0).all()


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_is_inside_if_one_of_its_canonical_points_is(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, np.pi - 0.25)
    # Both halves lie side by side and overlap near the bend: all of either is inside.
    x_rest = points(d, 4000, rng)
    x_rest = x_rest[(distance(x_rest) < -0.003) & (np.abs(x_rest[:, 0]) > 0.12)]
    with torch.no_grad():
        in_pose = field.posed(B)
        answer = in_pose(torch.as_tensor(posed(x_rest, B)))
    assert (answer.level < 0).all()
    assert in_pose.queries == len(x_rest)
    assert in_pose.evaluations < 20 * len(x_rest)
    # The forward map sends the canonical points back to the query.
    with torch.no_grad():
        again = field.forward_field.pose(answer.x_rest, in_pose.blends).x.numpy()
    np.testing.assert_allclose(again, posed(x_rest, B), atol=1e-3)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_far_away_is_inside(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, 2.0)
    x = torch.as_tensor(rng.uniform(1, 5, (500, d)))
    with torch.no_grad():
        answer = field.posed(B)(x)
    assert (answer.distance > 0.1).all()
    assert (answer.level > 0).all()


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_by_the_point_and_by_the_pose(d: int, rng: np.random.Generator) -> None:
    field = rod(d)
    B = bent(d, 0.7)
    x_rest = points(d, 200, rng)
    x_rest = x_rest[np.abs(distance(x_rest)) < 0.05][:12]
    x = torch.as_tensor(posed(x_rest, B))

    def answers(x: torch.Tensor, B: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        answer = field.posed(B)(x)
        return answer.distance, answer.x_rest

    assert torch.autograd.gradcheck(answers, (x.requires_grad_(), B.requires_grad_()), eps=1e-7, atol=1e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_each_part_at_a_place_is_found_once(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, np.pi)  # flat on itself
    in_pose = field.posed(B)
    near = posed(points(d, 300, rng)[:, :] * ([0.5] + [0.5] * (d - 1)), B)
    parts = in_pose.overlap(torch.as_tensor(near))
    found = ~parts.isnan().any(dim=-1)
    assert found[:, 0].all()
    # Every place found is posed to about the query, and parts lie apart.
    x = field.forward_field.pose(parts[found], in_pose.blends).x
    query = torch.as_tensor(near)[:, None].expand(-1, parts.shape[1], -1)[found]
    assert (x - query).norm(dim=-1).max() < np.sqrt(d) * in_pose.overlap.edge + 1e-9
    both = found[:, 1]
    assert both.double().mean() > 0.9
    assert ((parts[both, 0] - parts[both, 1]).norm(dim=-1) > APART * field.forward_field.spacing).all()
    assert in_pose.overlap(torch.full((3, d), 9.0, dtype=torch.float64)).isnan().all()


@pytest.mark.parametrize("d", [2, 3])
def test_the_first_part_found_is_the_deepest_of_its_cell(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, 0.0)
    overlap = field.posed(B).overlap
    x = torch.as_tensor(points(d, 20, rng))
    nodes = field.forward_field.nodes()[field.body]

    def cell(place: torch.Tensor) -> torch.Tensor:
        return ((place - overlap.origin) / overlap.edge).floor()

    for place, first in zip(x, overlap(x)[:, 0], strict=True):
        around = nodes[(cell(nodes) == cell(place)).all(dim=-1)]
        assert field.inverse.cache.distance(first[None]) == field.inverse.cache.distance(around).min()


@pytest.mark.parametrize("d", [2, 3])
def test_a_part_that_is_squeezed_into_a_cell_leaves_room_for_others(d: int) -> None:
    # The deepest piece of a rod is squeezed a hundredfold, and another piece begins at the same place.
    spacing = 0.01
    along = spacing * torch.arange(16, dtype=torch.float64)
    x_rest = torch.zeros((32, d), dtype=torch.float64)
    x_rest[:16, 0], x_rest[16:, 0] = along, 1 + along
    squeezed, kept = torch.eye(d, d + 1, dtype=torch.float64), torch.eye(d, d + 1, dtype=torch.float64)
    squeezed[0, 0], kept[0, d] = 0.01, -1
    blends = torch.cat([squeezed.expand(16, -1, -1), kept.expand(16, -1, -1)]).reshape(32, -1)
    found = Overlap(x_rest, blends, spacing)(torch.full((1, d), 1e-6, dtype=torch.float64))[0, :, 0]
    assert found[0] == 0
    assert (found >= 1).any()
    found = found[~found.isnan()]
    assert ((found[:, None] - found).abs() + torch.eye(len(found))).min() > NEAR * spacing


@pytest.mark.parametrize("d", [2, 3])
def test_a_body_thinner_than_a_cell_has_no_parts(d: int) -> None:
    empty = torch.zeros((0, d), dtype=torch.float64)
    overlap = Overlap(empty, torch.zeros((0, d * (d + 1)), dtype=torch.float64), 0.1)
    assert overlap(torch.zeros((2, d), dtype=torch.float64)).isnan().all()


FOLDED = 0.06


def fold(d: int, way: float, turn: float = 0.0) -> tuple[SearchField, torch.Tensor]:
    """A rod folded over itself, and its pose: x goes to x + way w(x) along it, w a tent about 0; then all is turned."""
    field = rod(d)
    grid, x = field.forward_field, field.forward_field.nodes().numpy()
    second = np.clip(1 - np.abs(x[:, 0]) / FOLDED, 0, 1)
    packed = packed_weights(np.arange(len(x)), np.stack([1 - second, second], axis=1), tuple(grid.row.shape))
    arrays = {name: torch.as_tensor(array) for name, array in packed.items()}
    moved = torch.eye(d + 1, dtype=torch.float64).repeat(2, 1, 1)
    moved[1, 0, d] = way
    forward = ForwardField(**arrays, origin=grid.origin, spacing=grid.spacing)
    return SearchField(field.inverse, forward).double(), bent(d, turn)[1] @ moved


@pytest.mark.parametrize("d", [2, 3])
def test_a_search_marks_roots_where_the_map_is_inside_out(d: int) -> None:
    field, B = fold(d, 0.1)
    x_rest = torch.zeros((4, d), dtype=torch.float64)
    x_rest[:, 0] = torch.tensor([-0.2, -0.03, 0.03, 0.2])  # only beyond the tent's top is its slope below -1
    blends = field.skinning.blends(B)
    x = field.skinning.pose(x_rest, blends).x
    found = newton(x, x_rest, field.skinning, blends, iterations=3)
    assert found.inverted.tolist() == [False, False, True, False]
    torch.testing.assert_close(found.x_rest, x_rest, atol=1e-6, rtol=0)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("way", "turn"), [(0.1, 0.0), (0.1, 1.0), (0.3, 2.0)])
@pytest.mark.parametrize("inside", [-1, 1])
def test_the_other_roots_beside_one_in_a_fold_are_found(
    d: int, way: float, turn: float, inside: int, monkeypatch
) -> None:
    field, B = fold(d, way, turn)
    in_pose = field.posed(B)
    x_rest = torch.zeros((9, d), dtype=torch.float64)
    x_rest[:, 0] = torch.linspace(0.01, 0.055, 9)  # in the fold: the search begins at the inverted root and stays there
    x = field.skinning.pose(x_rest, in_pose.blends).x
    monkeypatch.setattr(in_pose, "_first", lambda x: x_rest)
    # There are no parts; of the three roots only the one on one side is inside.
    monkeypatch.setattr(in_pose, "overlap", lambda x: torch.full((len(x), 1, d), torch.nan, dtype=x.dtype))
    side = {-1: lambda along: along < 0, 1: lambda along: along > FOLDED}[inside]
    monkeypatch.setattr(
        field.inverse.cache, "distance", lambda x: torch.where(side(x[..., 0]), -0.01, 0.01).to(x.dtype)
    )
    with torch.no_grad():
        answer = in_pose(x)
    assert (answer.distance < 0).all()
    torch.testing.assert_close(field.skinning.pose(answer.x_rest, in_pose.blends).x, x, atol=1e-6, rtol=0)
    monkeypatch.setattr(in_pose, "_beside", lambda root: [root])
    with torch.no_grad():
        assert (in_pose(x).distance > 0).all()


@pytest.mark.parametrize("d", [2, 3])
def test_places_beside_a_root_are_finite_where_the_blend_collapses(d: int) -> None:
    # Halfway between a bone and the same bone turned by a half turn the blend has no inverse.
    for in_pose in (
        rod(d).posed(bent(d, np.pi)),
        rod(d).posed(torch.cat([torch.eye(d + 1)[None], HALF_TURN[d][None]])),
    ):
        for beside in in_pose._beside(torch.zeros((2, d), dtype=torch.float64)):
            assert torch.isfinite(beside).all()


HALF_TURN = {
    2: torch.diag(torch.tensor([-1.0, -1, 1])).double(),
    3: torch.diag(torch.tensor([-1.0, -1, 1, 1])).double(),
}


@pytest.mark.parametrize("d", [2, 3])
def test_one_search_alone_misses_what_all_bones_find(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, np.pi - 0.25)
    x_rest = points(d, 2000, rng)
    x_rest = x_rest[(distance(x_rest) < -0.003) & (np.abs(x_rest[:, 0]) > 0.12)]
    x = torch.as_tensor(posed(x_rest, B))
    found, look_ups = {}, {}
    with torch.no_grad():
        for mapping in ("search", "one-search", "all-bones"):
            in_pose = field.posed(B, mapping)
            found[mapping] = (in_pose(x).level < 0).double().mean()
            look_ups[mapping] = in_pose.evaluations / in_pose.queries
    assert found["search"] == found["all-bones"] == 1
    assert found["one-search"] < 0.99
    assert 1 < look_ups["one-search"] <= ITERATIONS + 2  # one by the network
    assert 1 < look_ups["search"] < look_ups["all-bones"]


@pytest.mark.parametrize("d", [2, 3])
def test_a_search_from_all_bones_begins_at_every_bone_s_rigid_point(
    d: int, rng: np.random.Generator, monkeypatch
) -> None:
    field, B = rod(d), bent(d, np.pi - 0.25)
    x = torch.as_tensor(points(d, 100, rng))
    starts = []

    def spied(x: torch.Tensor, start: torch.Tensor, *args, **options):
        starts.append(start.clone())
        return newton(x, start, *args, **options)

    monkeypatch.setitem(SEARCHES, "all-bones", Search(bones=True, iterate=partial(spied, iterations=ITERATIONS)))
    with torch.no_grad():
        field.posed(B, "all-bones")(x)
    assert len(starts) == 2
    for bone, start in enumerate(starts):
        np.testing.assert_allclose(posed_rigidly(start, B[bone]), x, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_the_fixed_point_is_a_canonical_point_where_it_contracts(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, 0.3)
    x_rest = points(d, 500, rng)
    x = torch.as_tensor(posed(x_rest, B))
    start = torch.as_tensor(x_rest + 0.02 * rng.normal(size=x_rest.shape))
    blends = field.skinning.blends(B)
    residuals = [
        fixed_point(x, start, field.skinning, blends, iterations=n).residual.quantile(0.9).item() for n in (0, 2, 8, 30)
    ]
    assert residuals[0] > residuals[1] > residuals[2] > residuals[3]
    assert residuals[3] < 1e-9
    found = fixed_point(x, start, field.skinning, blends, iterations=30)
    assert found.evaluations == 31 * len(x)
    near = found.residual.numpy() < 1e-9
    assert near.mean() > 0.9
    again = field.forward_field.pose(found.x_rest, blends).x.numpy()
    np.testing.assert_allclose(again[near], x.numpy()[near], atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_the_answers_of_the_fixed_point_count_their_look_ups(d: int, rng: np.random.Generator) -> None:
    field, B = rod(d), bent(d, 0.1)
    in_pose = field.posed(B, "fixed-point")
    with torch.no_grad():
        answer = in_pose(torch.as_tensor(posed(points(d, 300, rng), B)))
    assert in_pose.evaluations == 22 * 300  # one by the network, 20 steps, one at the end
    assert answer.level.shape == (300,)
    assert (answer.distance < 0).eq(answer.level < 0).all()


@pytest.mark.parametrize("d", [2, 3])
def test_without_a_root_a_point_is_outside_by_the_smallest_residual(d: int, monkeypatch) -> None:
    field, B = rod(d), bent(d, 0.0)
    in_pose = field.posed(B)
    inner = torch.zeros((5, d), dtype=torch.float64)  # inside the body, whatever the network's weights are

    def nowhere(x: torch.Tensor, start: torch.Tensor) -> Found:
        inverted = torch.zeros(len(x), dtype=torch.bool)
        return Found(start.clone(), torch.full_like(x[:, 0], torch.inf), torch.full_like(x[:, 0], 0.3), inverted)

    monkeypatch.setattr(in_pose, "_search", nowhere)
    monkeypatch.setattr(in_pose, "_first", lambda x: x)
    with torch.no_grad():
        answer = in_pose(inner)
    torch.testing.assert_close(answer.distance, torch.full_like(answer.distance, 0.3))
    assert (answer.level > 0).all()


def test_an_unknown_mapping_is_no_other_one() -> None:
    with pytest.raises(KeyError, match="invers"):
        rod(2).posed(bent(2, 0.0), "invers")
