"""How long the page of `nilbs view` takes from a slider to the posed mesh, beside an empty callback and plain skinning.

    python -m benchmarks.viewer_latency MODEL [--repeat 50]

A client on this machine stands for the browser: times are from what it sends to what it receives, without drawing.
"""

import argparse
import threading
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, sleep
from typing import Any

import numpy as np

from benchmarks.viewer_client import Client, vertices
from nilbs.models.model import load_model
from nilbs.viewer.page import Page
from nilbs.viewer.panels.panel import put
from nilbs.viewer.state import Body, Scene

FLOOD, SECONDS = 60.0, 3.0  # slider events a second, and for how long


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument("--repeat", type=int, default=50, metavar="N", help="measurements of each kind (default 50)")
    args = parser.parse_args()
    model = load_model(args.model)
    page = Page(Scene([Body(Path(args.model).stem, model, model.motion)]), port=0)
    client = Client(page.server.get_port())
    echo, reply = page.server.gui.add_slider("echo", 0.0, 1e6, 1.0, 0.0), page.server.gui.add_text("reply", "")

    @echo.on_update
    def _(event: Any) -> None:
        put(reply, str(event.target.value))
        page.server.flush()

    client.wait_for(lambda message: message if message.get("name") == "/skin/0" else None)
    pose = page.scene.shot().poses[0]

    def answered(message: dict[str, Any]) -> Any:
        return message.get("updates", {}).get("value") if message.get("uuid") == reply._impl.uuid else None

    angle = page.bones.angles[-1]
    rows = {
        "character.skin": timed(lambda i: model.character.skin(pose), args.repeat),
        "skinning of the engine": timed(lambda i: model.skinning.posed(pose), args.repeat),
        "empty callback, there and back": turns(client, echo, answered, 1.0, args.repeat),
        "slider to posed mesh": turns(client, angle, vertices("/skin/0"), 0.5, args.repeat),
    }
    for name, seconds in rows.items():
        print(f"{name:42} {1e3 * seconds:8.2f} ms")
    print(f"{'redraws while a slider moves':42} {redraws(client, angle):8.1f} a second")
    client.set(page.surface.visible, True)
    client.wait_for(lambda message: message if message.get("name") == "/surface/0" else None, seconds=600)
    busy = turns(client, angle, vertices("/skin/0"), 0.5, args.repeat)
    print(f"{'slider to posed mesh, surface following':42} {1e3 * busy:8.2f} ms")
    print(f"{'redraws, surface following':42} {redraws(client, angle):8.1f} a second")
    client.close()
    page.stop()


def timed(call: Callable[[int], Any], repeat: int) -> float:
    """The median of seconds that a call takes, after a first one."""
    found = []
    for i in range(repeat + 1):
        start = perf_counter()
        call(i)
        found.append(perf_counter() - start)
    return median(found[1:])


def turns(client: Client, slider: Any, wanted: Callable[[dict[str, Any]], Any], step: float, repeat: int) -> float:
    """The median of seconds from moving a slider to the message that is wanted."""

    def turn(i: int) -> None:
        since = len(client.heard)
        client.set(slider, step * (i + 1))
        client.wait_for(wanted, since=since)
        sleep(0.05)  # as between the events of a hand; it is taken off again

    return timed(turn, repeat) - 0.05


def redraws(client: Client, slider: Any) -> float:
    """Posed meshes a second that arrive while a slider moves."""
    since, stop = len(client.heard), threading.Event()

    def move() -> None:
        for i in range(int(FLOOD * SECONDS)):
            client.set(slider, float(90 * np.sin(i / 20)))
            sleep(1 / FLOOD)
        stop.set()

    start = perf_counter()
    threading.Thread(target=move).start()
    stop.wait()
    seconds = perf_counter() - start
    return sum(vertices("/skin/0")(message) is not None for message in client.heard[since:]) / seconds


if __name__ == "__main__":
    main()
