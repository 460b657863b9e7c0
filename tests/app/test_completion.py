"""What a shell would offer, by the variables that the script of `nilbs completion` sets."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import nilbs
from nilbs.app.main import main

pytest.importorskip("argcomplete")


def completed(line: str, tmp_path) -> set[str]:
    found = tmp_path / "found.txt"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(nilbs.__file__).parents[1]),
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(found),
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([sys.executable, "-m", "nilbs"], env=environment, check=True, timeout=60, cwd=tmp_path)
    return set(found.read_text().split("\n"))


def test_the_start_of_a_command_is_completed(tmp_path) -> None:
    assert completed("nilbs tr", tmp_path) == {"train"}


def test_options_values_and_files_are_completed(tmp_path) -> None:
    (tmp_path / "hero.obj").touch()
    assert {"--method", "--motion"} <= completed("nilbs train --m", tmp_path)
    assert completed("nilbs train --method na", tmp_path) == {"nasa", "nasa-rigid"}
    assert completed("nilbs train he", tmp_path) == {"hero.obj"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_names_the_command(shell, capsys) -> None:
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert "_ARGCOMPLETE" in out
    assert "nilbs" in out
