import igl
import numpy as np
import pytest
from PIL import Image

from nilbs.models.model import load_model


def test_depth_normals_and_canonical_points(assets, succeeds, tmp_path):
    path, picture = tmp_path / "bar.npz", tmp_path / "bar.png"
    words = ("--frame", 1, "--pixels", 64, "--azimuth", 20)
    found = succeeds("render", assets / "bar3.nilbs", *words, "-o", path, picture)
    model = load_model(assets / "bar3.nilbs")
    c, pose = model.character, model.motion[1]
    U = model.skinning.posed(pose)
    with np.load(path, allow_pickle=False) as file:
        depth, normal, canonical, axes, lower, upper = (
            file[name] for name in ("depth", "normal", "canonical", "axes", "lower", "upper")
        )
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    met = np.isfinite(depth)
    assert found["covered"] == met.mean()
    assert 0.03 < met.mean() < 0.9
    # Back from pixels to places: on the skin, and where the canonical points go.
    k = (np.arange(64) + 0.5) / 64
    across, high = np.meshgrid(lower[0] + k * (upper[0] - lower[0]), upper[1] - k * (upper[1] - lower[1]))
    x = across[..., None] * axes[0] + high[..., None] * axes[1] + ((U @ axes[2]).max() - depth)[..., None] * axes[2]
    squared, _, _ = igl.point_mesh_squared_distance(x[met], U, c.F)
    assert np.sqrt(squared).max() < 3e-4 * c.L
    assert ((normal[met] * axes[2]).sum(axis=1) > -0.1).mean() > 0.98
    on_rest, _, _ = igl.point_mesh_squared_distance(canonical[met], c.V, c.F)
    assert np.sqrt(on_rest).max() < 1e-6 * c.L
    with Image.open(picture) as image:
        pixels = np.asarray(image)
    np.testing.assert_array_equal((pixels < 255).any(axis=2), met)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bar2.nilbs", "-o", "out.png"], "this model is flat"),
        (["bar3.nilbs", "-o", "out.png", "more.png"], "at most one .png and one .npz"),
        (["bar3.nilbs", "-o", "out.jpg"], "out.jpg: the file name must end in .png or .npz"),
    ],
)
def test_mistakes(assets, fails, tmp_path, words, message):
    words = [assets / word if word.endswith(".nilbs") else word if word == "-o" else tmp_path / word for word in words]
    assert message in fails("render", *words, "--frame", 0)
    assert list(tmp_path.iterdir()) == []
