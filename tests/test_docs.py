"""What the README promises, and what the command reference is made of."""

import argparse
import re
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
