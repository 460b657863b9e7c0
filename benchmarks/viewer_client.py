"""A browser without a screen: it talks to the page as viser's own does, and keeps what it hears."""

import threading
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

Message = dict[str, Any]
# What is looked for in a message; None if it is not there.
Wanted = Callable[[Message], Any]
CAMERA: Message = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 2), "look_at": (0, 0, 0), "up_direction": (0, 1, 0)}
CAMERA |= {"image_height": 480, "image_width": 640, "fov": 1.0, "near": 0.01, "far": 100.0}


def decoded(raw: bytes) -> list[Message]:
    """The messages of one frame, arrays in their places."""
    size, packed = (int.from_bytes(raw[k : k + 8], "little") for k in (0, 8))
    text = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
    found = msgspec.msgpack.decode(text)
    at, buffers = 16 + packed, list[bytes]()
    for length in found["binaryBufferLengths"]:
        at += -at % 8
        buffers.append(raw[at : at + length])
        at += length

    def filled(value: Any) -> Any:
        if isinstance(value, dict) and "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], dtype=value["dtype"])
        if isinstance(value, dict):
            return {name: filled(part) for name, part in value.items()}
        return [filled(part) for part in value] if isinstance(value, list | tuple) else value

    return [filled(message) for message in found["messages"]]


class Client:
    """A connection to a page; `heard` holds the messages so far."""

    def __init__(self, port: int, *, path: str = "/", origin: str | None = None, **headers: str) -> None:
        host = f"127.0.0.1:{port}"
        self.socket = connect(
            f"ws://{host}{path}",
            origin=Origin(origin or f"http://{host}"),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            additional_headers=headers,
            max_size=None,
            compression=None,
        )
        self.heard: list[Message] = []
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self.send("ViewerCameraMessage", **CAMERA)  # without it a page does not listen

    def send(self, kind: str, **values: Any) -> None:
        """Send a message."""
        self.socket.send(msgspec.msgpack.encode({"type": kind, **values}))

    def _listen(self) -> None:
        try:
            for raw in self.socket:
                assert isinstance(raw, bytes)
                messages = decoded(raw)
                with self._news:
                    self.heard += messages
                    self._news.notify_all()
        except OSError:
            pass

    def wait_for(self, wanted: Wanted, *, since: int = 0, seconds: float = 60.0) -> Any:
        """The last message since a number for which `wanted` returns something, and what it returned."""
        found: list[Any] = []

        def there() -> bool:
            found[:] = [result for message in self.heard[since:] if (result := wanted(message)) is not None]
            return bool(found)

        with self._news:
            assert self._news.wait_for(there, timeout=seconds), f"nothing came within {seconds:g} s"
            return found[-1]

    def set(self, handle: Any, value: Any) -> None:
        """Move an input of the page as a user does."""
        self.send("GuiUpdateMessage", uuid=handle._impl.uuid, updates={"value": value})

    def click(self, handle: Any) -> None:
        """Click a button."""
        self.set(handle, True)

    def close(self) -> None:
        """Hang up."""
        self.socket.close()
        self._thread.join()


def vertices(name: str) -> Wanted:
    """Of a message, new vertices of a mesh."""

    def wanted(message: Message) -> Any:
        if message.get("name") == name and message["type"] == "SceneNodeUpdateMessage":
            return message["updates"].get("vertices")
        return None

    return wanted
