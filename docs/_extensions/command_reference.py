"""The directive `command-reference`: every command of `nilbs` with its arguments, from its own parser."""

import argparse

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from nilbs.app.main import COMMANDS, parser_of

_PLAIN = ("positional arguments", "options")  # groups of argparse itself


def described(parser: argparse.ArgumentParser) -> list[str]:
    """A command's usage, its arguments and its options, as lines of reStructuredText."""
    lines = ["", ".. code-block:: text", "", *(f"   {line}" for line in _usage(parser)), ""]
    lines += ["For example:", "", ".. code-block:: sh", "", f"   {str(parser.epilog).removeprefix('example: ')}", ""]
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
        if actions and group.title not in _PLAIN:
            title = str(group.title)
            lines += [f".. rubric:: {title[:1].upper()}{title[1:]}", ""]
        for action in actions:
            lines += [_name(parser, action), f"   {_help(parser, action)}", ""]
    return lines


def _command(name: str) -> argparse.ArgumentParser:
    actions = parser_of([name])._actions
    (commands,) = (action for action in actions if isinstance(action, argparse._SubParsersAction))
    found: argparse.ArgumentParser = commands.choices[name]
    return found


def _usage(parser: argparse.ArgumentParser) -> list[str]:
    return parser.format_usage().removeprefix("usage: ").rstrip().splitlines()


def _name(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    value = parser._get_formatter()._format_args(action, (action.metavar or action.dest).upper())  # type: ignore[union-attr]
    if not action.option_strings:
        return f"``{action.metavar or action.dest}``"
    return ", ".join(f"``{option} {value}``".replace(" ``", "``") for option in action.option_strings)


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    text = parser._get_formatter()._expand_help(action) if action.help else ""
    return text.replace("*", r"\*").replace("_", r"\_").replace("|", r"\|").replace("--", r"\--")


class CommandReference(SphinxDirective):
    """A section for each command."""

    def run(self) -> list[nodes.Node]:
        """Parse the lines of every command into a section of its own."""
        sections: list[nodes.Node] = []
        for name, summary in COMMANDS.items():
            section = nodes.section(ids=[f"command-{name}"], names=[name])
            section += nodes.title(text=f"nilbs {name}")
            lines = [f"{summary[0].upper()}{summary[1:]}.", *described(_command(name))]
            self.state.nested_parse(StringList(lines, source=f"nilbs {name}"), 0, section)
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-reference", CommandReference)
    return {"parallel_read_safe": True}
