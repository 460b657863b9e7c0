"""What the README promises, and what the command reference is made of."""

import argparse
import re
import shlex
from pathlib import Path

import pytest

import nilbs
from nilbs.app.main import COMMANDS, parser_of

ROOT = Path(__file__).parents[1]


def test_readme_has_at_most_900_words() -> None:
    assert len((ROOT / "README.md").read_text().split()) <= 900


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_to_files_resolve(page: str) -> None:
    links = re.findall(r"\]\(([^)#]+)", (ROOT / page).read_text())
    for link in links:
        assert link.startswith("https://") or (ROOT / link).exists(), link


def test_citation_names_this_version() -> None:
    assert f"\nversion: {nilbs.__version__}\n" in (ROOT / "CITATION.cff").read_text()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_a_help_text(name: str) -> None:
    (commands,) = (action for action in parser_of([name])._actions if isinstance(action, argparse._SubParsersAction))
    actions = commands.choices[name]._actions
    assert len(actions) > 1
    assert all(action.help for action in actions)


def commands_in_docs() -> list[tuple[str, str]]:
    """Every line that is a command of nilbs, with the page that it is on."""
    found = []
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = page.read_text().replace("\\\n", " ")
        for line in re.findall(rf"^ *(?:.venv/bin/)?nilbs ((?:{'|'.join(COMMANDS)}) .*)", text, re.MULTILINE):
            found.append((page.name, re.split(r"&&| >", line)[0]))
    return found


@pytest.mark.parametrize(("page", "line"), commands_in_docs())
def test_commands_in_the_docs_are_understood(page: str, line: str) -> None:
    words = shlex.split(line, comments=True)
    parser_of(words[:1]).parse_args(words)  # leaves with an error otherwise


def test_the_docs_hold_commands() -> None:
    assert {page for page, _ in commands_in_docs()} >= {
        "README.md",
        "viewer.md",
        "contacts.md",
        "your_own_character.md",
    }
