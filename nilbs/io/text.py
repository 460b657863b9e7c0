"""Text as UTF-8, whatever byte order mark, encoding and line ends a file has."""

import codecs
import os
import re

from nilbs.io.errors import FileFormatError

_HEAD = 2**16  # bytes in which a file with line feeds has one
# UTF-32 before UTF-16, whose mark it starts with.
_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_NAMES = {"cp932": "Shift-JIS", "cp1252": "Windows-1252", "latin-1": "Latin-1"}
# Japanese signs that stand together or alone; and one beside a Latin letter, as Latin text looks in Shift-JIS.
_SIGN = "[\u3005-\u3006\u3040-\u30ff\u4e00-\u9fff\uff01-\uff5e]"
_JAPANESE = re.compile(rf"{_SIGN}{{2,}}|(?<![^\W\d_]){_SIGN}(?![^\W\d_])")
_STRAY = re.compile(rf"(?<!{_SIGN})(?:(?<=[A-Za-z]){_SIGN}|{_SIGN}(?=[A-Za-z]))(?!{_SIGN})")


def byte_order_mark(head: bytes) -> tuple[int, str]:
    """How long the byte order mark at the start of a text is, and the encoding that it shows.

    Examples
    --------
    >>> byte_order_mark("v 0".encode("utf-16-le")), byte_order_mark("v 0".encode("utf-8-sig"))
    ((0, 'utf-8'), (3, 'utf-8'))
    """
    return next(((len(mark), encoding) for mark, encoding in _MARKS.items() if head.startswith(mark)), (0, "utf-8"))


def without_mark(path: str | os.PathLike, data: bytes) -> bytes:
    """The bytes of a text file without a byte order mark, which also turns UTF-16 and UTF-32 into UTF-8.

    Examples
    --------
    >>> without_mark("a.txt", "v 0".encode("utf-8-sig")), without_mark("a.txt", "v 0".encode("utf-16"))
    (b'v 0', b'v 0')
    """
    size, encoding = byte_order_mark(data[:4])
    if encoding == "utf-8":
        return data[size:] if size else data
    try:  # a last character that is cut off is left out
        return codecs.getincrementaldecoder(encoding)().decode(data).encode()
    except UnicodeError:
        raise FileFormatError(path, f"the file starts as {encoding.upper()}, and is no such text") from None


def line_feeds(data: bytes) -> bytes:
    r"""Text whose lines end in line feeds, where all of them end in carriage returns.

    Examples
    --------
    >>> line_feeds(b"v 0\rv 1\r"), line_feeds(b"v 0\r\nv 1\r\n")
    (b'v 0\nv 1\n', b'v 0\r\nv 1\r\n')
    """
    return data if b"\n" in data[:_HEAD] or b"\r" not in data[:_HEAD] else data.replace(b"\r", b"\n")


def utf8_lines(lines: list[bytes]) -> tuple[list[bytes], str | None]:
    """Lines of text in UTF-8, and the name of their encoding where some were not.

    These are taken as Shift-JIS if they look Japanese as such, else as Windows-1252 or Latin-1.

    Examples
    --------
    >>> [utf8_lines([text.encode(encoding)])[1] for text, encoding in (("左腕", "cp932"), ("Schlüssel", "latin-1"))]
    ['Shift-JIS', 'Windows-1252']
    """
    if b"".join(lines).isascii():
        return lines, None
    other = [number for number, line in enumerate(lines) if not _is_utf8(line)]
    if not other:
        return lines, None
    encoding = _legacy_encoding(b"".join(lines[number] for number in other))
    lines = [*lines]
    for number in other:
        lines[number] = lines[number].decode(encoding).encode()
    return lines, _NAMES[encoding]


def _is_utf8(line: bytes) -> bool:
    try:
        line.decode()
    except UnicodeDecodeError:
        return False
    return True


def _legacy_encoding(data: bytes) -> str:
    """The likeliest encoding of text that is not UTF-8, in which all of its bytes are text."""
    for encoding in ("cp932", "cp1252"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if encoding == "cp1252" or len(_JAPANESE.findall(text)) > len(_STRAY.findall(text)):
            return encoding
    return "latin-1"
