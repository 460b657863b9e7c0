"""Pages as a browser hears them, without one."""

import http.client

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed: pip install 'nilbs-geometry[view]'")

from websockets.exceptions import InvalidStatus

from benchmarks.viewer_client import vertices
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.viewer.posing import turned
from nilbs.viewer.reconstruction import Reconstruction
from nilbs.viewer.state import Body, Scene


@pytest.mark.parametrize("d", [2, 3])
def test_a_slider_moves_the_vertices_to_the_skin_of_the_pose(scene, pages, clients, near, d):
    page = pages(scene(d))
    client = clients(page)
    client.wait_for(lambda message: True if message.get("name") == "/skin/0" else None)
    before = len(client.heard)
    for degrees in (10.0, 20.0, 35.0):
        client.set(page.bones.angles[-1], degrees)
    body = page.scene.bodies[0]
    theta = np.zeros_like(body.theta)
    theta[0, -1] = np.radians(35.0)
    pose = turned(body.character.skeleton, body.motion[0], theta)
    expected = linear_blend_skinning(body.V, body.W, pose)
    if d == 3:
        np.testing.assert_array_equal(expected, body.character.skin(pose))

    def there(message):
        U = vertices("/skin/0")(message)
        return (
            True
            if U is not None and near(page.scene.frame.back(U.reshape(-1, 3)), expected, body.character.L)
            else None
        )

    assert client.wait_for(there, since=before)


def test_a_clip_plays_and_pauses(scene, pages, clients, near):
    page = pages(scene())
    client = clients(page)
    client.click(page.playing.play)
    wait = page.scene.wait
    version = page.scene.shot().version
    for _ in range(5):
        version = wait(after=version).version
    assert page.scene.player.playing
    client.click(page.playing.play)
    while page.scene.player.playing:
        version = wait(after=version).version
    body = page.scene.bodies[0]
    expected = body.character.skin(body.motion.at(seconds=page.scene.player.time))
    assert page.scene.player.time > 0

    def there(message):
        U = vertices("/skin/0")(message)
        return (
            True
            if U is not None and near(page.scene.frame.back(U.reshape(-1, 3)), expected, body.character.L)
            else None
        )

    assert client.wait_for(there)


def heard(handle, text: str):
    """Of a message, the content of a note that holds a text."""

    def wanted(message):
        if message.get("uuid") == handle._handle._impl.uuid and message["type"] == "GuiUpdateMessage":
            content = message["updates"].get("content", "")
            return content if text in content else None
        return None

    return wanted


@pytest.mark.parametrize("d", [2, 3])
def test_layers_draw_what_they_are_asked_for(scene, pages, clients, d):
    page = pages(scene(d, points=np.zeros((4, d))))
    client = clients(page)
    client.set(page.surface.resolution, 16)
    client.set(page.surface.visible, True)
    client.wait_for(heard(page.surface.note, "facets in"))
    client.set(page.weights.visible, True)
    client.wait_for(heard(page.weights.note, "weights of"))
    client.set(page.cutting.quantity, "distance")
    client.set(page.cutting.visible, True)
    client.wait_for(heard(page.cutting.note, "distance of hero"))
    client.set(page.rest.visible, True)
    client.set(page.contacts.themselves, True)
    client.wait_for(heard(page.contacts.note, "hero and itself"))
    client.set(page.rest.picking, True)
    page.rest.pick(np.array([0.0, 0, 5]), np.array([0.0, 0, -1]))
    client.wait_for(heard(page.rest.note, "by search"))
    names = {str(message.get("name")) for message in client.heard}
    assert any(name.startswith("/plane/") for name in names)
    assert {"/surface/0", "/weights", "/rest/skin", "/picked/posed", "/points"} <= names


def test_an_empty_surface_is_said_to_be_empty(scene, pages, clients, monkeypatch):
    none = Reconstruction(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros(0))
    monkeypatch.setattr("nilbs.viewer.panels.surface.reconstruction", lambda *_: none)
    page = pages(scene())
    client = clients(page)
    client.set(page.surface.visible, True)
    client.wait_for(heard(page.surface.note, "empty"))


def test_a_body_of_fewer_bones_is_chosen(models, pages, monkeypatch):
    """Body and bone change together: what draws never sees a bone of another body."""
    many, few = Body("many", models[3], models[3].motion), Body("few", models[3], models[3].motion)
    page = pages(Scene([many, few]))
    last = len(many.character.skeleton.BE) - 1
    page.stage.selection = 0, last
    page.bones.body.value = page.bones.body.options[1]
    seen = []
    monkeypatch.setattr(page.bones, "_filter", lambda: seen.append(page.stage.selection))
    page.bones._choose_body()
    assert seen == [(1, 0)]


def test_the_hint_to_click_is_shown(scene, pages, clients):
    page = pages(scene())
    client = clients(page)
    client.set(page.rest.picking, True)
    client.wait_for(heard(page.rest.note, "click on the skin"))


def test_a_row_that_the_model_lacks_is_reported(scene, pages, clients):
    one = scene()
    one.bodies[0].model.parameters, kept = {}, one.bodies[0].model.parameters
    try:
        page = pages(one)
        client = clients(page)
        client.set(page.cutting.quantity, "distance")
        client.set(page.cutting.row, "mlp")
        client.set(page.cutting.visible, True)
        client.wait_for(heard(page.cutting.note, "no row"))
    finally:
        one.bodies[0].model.parameters = kept


def test_names_of_bones_are_no_code(scene, pages, clients):
    page = pages(scene())
    client = clients(page)
    client.set(page.bones.search, "<img src=x onerror=alert(1)>")
    content = client.wait_for(heard(page.bones.note, "no bone"))
    assert "<img" not in content
    assert "&lt;img" in content


def test_bones_are_searched_by_name(scene, pages, clients):
    page = pages(scene())
    client = clients(page)
    client.set(page.bones.search, "ONE2")
    client.wait_for(lambda m: m.get("updates", {}).get("options"))
    while page.stage.bone != 2:
        page.scene.wait(after=page.scene.shot().version - 1)
    assert page.bones.bone.options == ("bone2",)


def test_a_page_of_its_own_holds_the_scene(scene, pages):
    page = pages(scene())
    content = page.saving.page()
    assert content.startswith(b"<!doctype html>")
    assert b"__VISER_EMBED_DATA__=" in content


@pytest.mark.parametrize("origin", ["http://evil.org", "http://localhost:1", "null"])
def test_a_websocket_of_another_site_is_refused(scene, pages, clients, origin):
    page = pages(scene())
    with pytest.raises(InvalidStatus) as refused:
        clients(page, origin=origin)
    assert refused.value.response.status_code == 403
    assert not page.server.get_clients()


def answer(page, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page.server.get_port(), timeout=30)
    try:
        connection.putrequest("GET", path, skip_host=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        found = connection.getresponse()
        return found.status, dict(found.getheaders()), found.read()
    finally:
        connection.close()


def test_files_of_the_page_alone_are_sent_and_under_our_name_alone(scene, pages):
    page = pages(scene())
    status, headers, content = answer(page, Host="localhost:1")
    assert (status, headers["X-Frame-Options"]) == (200, "DENY")
    assert content.startswith(b"<!doctype html>")
    assert answer(page, Host="evil.org")[0] == 403
    assert answer(page, "/../../../../etc/passwd", Host="localhost")[0] == 404
    assert answer(page, "/%2e%2e/%2e%2e/pyproject.toml", Host="localhost")[0] == 404


def test_another_address_needs_the_token(scene, pages, clients):
    page = pages(scene(), host="0.0.0.0")
    token, port = page.guard.token, page.server.get_port()
    own = f"127.0.0.1:{port}"
    assert answer(page, Host=own)[0] == 403
    status, headers, _ = answer(page, f"/?token={token}", Host=own)
    assert status == 200
    cookie = headers["Set-Cookie"].split(";")[0]
    assert "HttpOnly" in headers["Set-Cookie"]
    with pytest.raises(InvalidStatus):
        clients(page)
    client = clients(page, Cookie=cookie)
    client.wait_for(lambda message: True if message.get("name") == "/skin/0" else None)


def test_no_tunnel_from_the_internet_can_be_asked_for(scene, pages):
    from viser import _messages

    page = pages(scene())
    handlers = page.server._websock_server._incoming_handlers
    assert _messages.GuiUpdateMessage in handlers
    assert _messages.ShareUrlRequest not in handlers


def test_a_port_in_use_is_refused(scene, pages):
    from nilbs.viewer import server
    from nilbs.viewer.guard import Guard

    page = pages(scene())
    with pytest.raises(OSError, match="choose others with --host and --port"):
        server.start(Guard.of("127.0.0.1"), page.server.get_port())


def test_a_viser_that_cannot_be_guarded_is_not_used(monkeypatch):
    from contextlib import contextmanager

    from nilbs.viewer import server
    from nilbs.viewer.guard import Guard

    @contextmanager
    def unguarded(guard):
        yield []

    monkeypatch.setattr(server, "_guarded", unguarded)
    with pytest.raises(RuntimeError, match="cannot be guarded"):
        server.start(Guard.of("127.0.0.1"), 0)
