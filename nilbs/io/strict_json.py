"""JSON without its surprises: no names given twice, no NaN, no endless nesting."""

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from nilbs.io.bounded import text_bytes
from nilbs.io.errors import FileFormatError

_LARGEST = 1e150  # of a number, which JSON writes with any exponent; its square is still one


def read_json(path: str | os.PathLike) -> object:
    """Read a JSON file; FileFormatError if it is none, nested too deep, or has a name twice in one object.

    Numbers are as they stand: a whole number may be too large for a float, see `finite_vector`.
    """
    with json_errors(path):
        return parse_json(text_bytes(path).decode())


@contextmanager
def json_errors(path: str | os.PathLike, *, lines: bool = True) -> Iterator[None]:
    """Report what is wrong with a text of JSON as an error of the file."""
    try:
        yield
    except json.JSONDecodeError as error:
        raise FileFormatError(path, f"this is no JSON: {error.msg}", error.lineno if lines else None) from None
    except RecursionError:
        raise FileFormatError(path, "the JSON is nested too deep") from None
    except FileFormatError:
        raise
    # Bytes that are no text, names given twice, NaN, and whole numbers of thousands of digits.
    except ValueError as error:
        raise FileFormatError(path, f"this JSON cannot be used: {str(error)[:120]}") from None


def parse_json(text: str) -> object:
    """The value of a text of JSON, as `read_json` has it; ValueError or RecursionError if it cannot be used."""
    value = json.loads(text, object_pairs_hook=_object, parse_constant=no_constant)
    if "\\u" in text:  # an escape can be half of a pair of code units, which no file and no terminal takes
        json.dumps(value, ensure_ascii=False).encode()
    return value


def finite_vector(value: object, *sizes: int) -> list[float] | None:
    """The finite numbers of a list, or of one number alone; None for anything else, or where they are too few or many.

    Examples
    --------
    >>> finite_vector([1, 2.5], 2), finite_vector(3, 1, 2), finite_vector([1, "2"], 2), finite_vector(10**400, 1)
    ([1.0, 2.5], [3.0], None, None)
    """
    values = value if isinstance(value, list) else [value]
    if len(values) not in sizes:
        return None
    # Compared as they are: a whole number may be too large for a float.
    numbers = [
        float(x) for x in values if isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= _LARGEST
    ]
    return numbers if len(numbers) == len(values) else None


def plain(value: Any) -> Any:
    """The same value in types that JSON has; a number that is not finite is None.

    Examples
    --------
    >>> plain({"a": (1, float("inf"))})
    {'a': [1, None]}
    """
    if isinstance(value, Mapping):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if hasattr(value, "tolist"):  # of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"{twice[:80]!r} stands twice in one object")
    return found


def no_constant(name: str) -> object:
    """Refuse NaN and infinity."""
    raise ValueError(f"{name} is not a finite number")
