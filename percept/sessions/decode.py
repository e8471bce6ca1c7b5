"""Bytes to text: byte-order mark, then strict UTF-8, then Windows-1252 with a notice."""

from __future__ import annotations

import codecs
from dataclasses import dataclass

from percept.errors import UsageError

_MARKS = (
    # UTF-32's little-endian mark begins with UTF-16's, so it is looked for first.
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


@dataclass(frozen=True)
class Decoded:
    """Text of a file, and the encoding it had."""

    text: str
    encoding: str


def decode(data: bytes, *, file: str, encoding: str | None = None) -> Decoded:
    """Decode a file's bytes without guessing from their statistics."""
    mark, found = next(((m, name) for m, name in _MARKS if data.startswith(m)), (b"", None))
    body = data[len(mark) :]
    name = _settled(encoding, found)
    if encoding or found:
        text = _strict(body, name, file)
    else:
        try:
            text = body.decode("utf-8")
        except UnicodeDecodeError:
            name = "cp1252"
            text = _strict(body, name, file)
    nul = text.find("\0")
    if nul >= 0:
        raise UsageError(
            "a NUL character: this is a binary file, or UTF-16 without a byte-order mark.",
            file=file,
            row=_line_of(text, nul),
            hint='Export it as CSV in UTF-8, or declare [sessions] encoding = "utf-16-le".',
        )
    return Decoded(text, name)


def _settled(declared: str | None, marked: str | None) -> str:
    """Return the declared encoding, its byte order by the mark; else the marked one."""
    if declared is None or marked is None:
        return declared or marked or "utf-8"
    try:
        family = codecs.lookup(declared).name
    except LookupError:
        return declared
    return marked if marked.startswith(f"{family}-") else declared


def _line_of(text: str, position: int) -> int:
    """Physical line, from 1, of a character position; CR LF, LF and CR each end a line."""
    before = text[:position]
    return 1 + before.count("\n") + before.count("\r") - before.count("\r\n")


def _strict(data: bytes, encoding: str, file: str) -> str:
    try:
        return data.decode(encoding)
    except LookupError:
        raise UsageError(f"unknown encoding {encoding!r}.", hint='Use a name such as "utf-8".') from None
    except UnicodeDecodeError as error:
        raise UsageError(
            f"byte {error.start + 1} is not text in {encoding} (nor in UTF-8)."
            if encoding == "cp1252"
            else f"byte {error.start + 1} is not text in {encoding}.",
            file=file,
            row=1 + data[: error.start].count(b"\n"),
            hint="Export the table again as CSV in UTF-8.",
        ) from None
