"""Exceptions of percept: what is wrong, where, and what to do next."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable
from typing import TypedDict, Unpack

#: Characters of a value that a message shows.
_LONGEST = 200


def capitalised(text: str) -> str:
    """Make the first letter a capital, and leave the others as they are."""
    return text[:1].upper() + text[1:]


def counted(number: int, one: str, many: str | None = None) -> str:
    """Write a number with its noun: "1 trial", "3 trials", "2 studies"."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def printable(text: str) -> str:
    """Escape control and bidirectional characters, which move a cursor or hide text."""
    # Spaces of all widths are safe in a line, though Python would escape them.
    return "".join(
        one
        if one.isprintable() or unicodedata.category(one) == "Zs"
        else one.encode("unicode_escape").decode()
        for one in text
    )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that names the known word most like a wrong one, if there is one."""
    # Between numbers likeness says nothing.
    words = [other for other in known if not other.isdigit()]
    matches = difflib.get_close_matches(word, words, n=1)
    return f" Did you mean {matches[0]}?" if matches else ""


def _shown(value: object) -> str:
    """Write a value for a message, shortened."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write whole numbers of over 4,300 digits.
        text = hex(value) if isinstance(value, int) else type(value).__name__
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


class Concerned(TypedDict, total=False):
    """What an error is about, and what to do; see :class:`PerceptError`."""

    file: str | None
    row: int | None
    column: str | None
    key: str | None
    value: object
    hint: str | None


class PerceptError(ValueError):
    """Base of every error percept raises on purpose.

    Parameters
    ----------
    message : str
        What is wrong.
    file : str, optional
        The input file concerned.
    row : int, optional
        Physical line in `file`; the header is line 1.
    column : str, optional
        Column concerned.
    key : str, optional
        Setting, option or argument concerned, such as ``"inference.level"``.
    value : object, optional
        The offending value, as it was found.
    hint : str, optional
        What to do next, as a sentence.
    """

    exit_code = 2

    def __init__(self, message: str, **concerned: Unpack[Concerned]) -> None:
        super().__init__(message)
        self.message = message
        self.file = concerned.get("file")
        self.row = concerned.get("row")
        self.column = concerned.get("column")
        self.key = concerned.get("key")
        self.value = concerned.get("value")
        self.hint = concerned.get("hint")

    def __str__(self) -> str:
        parts = [":".join(str(part) for part in (self.file, self.row) if part is not None)]
        if self.column is not None:
            parts.append(f"column {self.column!r}")
        if self.key is not None:
            parts.append(self.key if self.value is None else f"{self.key} = {_shown(self.value)}")
        elif self.value is not None:
            parts.append(f"value {_shown(self.value)}")
        where = ", ".join(part for part in parts if part)
        text = f"{where}: {self.message}" if where else self.message
        return f"{text} {self.hint}" if self.hint else text


class UsageError(PerceptError):
    """Wrong usage or unreadable input (exit code 2)."""

    exit_code = 2


class RefusalError(PerceptError):
    """The input was understood, and the analysis asked for cannot be given for it (exit code 1)."""

    exit_code = 1
