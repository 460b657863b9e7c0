"""The example at the end of each command's help runs as it stands, in a folder with the files that it names."""

import shlex
from importlib import import_module

import numpy as np
import pytest

from nilbs.app.main import COMMANDS
from nilbs.characters.character import Character
from nilbs.characters.motion import random_motion
from nilbs.characters.saving import save_character
from nilbs.io import write_mesh, write_tgf, write_weights
from nilbs.models.model import load_model

# They take minutes; the demo has tests of its own, and so has the benchmark.
LONG = ("demo", "benchmark")
# Fewer steps, points and cells, so that the others take seconds.
SHORTER = {
    "train": ["--steps", "0", "--frames", "20", "--cache-resolution", "16"],
    "evaluate": ["--points", "50", "--resolution", "8"],
    "check": ["--points", "200"],
    "clear": ["--points", "200"],
    "voxelize": ["--resolution", "8"],
    "extract": ["--resolution", "8"],
    "animate": ["--pixels", "32"],
    "render": ["--pixels", "32"],
    "view": ["--port", "0", "--seconds", "0.1"],
}


@pytest.fixture
def folder(assets, bar, tmp_path, monkeypatch):
    """Where a user has a rigged mesh and a model of it."""
    monkeypatch.chdir(tmp_path)
    V, F, C, BE = bar(3)
    write_mesh("hero.obj", V, F)
    write_tgf("hero.tgf", C, BE)
    model = load_model(assets / "bar3.nilbs")
    character: Character = model.character
    write_weights("hero-weights.npz", character.W)
    motion = random_motion(character, frames=20)
    save_character(character, "hero.glb", motion=motion)
    model.motion = motion
    model.save("hero.nilbs")
    np.save("points.npy", np.zeros((5, 3)))
    return tmp_path


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in LONG])
def test_an_example_runs(folder, nilbs, command):
    if command == "completion":
        pytest.importorskip("argcomplete")
    if command == "view":
        pytest.importorskip("viser", reason="viser is not installed: pip install 'nilbs-geometry[view]'")
    program, name, *words = shlex.split(import_module(f"nilbs.app.commands.{command}").EXAMPLE)
    assert (program, name) == ("nilbs", command)
    status, out, error = nilbs(command, *words, *SHORTER.get(command, []))
    assert status == 0, error
    assert out
    written = (
        words[words.index("-o") + 1 :]
        if "-o" in words
        else words[words.index("--out") + 1 :]
        if "--out" in words
        else []
    )
    for path in written:
        assert (folder / path).exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_help_ends_with_the_example(nilbs, capsys, command):
    with pytest.raises(SystemExit) as stop:
        nilbs(command, "--help")
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert text.endswith(f"example: {import_module(f'nilbs.app.commands.{command}').EXAMPLE}")
