"""The characters of the study: where they come from, and how they move."""

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from nilbs.characters.report import Report, silent

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.characters.motion import Motion

KIND = "nilbs study character 1"


@dataclass(frozen=True)
class Source:
    """What a character is made of.

    Attributes
    ----------
    title : str
        What tables call it.
    mesh, rig, weights, motion : str
        Files in the data folder; "" where weights are solved for, and where the motion is random.
    group : str, optional
        Of the mesh.
    dim : int
        Not 0: the gingerbread man in so many dimensions, who needs no files.
    """

    title: str
    mesh: str = ""
    rig: str = ""
    weights: str = ""
    motion: str = ""
    group: str | None = None
    dim: int = 0

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it needs."""
        return tuple(name for name in (self.mesh, self.rig, self.weights, self.motion) if name)


SOURCES: Mapping[str, Source] = {
    "gingerbread-2d": Source("gingerbread man, 2D", dim=2),
    "gingerbread-3d": Source("gingerbread man, 3D", dim=3),
    "arm": Source("arm", "arm/arm.obj", "arm/arm.tgf"),
    "elephant": Source(
        "elephant",
        "elephant/elephant.obj",
        "elephant/elephant.tgf",
        "elephant/elephant-weights.dmat",
        "elephant/elephant-anim.dmat",
    ),
    "makehuman": Source(
        "MakeHuman body",
        "makehuman/base.obj",
        "makehuman/default.mhskel",
        "makehuman/default_weights.mhw",
        "makehuman/walk1.bvh",
        group="body",
    ),
}


def available(data: Path | None) -> tuple[dict[str, Source], list[str]]:
    """Characters whose files are there, and a sentence on each that is left out.

    Parameters
    ----------
    data : path, optional
        Folder of the real meshes.

    Examples
    --------
    >>> found, left_out = available(None)
    >>> list(found), left_out[0]
    (['gingerbread-2d', 'gingerbread-3d'], 'arm is left out: no folder of real meshes was given')
    """
    found, left_out = {}, []
    for name, source in SOURCES.items():
        absent = [file for file in source.files if data is None or not (data / file).is_file()]
        if not absent:
            found[name] = source
        elif data is None:
            left_out.append(f"{source.title} is left out: no folder of real meshes was given")
        else:
            left_out.append(f"{source.title} is left out: there is no {data / absent[0]}")
    return found, left_out


def made_of(source: Source, data: Path | None) -> str:
    """A digest of a character's files; "" of one that needs none.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    digest = sha256()
    for file in source.files:
        assert data is not None
        digest.update(sha256((data / file).read_bytes()).digest())
    return digest.hexdigest()[:16] if source.files else ""


def prepared(name: str, folder: Path, data: Path | None, *, report: Report = silent) -> "Character":
    """A character with its weights, solved for once and kept.

    Parameters
    ----------
    name : str
        Of `SOURCES`.
    folder : path
        Where it is kept.
    data : path, optional
        Folder of the real meshes.
    report : function of str, optional
        Receives a line on each decision that the files left open.

    Returns
    -------
    character : Character

    Raises
    ------
    ValueError, OSError
        As `nilbs.load_character`.
    """
    from nilbs.characters.character import Character
    from nilbs.io.archive import read_archive, write_archive
    from nilbs.io.errors import FileFormatError

    source, path = SOURCES[name], folder / f"{name}.character"
    digest = made_of(source, data)
    if path.is_file():
        with suppress(FileFormatError, KeyError, TypeError, ValueError):  # what cannot be read is made again
            arrays, text = read_archive(path, kind=KIND)
            if text.get("made_of") == digest:
                return Character.of_arrays(arrays, name=name, bones=list(map(str, text["bones"])))
    character = _loaded(source, data, report)
    arrays = character.arrays()
    text = {"made_of": digest, "bones": list(character.skeleton.names)}
    folder.mkdir(parents=True, exist_ok=True)
    write_archive(path, arrays, text, kind=KIND)
    return replace(character, name=name)


def motion_of(name: str, character: "Character", data: Path | None, *, frames: int, seed: int) -> "Motion":
    """Training frames of a character: evenly spaced ones of its own motion, or of random motion.

    Parameters
    ----------
    name : str
    character : Character
    data : path, optional
        Folder of the real meshes.
    frames : int
        How many; fewer where its own motion has fewer.
    seed : int
        Of random motion.

    Returns
    -------
    motion : Motion
    """
    from nilbs.characters.motion import load_motion, random_motion

    source = SOURCES[name]
    if not source.motion:
        return random_motion(character, frames=frames, seed=seed)
    assert data is not None
    return load_motion(data / source.motion, character).take(frames)


def _loaded(source: Source, data: Path | None, report: Report) -> "Character":
    from nilbs.characters.bundle import load_character
    from nilbs.characters.gingerbread import write_gingerbread

    if source.dim:
        with tempfile.TemporaryDirectory() as folder:
            return load_character(*write_gingerbread(Path(folder), source.dim))
    assert data is not None
    weights = data / source.weights if source.weights else None
    return load_character(data / source.mesh, data / source.rig, weights=weights, group=source.group, report=report)
