import importlib.metadata
import subprocess
import sys

import numpy as np
import pytest

from nilbs.geometry.distance import signed_distance
from nilbs.models.fitting import fit
from nilbs.models.model import Model
from nilbs.race import contestants as module
from nilbs.race.contestants import DISTANCE, Kind, all_kinds, import_problem, missing, version
from nilbs.race.scenes import scenes

KINDS = all_kinds()
ON_GPU = ("nilbs on a GPU", "nilbs on a GPU, points there")


def test_names_are_distinct_and_nilbs_is_first():
    from nilbs.race import ours, peers

    assert len(KINDS) == len(ours.KINDS) + len(peers.KINDS)
    assert next(iter(KINDS)) == "nilbs"


@pytest.mark.parametrize("name", KINDS)
def test_answers_in_two_poses(models, name):
    kind, model = KINDS[name], models[3]
    # Some take part on a GPU, but compute the same without one.
    if name == "Warp":
        pytest.importorskip("warp")
    elif name in ON_GPU:
        pass
    elif problem := missing(kind, model):
        pytest.skip(problem)
    for quantity in kind.answers:
        if name in ("Warp", *ON_GPU):
            contestant = on_processor(kind.make, model, quantity)
        else:
            contestant = kind.make(model, quantity, 1)
        for scene in scenes(model, 400, "uniform", 2, 0, 1, seed=0):
            truth = signed_distance(model.character.skin(scene.B), model.character.F, scene.x)
            contestant.pose(scene.B)
            found = contestant.query(contestant.points(scene.x))
            assert found.shape == (400,)
            inside = found < 0 if quantity == DISTANCE else found
            wrong = (inside != (truth < 0)).mean()
            assert wrong < (0.1 if "network" in name else 0.02)  # the network was hardly trained
            if quantity == DISTANCE:
                error = np.abs(np.abs(found) - np.abs(truth)) / model.character.L
                assert np.median(error) < 1e-6
                assert error.max() < (0.1 if name == "mesdf" else 1e-5)


def on_processor(make, model, quantity):
    class OnProcessor(make):
        device = "cpu"

    return OnProcessor(model, quantity, 1)


def test_a_model_without_a_network_has_no_contestant_for_it(characters, models):
    model = models[3]
    without = Model(model.character, model.motion, model.method, np.zeros(0), {}, model.rest)
    assert missing(KINDS["nilbs, network alone"], model) is None
    assert missing(KINDS["nilbs, network alone"], without) == "the model has no network"
    nearest = fit(characters[3], model.motion, "nearest")
    assert missing(KINDS["nilbs, network alone"], nearest) == "the model has no network"
    assert missing(KINDS["nilbs"], nearest) is None


def test_torch_evaluates_the_field_and_leaves_the_model_alone(models):
    from nilbs.models.torch_field import TorchEngine

    contestant = KINDS["nilbs, torch"].make(models[3], "occupancy", 1)
    contestant.pose(models[3].motion[0])
    assert isinstance(contestant.posed._posed, TorchEngine)
    assert models[3].engine() is not None


def test_what_is_not_installed_is_named(models):
    gone = Kind("gone", ("occupancy",), KINDS["libigl"].make, "no_such_package", "no-such-distribution")
    assert missing(gone, models[3]) == "not installed: pip install no-such-distribution"


def test_a_crash_or_an_error_at_import_is_an_answer(tmp_path, monkeypatch):
    (tmp_path / "crashing.py").write_text("import os; os.abort()\n")
    (tmp_path / "failing.py").write_text("raise OSError('libusb is missing')\n")
    (tmp_path / "endless.py").write_text("import time; time.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert import_problem("json") is None
    assert import_problem("crashing") == "importing crashing crashes with signal 6"
    assert import_problem("failing") == "failing cannot be imported: OSError: libusb is missing"
    monkeypatch.setattr(module, "_PATIENCE", 0.5)
    assert import_problem("endless") == "importing endless takes more than 0.5 s"


def test_versions_are_those_of_distributions():
    import igl

    assert version(KINDS["libigl"]) == importlib.metadata.version("libigl")
    assert igl.__name__ == KINDS["libigl"].package
    assert version(KINDS["nilbs"]) != "unknown"


def test_making_the_list_imports_no_library():
    code = (
        "import sys; from nilbs.race.contestants import all_kinds; all_kinds();"
        "print(sorted({'open3d', 'embreex', 'mesdf', 'fcpw', 'warp', 'torch', 'igl'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\n", done.stderr
