"""Which requests the page accepts: checked before a file is sent or a websocket is accepted."""

import hashlib
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from urllib.parse import parse_qs, urlsplit

# A page that is framed by another can be clicked without being seen.
HEADERS = {
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
LOOPBACK = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class Guard:
    """Refuses requests of other sites and, where the page is served to other machines, those without the token.

    Attributes
    ----------
    host : str
        The address that the page is served on.
    token : str or None
        What a request must bring, in its address or as a cookie.
    """

    host: str
    token: str | None

    @classmethod
    def of(cls, host: str) -> "Guard":
        """A guard with a new random token, without one where only this machine is served."""
        return cls(host, None if host.lower() in LOOPBACK else secrets.token_urlsafe(24))

    def refusal(self, path: str, headers: Mapping[str, str]) -> str | None:
        """Why a request is refused; None if it may pass.

        Parameters
        ----------
        path : str
            With the query.
        headers : mapping of str to str
            Whatever the case of their names is.

        Examples
        --------
        >>> guard = Guard("127.0.0.1", None)
        >>> guard.refusal("/", {"Host": "localhost:8080", "Origin": "http://elsewhere.org"})
        'a page of http://elsewhere.org may not use this one'
        >>> guard.refusal("/", {"Host": "localhost:8080"})
        """
        lower = {name.lower(): value for name, value in headers.items()}
        host, origin = lower.get("host", ""), lower.get("origin")
        if not self._may_be_called(_name(host)):
            return f"this page is not called {host!r}"
        if origin is None and ("upgrade" in lower or "sec-websocket-key" in lower):
            return "a websocket must state its origin"
        # A tunnel may end at another port, and a proxy may add encryption.
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return f"a page of {origin} may not use this one"
        if self.token is not None and not any(
            secrets.compare_digest(given.encode(), self.token.encode()) for given in self._tokens(path, lower)
        ):
            return "the token is missing or wrong: open the address that nilbs view printed"
        return None

    def headers(self) -> dict[str, str]:
        """Headers of every answer; with a token, the cookie that later requests bring."""
        if self.token is None:
            return HEADERS
        return HEADERS | {"Set-Cookie": f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"}

    @property
    def cookie(self) -> str:
        """The cookie's name, another one for each token: all ports of a host share its cookies."""
        return f"nilbs-view-{hashlib.sha256((self.token or '').encode()).hexdigest()[:8]}"

    def _tokens(self, path: str, headers: Mapping[str, str]) -> list[str]:
        """The tokens that a request brings, in its address and as a cookie."""
        given = [part.strip().partition("=") for part in headers.get("cookie", "").split(";")]
        return parse_qs(urlsplit(path).query).get("token", []) + [v for name, _, v in given if name == self.cookie]

    def _may_be_called(self, name: str) -> bool:
        """Whether a name in the browser's address bar may be ours; others may lead here (DNS rebinding)."""
        if self.token is None:
            return name in LOOPBACK
        if name == self.host.lower() or name in _own_names():
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def address(self, port: int) -> str:
        """What to open in a browser."""
        name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(self.host, self.host)
        name = f"[{name}]" if ":" in name else name
        return f"http://{name}:{port}/" + (f"?token={self.token}" if self.token else "")


def _name(host: str) -> str:
    """The name in a Host header, without the port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


@cache
def _own_names() -> frozenset[str]:
    """Names of this machine; the network may be asked for one, so only once."""
    return frozenset(name.lower() for name in (*LOOPBACK, socket.gethostname(), socket.getfqdn()))
