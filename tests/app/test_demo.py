"""The demo, reduced: it writes every file that it names, and they hold what they should."""

import functools
import json

import pytest

from nilbs.app.main import main
from nilbs.io.mesh import read_mesh
from nilbs.io.weights import read_weights
from nilbs.models.fitting import fit

SMALL = ["--frames", "3", "--steps", "4", "--points", "200", "--resolution", "16"]
GRIDS = {"cache_resolution": 32, "weight_resolution": 32, "samples_per_frame": 400}
PICTURES = ["notation.png", "weights.png", "ghost.png", "training.png", "reconstruction.png"]


@pytest.mark.usefixtures("coarse_volumes")
@pytest.mark.parametrize(
    ("dim", "stem", "as_json"), [(2, "gingerbread", True), pytest.param(3, "cookie", False, marks=pytest.mark.slow)]
)
def test_demo_goes_from_nothing_to_scores_and_pictures(dim, stem, as_json, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("nilbs.models.fitting.fit", functools.partial(fit, **GRIDS))
    out = tmp_path / "new" / "folder"
    assert main(["demo", "--dim", str(dim), "--out", str(out), *SMALL, *(["--json"] if as_json else [])]) == 0
    printed = capsys.readouterr()
    names = [f"{stem}.obj", "gingerbread.tgf", f"{stem}-weights.npz", f"{stem}.nilbs", "scores.json", "scores.txt"]
    assert sorted(path.name for path in out.iterdir()) == sorted(names + PICTURES)

    V, _ = read_mesh(out / f"{stem}.obj")
    assert V.shape[1] == dim
    assert read_weights(out / f"{stem}-weights.npz").shape == (len(V), 13)
    for name in PICTURES:
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    scores = json.loads((out / "scores.json").read_text())
    assert scores["points"] == 200
    assert set(scores["poses"]) == {"seen", "interpolated", "unseen", "far"}

    files = [str(out / name) for name in names + PICTURES]
    if as_json:
        shown = json.loads(printed.out)
        assert shown["files"] == files
        assert {name: shown[name] for name in scores} == scores
    else:
        assert "iou_surface" in printed.out
        assert (out / "scores.txt").read_text() in printed.out
        assert all(file in printed.out for file in files)
        assert "nilbs: training: " in printed.err


def test_demo_refuses_another_dimension(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["demo", "--dim", "4", "--out", str(tmp_path / "never")])
    assert stop.value.code == 2
    assert not (tmp_path / "never").exists()


def test_demo_names_a_folder_that_it_cannot_write(tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert main(["demo", "--out", str(tmp_path / "file"), *SMALL]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err
