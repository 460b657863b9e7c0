"""`nilbs completion`: the script by which a shell completes the words of nilbs."""

import argparse

SHELLS = ("bash", "zsh", "fish")

EXAMPLE = "nilbs completion bash"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=f"{', '.join(SHELLS[:-1])} or {SHELLS[-1]}")


def run(args: argparse.Namespace) -> None:
    """Print the script."""
    import argcomplete

    from nilbs.app.output import write_text

    write_text(argcomplete.shellcode(["nilbs"], shell=args.shell))
