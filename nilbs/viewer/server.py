"""A server of viser behind a guard."""

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rich
import viser
import websockets.asyncio.server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from nilbs.viewer.guard import Guard

Process = Callable[[ServerConnection, Request], Response | None]


def start(guard: Guard, port: int) -> viser.ViserServer:
    """Serve a page at the guard's address.

    Parameters
    ----------
    guard : Guard
    port : int
        0 for any that is free.

    Raises
    ------
    OSError
        If this machine has no such address, or the port is in use: viser would try the next, or all others.
    RuntimeError
        If viser starts its server in another way than expected, so that requests would not be checked.
    """
    _check_free(guard.host, port)
    with _quiet(), _guarded(guard) as passed:
        server = viser.ViserServer(guard.host, port, label="nilbs", verbose=False)
    if not passed:
        server.stop()
        raise RuntimeError(f"viser {viser.__version__} cannot be guarded: install the version of the extra view")
    # A page must not open a tunnel from the internet to here.
    try:
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(message)
    except BaseException:
        server.stop()
        raise
    return server


def stop(server: viser.ViserServer) -> None:
    """End it."""
    with _quiet():
        server.stop()


def _check_free(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except OSError as error:
            reason = f"{host}: port {port} cannot be used ({error.strerror})"
            raise OSError(f"{reason}: choose others with --host and --port") from None


def checked(guard: Guard, inner: Process) -> Process:
    """Answer as `inner` those requests that the guard lets pass."""

    def process(connection: ServerConnection, request: Request) -> Response | None:
        reason = guard.refusal(request.path, dict(request.headers.raw_items()))
        response = inner(connection, request) if reason is None else connection.respond(403, f"{reason}\n")
        if response is not None:
            for name, value in guard.headers().items() if reason is None else ():
                response.headers[name] = value
        return response

    return process


@contextmanager
def _guarded(guard: Guard) -> Iterator[list[bool]]:
    """Let servers that are started meanwhile check each request first; the list is filled when one was."""
    original, passed = websockets.asyncio.server.serve, []

    def serve(*args: Any, process_request: Process, **how: Any) -> Any:
        passed.append(True)
        return original(*args, process_request=checked(guard, process_request), **how)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield passed
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser from printing: standard output is the command's."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
