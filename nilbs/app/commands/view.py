"""`nilbs view`: a page in the browser on which characters are posed, and their fields are seen."""

import argparse

from nilbs.app.options import add_group, add_json, add_motion, add_solve, positive, whole

EXAMPLE = "nilbs view hero.nilbs"
FOREVER = 1e9  # seconds
TUNNEL = (
    "the page is served to this machine only. From another one, open a tunnel, ssh -L {port}:127.0.0.1:{port} HOST, "
    "and the same address there"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.description = f"{parser.description} By default {TUNNEL.format(port=8080)}."
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="trained models, .nilbs, each a character; and files of one more character, in any order: a mesh, a rig, "
        "weights, a motion, or one that holds several of these, such as .glb. No other file is read",
    )
    add_group(parser)
    add_solve(parser)
    add_motion(parser, "of the first character: its own, or random motion where it has none,")
    parser.add_argument("--points", metavar="FILE", help="points to colour by whether they are inside, .npy, (n, d)")
    parser.add_argument("--port", type=whole(0, 65535), default=8080, metavar="N", help="0: any free (default 8080)")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="the address to serve on, such as 0.0.0.0 (default 127.0.0.1). On any but this machine's own the page "
        "needs a random token, which the printed address holds, and is not encrypted: prefer a tunnel",
    )
    parser.add_argument("--seconds", type=positive, metavar="N", help="stop after so many (default: at Ctrl-C)")
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Open the page, print its address and wait."""
    import time

    import viser  # noqa: F401  (before the work, if it is missing)

    from nilbs.app.output import show
    from nilbs.app.poses import check_motion_options, print_note
    from nilbs.app.scenes import scene_of
    from nilbs.viewer.page import Page

    check_motion_options(args)
    page = Page(scene_of(args), host=args.host, port=args.port)
    try:
        show({"address": page.address}, as_json=args.json, table=page.address)
        if page.guard.token is None:
            print_note(TUNNEL.format(port=page.server.get_port()))
        print_note("the page ends with Ctrl-C" if args.seconds is None else f"the page ends after {args.seconds:g} s")
        time.sleep(min(args.seconds or FOREVER, FOREVER))
    except KeyboardInterrupt:
        pass  # how it ends
    finally:
        page.stop()
