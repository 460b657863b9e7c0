from urllib.parse import urlsplit

import pytest

from nilbs.viewer.guard import Guard, _own_names

HERE = Guard("127.0.0.1", None)
THERE = Guard("0.0.0.0", "secret")


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:9000", "[::1]:8080", "LOCALHOST:1"])
def test_this_machines_own_names_pass(host):
    socket = {"Host": host, "Origin": f"http://{host}", "Upgrade": "websocket"}
    assert HERE.refusal("/", socket) is None
    assert HERE.refusal("/", {"host": host}) is None


@pytest.mark.parametrize(
    "host", ["evil.org", "127.0.0.1.evil.org:8080", "10.0.0.1:8080", "", "[", "localhost.evil.org"]
)
def test_another_name_that_leads_here_is_refused(host):
    assert "not called" in HERE.refusal("/", {"Host": host, "Origin": f"http://{host}"})


@pytest.mark.parametrize(
    "origin",
    ["http://evil.org", "http://localhost:3000", "null", "http://127.0.0.1:8080.evil.org", "http://localhost:8080"],
)
def test_pages_of_others_are_refused(origin):
    found = HERE.refusal("/", {"Host": "127.0.0.1:8080", "Origin": origin, "Upgrade": "websocket"})
    assert "may not use" in found


@pytest.mark.parametrize("name", ["Upgrade", "Sec-WebSocket-Key"])
def test_a_websocket_states_its_origin(name):
    assert "origin" in HERE.refusal("/", {"Host": "127.0.0.1:8080", name: "websocket"})


@pytest.mark.parametrize(
    ("path", "cookie", "passes"),
    [
        ("/?token=secret", "", True),
        ("/assets/a.js", f"{THERE.cookie}=secret", True),
        ("/", f"other=1; {THERE.cookie}=secret", True),
        ("/", "", False),
        ("/?token=", f"{THERE.cookie}=", False),
        ("/?token=wrong", f"{THERE.cookie}=Secret", False),
        ("/?token=s%C3%A9cret", "", False),
    ],
)
def test_other_machines_need_the_token(path, cookie, passes):
    headers = {"Host": "10.1.2.3:8080", "Origin": "http://10.1.2.3:8080", "Cookie": cookie}
    assert (THERE.refusal(path, headers) is None) == passes


def test_the_printed_name_passes_in_any_case(monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "MyMac.local")
    _own_names.cache_clear()
    try:
        host = urlsplit(THERE.address(8080)).netloc
        assert host == "MyMac.local:8080"
        assert THERE.refusal("/?token=secret", {"Host": host}) is None
    finally:
        _own_names.cache_clear()


def test_pages_on_other_ports_keep_their_cookies():
    other = Guard("0.0.0.0", "another")
    kept = dict(guard.headers()["Set-Cookie"].split(";")[0].split("=") for guard in (THERE, other))
    both = "; ".join(f"{name}={value}" for name, value in kept.items())
    for guard in (THERE, other):
        assert guard.refusal("/", {"Host": "10.1.2.3", "Cookie": f"bad={{}}; {both}"}) is None


def test_with_a_token_the_name_must_still_be_ours():
    assert "not called" in THERE.refusal("/?token=secret", {"Host": "evil.org"})


def test_only_this_machine_needs_no_token():
    assert Guard.of("127.0.0.1").token is None
    one, other = Guard.of("0.0.0.0"), Guard.of("0.0.0.0")
    assert len(one.token) >= 32
    assert one.token != other.token
    assert one.token in one.address(8080)
    assert Guard.of("::1").address(80) == "http://[::1]:80/"
