"""Names that may be meant by a misspelt one, for errors; no numpy, so that the command line starts at once."""

import re
from collections.abc import Iterable
from difflib import get_close_matches

_ALIKE = 0.6  # ratio of two names that may be meant for each other, from 0 to 1
_MOST, _LONGEST = 2000, 80  # names that are compared, and letters of each: an error of a large file takes no minute


def alike_names(name: str, names: Iterable[str]) -> list[str]:
    """The names that are alike in letters, or have a word that is, in any case; the most alike first.

    Examples
    --------
    >>> alike_names("idel", ["Walk", "Idle"]), alike_names("wlak", ["Armature|Walk_01", "Run"])
    (['Idle'], ['Armature|Walk_01'])
    """
    holders: dict[str, list[str]] = {}
    for other in list(names)[:_MOST]:
        short = other[:_LONGEST]
        for word in dict.fromkeys(part.casefold() for part in (short, *re.split(r"[\W_]+", short)) if part):
            holders.setdefault(word, []).append(other)
    found = get_close_matches(name[:_LONGEST].casefold(), holders, n=max(len(holders), 1), cutoff=_ALIKE)
    return list(dict.fromkeys(other for word in found for other in holders[word]))


def nearest_name(name: str, names: Iterable[str]) -> str:
    """The name that may be meant, as the end of an error; nothing if none is alike.

    Examples
    --------
    >>> nearest_name("trian", ["info", "train"]), nearest_name("xyz", ["info", "train"])
    (" (the nearest: 'train')", '')
    """
    found = alike_names(name, names)
    return f" (the nearest: {found[0][:_LONGEST]!r})" if found else ""
