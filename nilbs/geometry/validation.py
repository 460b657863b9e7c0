"""One check of array arguments, and the words of what is wrong."""

import re
from collections.abc import Sequence

import numpy as np

# What the rows of an array are.
_ROWS = {"V": "vertices", "U": "vertices", "U_true": "vertices", "C": "joints", "F": "facets"}


def arrays(**named: tuple) -> list[np.ndarray]:
    """Convert arguments to float64 or int64 arrays and check their shapes against each other.

    Each is given as its value, its shape in letters and, for whole numbers, ``int``, or the name of the earlier array
    that they index: ``V=(V, "n d")``, ``P=(P, "b", int)``, ``F=(F, "m d", "V")``. A letter stands for one size
    everywhere in the call, and d for 2 or 3; ``d+1`` adds to it; a number stands for itself; a leading ``...`` takes
    any dimensions. A shape that disagrees, a number that is not finite or an index that does not exist is a ValueError.

    Examples
    --------
    >>> arrays(V=([[0, 0], [1, 0]], "n d"), W=([[1], [1], [1]], "n b"))
    Traceback (most recent call last):
    ValueError: W must be (n, b) = (2, b), got (3, 1)
    """
    sizes: dict[str, int] = {}
    values: dict[str, np.ndarray] = {}
    for name, (value, letters, *kind) in named.items():
        values[name] = _array(name, value, letters, int if kind else float, sizes)
        if kind and kind[0] is not int:
            check_indices(name, values[name], len(values[kind[0]]), _ROWS[kind[0]])
    return list(values.values())


def check_indices(name: str, indices: np.ndarray, size: int, of: str) -> None:
    """Raise a ValueError that names the first row with an index outside 0 .. size-1."""
    bad = np.flatnonzero(((indices < 0) | (indices >= size)).any(axis=tuple(range(1, indices.ndim))))
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] = {indices[bad[0]].tolist()} does not index the {size} {of}")


def listed(words: Sequence[str]) -> str:
    """Words for a sentence: the first five, and how many more there are.

    Examples
    --------
    >>> listed(["a", "b"]), listed(["a", "b", "c", "d", "e", "f", "g"])
    ('a, b', 'a, b, c, d, e and 2 more')
    """
    more = f" and {len(words) - 5} more" if len(words) > 5 else ""
    return ", ".join(words[:5]) + more


def _array(name: str, value: object, letters: str, kind: type, sizes: dict[str, int]) -> np.ndarray:
    try:
        array = np.asarray(value)
        # A nan becomes some integer; the comparison below finds it.
        with np.errstate(invalid="ignore"):
            converted = array.astype(np.int64 if kind is int else np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers, got {type(value).__name__}: {error}") from None
    if kind is int and not np.array_equal(converted, array):
        raise ValueError(f"{name} must hold whole numbers")
    terms = letters.split()
    dots = terms[:1] if terms[0] == "..." else []
    terms = terms[len(dots) :]
    shape = array.shape[max(array.ndim - len(terms), 0) :] if dots else array.shape
    fits = len(shape) == len(terms)
    for term, size in zip(terms, shape, strict=False):
        fits = fits and _size(term, size, sizes) == size
    if not fits:
        sizes_found = [_size(term, None, sizes) for term in terms]
        numbers = [term if size is None else str(size) for term, size in zip(terms, sizes_found, strict=True)]
        expected, known = (", ".join(dots + words) + "," * (len(dots + words) == 1) for words in (terms, numbers))
        equal = "" if known == expected else f" = ({known})"
        raise ValueError(f"{name} must be ({expected}){equal}, got {array.shape}")
    if sizes.get("d", 2) not in (2, 3):
        raise ValueError(f"{name} has d = {sizes['d']}; d must be 2 or 3")
    if not np.isfinite(converted).all():
        where = np.argwhere(~np.isfinite(converted))[0].tolist()
        raise ValueError(f"{name}{where} is {converted[tuple(where)]}; every number must be finite")
    return converted


def _size(term: str, size: int | None, sizes: dict[str, int]) -> int | None:
    """The size that a term stands for; a letter met for the first time takes the size given."""
    match = re.fullmatch(r"([a-z]?)\+?(\d*)", term)
    assert match, f"cannot read the shape {term!r}"
    letter, number = match[1], int(match[2] or 0)
    if not letter:
        return number
    if letter not in sizes:
        if size is None:
            return None
        sizes[letter] = size - number
    return sizes[letter] + number
