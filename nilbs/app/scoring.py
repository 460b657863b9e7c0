"""Scores and pictures of a model in a folder."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nilbs.models.evaluation import Scores

SCORE_FILES = ("scores.json", "scores.txt")


def write_scores(scores: "Scores", folder: Path) -> tuple[Path, Path]:
    """Write scores as the `SCORE_FILES` of an existing folder, for programs and for people; return their paths."""
    from nilbs.io import replacing
    from nilbs.io.strict_json import plain

    for_programs, for_people = (folder / name for name in SCORE_FILES)
    with replacing(for_programs, "w") as file:
        file.write(json.dumps(plain(scores.values), indent=1, allow_nan=False) + "\n")
    with replacing(for_people, "w") as file:
        file.write(f"{scores}\n")
    return for_programs, for_people
