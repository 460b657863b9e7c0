"""Results in a folder: for programs as JSON, and as text for people."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nilbs.models.evaluation import Scores

SCORE_FILES = ("scores.json", "scores.txt")


def write_scores(scores: "Scores", folder: Path) -> tuple[Path, Path]:
    """Write scores as the `SCORE_FILES` of an existing folder; return their paths."""
    for_programs, for_people = (folder / name for name in SCORE_FILES)
    write_results(for_programs, for_people, scores.values, str(scores))
    return for_programs, for_people


def write_results(for_programs: Path, for_people: Path, values: Mapping[str, Any], text: str) -> None:
    """Write results as a .json and a .txt file."""
    from nilbs.io import replacing
    from nilbs.io.strict_json import plain

    with replacing(for_programs, "w") as file:
        file.write(json.dumps(plain(values), indent=1, allow_nan=False) + "\n")
    with replacing(for_people, "w") as file:
        file.write(f"{text}\n")
