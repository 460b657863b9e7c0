"""`nilbs <command>`: the list of commands, and how a user's mistake ends."""

import argparse
import errno
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module

import nilbs
from nilbs.app.parser import Parser

# A command's file is imported when the command is called, and imports heavy libraries when it runs: --help is instant.
COMMANDS = {
    "demo": "train and score a field of a gingerbread man, and draw pictures",
    "info": "report what a mesh, rig, motion, weights or model file holds, and its problems",
    "convert": "convert meshes, rigs, weights and motions to other formats",
    "weights": "solve for bounded biharmonic skinning weights, or take those of another mesh",
    "train": "train a field on a rigged mesh and a motion",
    "query": "evaluate occupancy or signed distance of points in a pose",
    "extract": "extract the posed surface as a mesh",
    "voxelize": "evaluate occupancy or signed distance on a regular grid in a pose",
    "render": "write depth, normals and canonical coordinates of a picture in a pose",
    "animate": "write a motion as a film or as a sequence of meshes",
    "view": "pose characters in the browser, and see their fields",
    "evaluate": "score a model against the skinned mesh",
    "check": "find where a moving character meets itself or others, and how deep",
    "clear": "change a motion as little as keeps a character's parts, and others, apart",
    "benchmark": "time a model beside libraries that query the skinned mesh",
    "completion": "print a shell's script that completes commands, options and files by the Tab key",
}
# Names on the package index that differ from the module's.
_PACKAGES = {"igl": "libigl", "skimage": "scikit-image", "imageio_ffmpeg": "imageio-ffmpeg"}
_PACKAGES |= {"viser": "'nilbs-geometry[view]'"}  # its extra, which states the version
_INTERRUPTED = 130  # 128 + SIGINT, as a shell reports it


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, given as the words after `nilbs`, by default those of the process, and return the exit status.

    The status is 0, or what the command returns; 2 after a user's mistake, with one line on standard error; 130 after
    Ctrl-C; 1 if standard output was closed. argparse raises SystemExit for --help (0) and for wrong options (2). With
    NILBS_DEBUG=1 in the environment an error shows its traceback.

    Examples
    --------
    >>> main(["info", "no-such-file.obj"])
    2
    """
    words = with_axes(sys.argv[1:] if argv is None else argv)

    def run() -> int | None:
        if "_ARGCOMPLETE" in os.environ:  # set by the script of `nilbs completion` while a shell completes a line
            import argcomplete

            argcomplete.autocomplete(parser_of(os.environ["COMP_LINE"].split()))
        args = parser_of(words).parse_args(words)
        status: int | None = args.run(args)
        return status

    return exit_status(run)


def exit_status(run: Callable[[], int | None]) -> int:
    """Run a program and return the status of `main`."""
    _open_output()
    try:
        status = run()
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
        return 1
    except KeyboardInterrupt as interrupt:
        _drop_output()
        _print_error("; ".join(["interrupted", *getattr(interrupt, "__notes__", [])]), prefix="nilbs: ")
        return _INTERRUPTED
    except (ValueError, OSError, MemoryError, ImportError, FloatingPointError, RuntimeError) as error:
        if os.environ.get("NILBS_DEBUG") == "1":
            raise
        message = _message(error)
        if message is None:
            raise
        _drop_output()
        _print_error(message)
        return 2
    return status or 0


def with_axes(words: Sequence[str]) -> list[str]:
    """The words, with a negative axis joined to its option: argparse would take it for an option of its own.

    Examples
    --------
    >>> with_axes(["convert", "--up", "z", "--forward", "-y"])
    ['convert', '--up', 'z', '--forward=-y']
    """
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in ("--up", "--forward") and word in ("-x", "-y", "-z"):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def parser_of(words: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of all commands, with the options of the one that is called."""
    parser = Parser(
        prog="nilbs",
        description="Neural inverse linear blend skinning: is a posed point inside, and how far from the surface?",
    )
    parser.add_argument("--version", action="version", version=f"nilbs {nilbs.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, title="commands")
    called = next((word for word in words if word in COMMANDS), None)
    for name, summary in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name == called:
            module = import_module(f"nilbs.app.commands.{name}")
            module.add_arguments(command)
            command.epilog = f"example: {module.EXAMPLE}"
            command.set_defaults(run=module.run)
    return parser


def _message(error: Exception) -> str | None:
    """The line for the user; None for an error of the program itself."""
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("nilbs"):
        package = error.name.partition(".")[0]
        return f"the package {package} is not installed: pip install {_PACKAGES.get(package, package)}"
    if isinstance(error, FileExistsError) and error.strerror == os.strerror(errno.EEXIST):  # from making a folder
        return f"{os.fsdecode(error.filename)}: this is a file, expected a folder"
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"not enough memory{f': {error}' if str(error) else ''}"
    if isinstance(error, RuntimeError):  # torch has no error type for this on every device
        return f"not enough memory: {error}" if "memory" in str(error).lower() else None
    return None if isinstance(error, ImportError) else str(error) or type(error).__name__


def _print_error(message: str, prefix: str = "nilbs: error: ") -> None:
    with suppress(OSError):  # standard error is closed
        sys.stderr.write(prefix + " ".join(message.split()) + "\n")
        sys.stderr.flush()


def _open_output() -> None:
    """Make both outputs usable: if one is closed, and for letters that the terminal's encoding lacks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for the whole process)
        elif getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Flush standard output, or discard it if it cannot be written; else the interpreter would fail when it ends."""
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
