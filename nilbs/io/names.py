"""Names in files: of any bytes, each different, and as a file can hold them."""

import re
from collections.abc import Iterable

from nilbs.geometry.validation import listed


def text_of(word: bytes) -> str:
    """A name in a file, whatever its bytes are."""
    return word.decode("utf-8", "replace")


def printable(text: str) -> str:
    """A text without line ends, control characters and other signs that cannot be shown."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def unique_names(names: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names, each different: one that is used again gets a number; and a note if so.

    Examples
    --------
    >>> unique_names(["toe", "toe", "toe_2"])
    (('toe', 'toe_3', 'toe_2'), ("names used twice were numbered: 'toe' became 'toe_3'",))
    """
    given = list(names)
    taken = set(given)
    seen: set[str] = set()
    number: dict[str, int] = {}
    unique, changed = [], []
    for name in given:
        new = name
        if name in seen:
            count = number.get(name, 1)
            while new in taken:
                count += 1
                new = f"{name}_{count}"
            number[name] = count
            taken.add(new)
            changed.append(f"{name[:60]!r} became {new[:70]!r}")
        seen.add(name)
        unique.append(new)
    return tuple(unique), (f"names used twice were numbered: {listed(changed)}",) if changed else ()


def written_names(names: Iterable[str], unfit: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    r"""Names as a file can hold them, each different, `unfit` patterns replaced by an underscore; and a note if so.

    Examples
    --------
    >>> written_names(["left leg", "spine"], r"\s")
    (('left_leg', 'spine'), ("names that the file cannot hold were changed: 'left leg' became 'left_leg'",))
    """
    given = list(names)
    written, _ = unique_names(re.sub(rf"(?:{unfit}|[\0\ud800-\udfff])+", "_", name) or "_" for name in given)
    changed = [f"{old[:60]!r} became {new[:60]!r}" for old, new in zip(given, written, strict=True) if old != new]
    return written, (f"names that the file cannot hold were changed: {listed(changed)}",) if changed else ()
