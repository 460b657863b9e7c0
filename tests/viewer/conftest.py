"""Scenes with small bodies, and pages of them that a client talks to."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from nilbs.viewer.state import Body, Scene


@pytest.fixture
def body(models) -> Callable[..., Body]:
    """A body of a dimension, with a model of a few steps."""
    return lambda d, name="hero": Body(name, models[d], models[d].motion)


@pytest.fixture
def scene(body) -> Callable[..., Scene]:
    """A scene of one body of a dimension."""
    return lambda d=3, **how: Scene([body(d)], **how)


@pytest.fixture
def pages() -> Iterator[Callable]:
    """Pages of scenes on any free port; they end with the test."""
    pytest.importorskip("viser", reason="viser is not installed: pip install 'nilbs-geometry[view]'")
    from nilbs.viewer.page import Page

    opened = []

    def page(scene: Scene, **how):
        opened.append(Page(scene, port=0, **how))
        return opened[-1]

    yield page
    for one in opened:
        one.stop()


@pytest.fixture
def clients() -> Iterator[Callable]:
    """Clients of pages; they hang up with the test."""
    from benchmarks.viewer_client import Client

    opened = []

    def client(page, **how):
        opened.append(Client(page.server.get_port(), **how))
        return opened[-1]

    yield client
    for one in opened:
        one.close()


@pytest.fixture
def near() -> Callable[[np.ndarray, np.ndarray, float], bool]:
    """Whether points differ by at most 1e-5 of a length."""
    return lambda a, b, L: float(np.abs(a - b).max()) <= 1e-5 * L
