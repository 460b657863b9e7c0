"""Scores and pictures of a model in a folder."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nilbs.evaluation import Scores


def write_scores(scores: "Scores", folder: Path) -> tuple[Path, Path]:
    """Write scores for programs and for people.

    Parameters
    ----------
    scores : Scores
    folder : path
        Where to; it must exist.

    Returns
    -------
    files : tuple of path
        `scores.json` and `scores.txt`.

    Raises
    ------
    OSError
        If they cannot be written.
    """
    from nilbs.app.output import plain
    from nilbs.io import replacing

    files = folder / "scores.json", folder / "scores.txt"
    with replacing(files[0], "w") as file:
        file.write(json.dumps(plain(scores.json()), indent=1, allow_nan=False) + "\n")
    with replacing(files[1], "w") as file:
        file.write(f"{scores}\n")
    return files
