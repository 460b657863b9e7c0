"""A bar of two bones, flat and solid, as files; and a model of it that was hardly trained."""

import json

import numpy as np
import pytest

from nilbs.app.main import main
from nilbs.io import write_mesh, write_tgf, write_weights
from nilbs.methods.registry import method_of

QUICK = {"cache_resolution": 16, "samples_per_frame": 100, "points_per_pose": 32, "poses_per_step": 2, "width": 8}


def make_bar(d):
    """Vertices and triangles of a bar 4 long and 1 thick along x, its joints and its bones."""
    nx, ny = 9, 3
    x, y = np.meshgrid(np.linspace(0, 4, nx), np.linspace(0, 1, ny), indexing="ij")
    node = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, e = node[:-1, :-1].ravel(), node[1:, :-1].ravel(), node[1:, 1:].ravel(), node[:-1, 1:].ravel()
    V, T = np.stack([x.ravel(), y.ravel()], axis=1), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, e], 1)])
    C = np.array([[0.25, 0.5, 0.0], [2.1, 0.5, 0.0], [3.75, 0.5, 0.0]])
    BE = np.array([[0, 1], [1, 2]])
    if d == 2:
        return V, T, C, BE
    # The flat bar below and above, and walls around.
    n = len(V)
    below, above = np.hstack([V, np.full((n, 1), -0.5)]), np.hstack([V, np.full((n, 1), 0.5)])
    outline = np.concatenate([node[:, 0], node[-1, 1:], node[-2::-1, -1], node[0, -2:0:-1]])
    after = np.roll(outline, -1)
    walls = np.concatenate([np.stack([outline, after, after + n], 1), np.stack([outline, after + n, outline + n], 1)])
    return np.concatenate([below, above]), np.concatenate([T[:, ::-1], T + n, walls]), C, BE


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Networks this small only wait for each other on several threads, and long where the machine is busy."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def coarse(coarse_volumes):
    """What commands print and write is tested here, not how exact weights are."""


@pytest.fixture
def bar():
    return make_bar


@pytest.fixture(params=[2, 3])
def d(request):
    return request.param


@pytest.fixture(scope="session")
def assets(tmp_path_factory):
    """Folder with, for d = 2 and 3, bar<d>.obj, bar<d>-weights.npz and a barely trained bar<d>.nilbs; and bar.tgf."""
    from nilbs.characters.bundle import load_character
    from nilbs.characters.motion import random_motion
    from nilbs.models.fitting import fit

    folder = tmp_path_factory.mktemp("assets")
    for d in (2, 3):
        V, E, C, BE = make_bar(d)
        write_mesh(folder / f"bar{d}.obj", V, E)
        write_tgf(folder / "bar.tgf", C, BE)
        write_weights(folder / f"bar{d}-weights.npz", np.stack([V[:, 0] < 2, V[:, 0] >= 2], axis=1).astype(float))
        files = (folder / f"bar{d}.obj", folder / "bar.tgf", folder / f"bar{d}-weights.npz")
        character = load_character(*files)
        model = fit(character, random_motion(character, frames=3), steps=2, device="cpu", **QUICK)
        model.save(folder / f"bar{d}.nilbs")
    return folder


@pytest.fixture
def quick_settings(monkeypatch):
    """Let every training use grids and batches that take no time."""
    patch_methods(monkeypatch, QUICK)


@pytest.fixture
def quick_training(monkeypatch):
    """The same, with only a step or two."""
    patch_methods(monkeypatch, QUICK | {"steps": 2})


def patch_methods(monkeypatch, sizes):
    """Give methods other defaults, as far as they have them."""

    def quick(method, **settings):
        chosen = method_of(method, **settings)
        return method_of(
            chosen,
            **{
                s.name: sizes[s.name]
                for s in chosen.settings()
                if s.name in sizes and getattr(chosen, s.name) == s.default
            },
        )

    monkeypatch.setattr("nilbs.models.fitting.method_of", quick)


@pytest.fixture
def nilbs(capsys):
    """Run a command; return its status, standard output and standard error."""

    def run(*words):
        status = main(list(map(str, words)))
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def succeeds(nilbs):
    """Run a command with --json; return the object that it printed, alone on standard output."""

    def run(*words):
        status, out, err = nilbs(*words, "--json")
        assert status == 0, err
        assert out.count("\n") == 1
        return json.loads(out)

    return run


@pytest.fixture
def fails(nilbs):
    """Run a command that a user got wrong; return its one line."""

    def run(*words):
        status, out, err = nilbs(*words)
        assert (status, out) == (2, "")
        assert err.startswith("nilbs: error: ")
        assert err.count("\n") == 1
        return err.removeprefix("nilbs: error: ").rstrip("\n")

    return run
