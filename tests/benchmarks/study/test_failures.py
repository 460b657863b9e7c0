"""Pictures of failures: they are written, and their captions report what happened in this run."""

import re

import numpy as np
import pytest
from matplotlib.image import imread

from benchmarks.study import failures
from benchmarks.study.failures import FINS, failure_figures, finned_bar, gingerbread_man
from benchmarks.study.twist import turned, twist_model, twist_row
from nilbs.characters.capsule import capsule
from nilbs.models.fitting import fit
from nilbs.models.model import Model

TINY = {"width": 16, "depth": 3, "poses_per_step": 4, "points_per_pose": 128, "samples_per_frame": 300}
GRIDS = {"cache_resolution": 48, "weight_resolution": 48}


@pytest.fixture(scope="module")
def fins() -> Model:
    bar = finned_bar()
    motion = turned(bar, 1, np.linspace(-40, 40, 5))
    return fit(bar, motion, steps=20, device="cpu", **TINY, cache_resolution=256, weight_resolution=128)


def test_three_figures_with_titles_and_captions(tmp_path, monkeypatch, fins):
    monkeypatch.setattr(failures, "PIXELS", 60)
    monkeypatch.setattr(failures, "FIN_PIXELS", 80)
    man = gingerbread_man()
    swing = turned(man, failures.ARM, [0.0, -90.0])
    slender = capsule(length=1.0, radius=0.08, resolution=16)
    models = {
        "capsule": twist_model(slender, steps=20, device="cpu", **TINY, **GRIDS),
        "gingerbread": fit(man, swing, steps=20, device="cpu", method="paper", **TINY, **GRIDS),
        "fins": fins,
    }
    figures = failure_figures(tmp_path / "new", models=models, resolution=32)
    assert [path.name for *_, path in figures] == ["candy-wrapper.png", "self-contact.png", "thin-parts.png"]
    for title, caption, path in figures:
        assert title
        assert re.search(r"\d", caption)
        picture = imread(path)
        assert min(picture.shape[:2]) > 300
        assert picture[..., :3].std() > 0.05
    for degrees in failures.TWISTS:
        sentence = figures[0][1].partition(f"Twisted by {degrees:g}°")[2].partition("bones' inverses")
        printed = [float(number) for number in re.findall(r"(\d+\.\d)%", sentence[0] + sentence[2].split(". ")[0])]
        row = twist_row(models["capsule"], degrees, resolution=32)
        volumes = [row["lbs"], *(row["lbs"] * row[name] for name in ("inverse", "search", "reverse"))]
        np.testing.assert_allclose(printed, 100 * np.array(volumes), atol=0.051)


def test_a_caption_counts_points_covered_once_and_twice():
    times = np.array([0, 0, 1, 1, 1, 1, 2, 2])
    inside = np.array([0, 1, 1, 1, 1, 0, 1, 0], dtype=bool)
    printed = failures._contact_words("map", times, inside)
    assert re.findall(r"[\d.]+%", printed) == ["75.0%", "50.0%", "50.00%"]  # once, twice; 3 wrong ones of 6


def test_models_that_are_not_given_are_trained(tmp_path, monkeypatch, fins):
    drawn, trained = [], []
    monkeypatch.setattr("nilbs.characters.capsule.capsule", lambda **_: "capsule")
    monkeypatch.setattr(failures, "gingerbread_man", lambda: "man")
    monkeypatch.setattr(failures, "turned", lambda *_: "motion")
    for name in ("_candy_wrapper", "_self_contact", "_thin_parts"):
        monkeypatch.setattr(failures, name, lambda model, *_: drawn.append(model) or ("", "", tmp_path))
    monkeypatch.setattr(failures, "twist_model", lambda character, **settings: trained.append(settings) or character)
    monkeypatch.setattr(
        "nilbs.models.fitting.fit", lambda character, motion, **settings: trained.append(settings) or character
    )
    failure_figures(tmp_path, models={"fins": fins}, seed=5, steps=7, width=9)
    assert drawn == ["capsule", "man", fins]
    assert trained == [{"width": 9, "steps": 7, "seed": 5, "progress": False}] * 2


def test_fins_have_their_thickness_and_stand_apart():
    bar = finned_bar()
    np.testing.assert_allclose(bar.L, 1)
    bases = [failures._fin_base(fin) for fin in range(len(FINS))]
    widths = np.diff(bases, axis=1)[:, 0] / np.hypot(1, failures.SLANT)
    np.testing.assert_allclose(widths, FINS)
    assert all(low > high for (low, _), (_, high) in zip(bases[1:], bases[:-1], strict=True))
    area = 0.5 * np.sum(bar.V[bar.F[:, 0], 0] * bar.V[bar.F[:, 1], 1] - bar.V[bar.F[:, 0], 1] * bar.V[bar.F[:, 1], 0])
    expected = failures.BAR_HEIGHT + failures.FIN_HEIGHT * np.hypot(1, failures.SLANT) * sum(FINS)
    assert area == pytest.approx(expected)
    np.testing.assert_allclose(bar.V[:, 1].max(), failures.FIN_HEIGHT)


def test_a_fin_thinner_than_the_caches_finest_cell_is_lost_and_a_thick_one_is_found(fins):
    pose = turned(fins.character, 1, [-40.0])[0]
    found = []
    for fin in (0, len(FINS) - 1):
        low, high = failures._fin_base(fin)
        height = np.linspace(0.02, 0.18, 200)
        middle = np.column_stack([(low + high) / 2 + failures.SLANT * height, height])
        weights = failures._bar_weights(middle)
        posed = np.einsum("nb,bij,nj->ni", weights, pose, np.column_stack([middle, np.ones(200)]))[:, :2]
        found.append(np.mean(fins.occupancy(posed, pose) > 0.5))
    assert found[0] < 0.6
    assert found[1] > 0.98
