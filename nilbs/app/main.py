"""`nilbs <command>`: which commands there are, and how a user's mistake ends."""

import argparse
import errno
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module

import nilbs

# A command's file is imported only when the command is called, and imports what is heavy only when it runs; so every
# --help is instant.
COMMANDS = {
    "demo": "a gingerbread man from nothing to scores and pictures",
    "info": "what a mesh, rig, motion, weights or model file holds, and what is wrong with it",
    "convert": "bring meshes, rigs, weights and motions from one format to another",
    "weights": "solve for bounded biharmonic skinning weights",
    "train": "fit a field to a rigged mesh and a motion",
    "query": "occupancy or signed distance of points in a pose",
    "extract": "the posed surface, as a mesh",
    "evaluate": "score a model against ordinary skinning",
}
# What pip calls a module.
_PACKAGES = {"igl": "libigl", "skimage": "scikit-image"}
_INTERRUPTED = 130  # 128 + SIGINT, as a shell reports it


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    argv : sequence of str, optional
        The words after `nilbs`; those of the process by default.

    Returns
    -------
    status : int
        0; 2 after a user's mistake, which is told in one line on standard error; 130 after Ctrl-C; 1 where the reader
        of the output went away.

    Raises
    ------
    SystemExit
        By argparse, for --help (0) and for options that cannot be read (2).

    Notes
    -----
    With NILBS_DEBUG=1 in the environment an error shows its traceback.

    Examples
    --------
    >>> main(["info", "no-such-file.obj"])
    2
    """
    words = list(sys.argv[1:] if argv is None else argv)
    args = _parser(words).parse_args(words)
    return exit_status(lambda: args.run(args))


def exit_status(run: Callable[[], None]) -> int:
    """Run a program, and turn how it ends into the status that `main` returns."""
    _open_output()
    try:
        run()
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
        return 1
    except KeyboardInterrupt as interrupt:
        _drop_output()
        _tell("; ".join(["interrupted", *getattr(interrupt, "__notes__", [])]), prefix="nilbs: ")
        return _INTERRUPTED
    except (ValueError, OSError, MemoryError, ImportError, FloatingPointError, RuntimeError) as error:
        if os.environ.get("NILBS_DEBUG") == "1":
            raise
        message = _message(error)
        if message is None:
            raise
        _drop_output()
        _tell(message)
        return 2
    return 0


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """The parser, with the options of the command that is called."""
    parser = argparse.ArgumentParser(
        prog="nilbs",
        description="Neural inverse linear blend skinning: is a posed point inside, and how far from the skin?",
    )
    parser.add_argument("--version", action="version", version=f"nilbs {nilbs.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, title="commands")
    called = next((word for word in words if word in COMMANDS), None)
    for name, summary in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name == called:
            module = import_module(f"nilbs.app.commands.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser


def _message(error: Exception) -> str | None:
    """What to tell the user; None for an error that is ours."""
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("nilbs"):
        package = error.name.partition(".")[0]
        return f"the package {package} is not installed: pip install {_PACKAGES.get(package, package)}"
    if isinstance(error, FileExistsError) and error.strerror == os.strerror(errno.EEXIST):  # of a folder to be made
        return f"{os.fsdecode(error.filename)}: this is a file, where a folder is wanted"
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"not enough memory{f': {error}' if str(error) else ''}"
    if isinstance(error, RuntimeError):  # torch has no type of its own for this on every device
        return f"not enough memory: {error}" if "memory" in str(error).lower() else None
    return None if isinstance(error, ImportError) else str(error) or type(error).__name__


def _tell(message: str, prefix: str = "nilbs: error: ") -> None:
    with suppress(OSError):  # nobody is left to be told
        sys.stderr.write(prefix + " ".join(message.split()) + "\n")
        sys.stderr.flush()


def _open_output() -> None:
    """Let both outputs take whatever is written: one that is closed, and letters that the terminal's code lacks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for the whole process)
        elif getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Write out what standard output still holds, or let it go where it cannot be written.

    Otherwise the interpreter would try again when it ends, and complain.
    """
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
