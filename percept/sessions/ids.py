"""Identifiers of subjects, sessions, environments and groups: always text, compared as people read them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.records import IDS, Notice, Place, clip
from percept.sessions.values import is_missing

__all__ = ["Names", "doubtful_ids", "fold", "ids_from_name"]

_ZERO_WIDTH = re.compile("[\u200b-\u200f\u2060\ufeff\u00ad]")
#: Cyrillic and Greek letters, and the Latin ones that look the same.
_HOMOGLYPHS = str.maketrans(
    "АВЕКМНОРСТХаеорсухіѕјԁһ" + "ΑΒΕΖΗΙΚΜΝΟΡΤΥΧονκρ",
    "ABEKMHOPCTXaeopcyxisjdh" + "ABEZHIKMNOPTYXovkp",
)
#: What ends a file's name and is no part of an id.
_SUFFIXES = (".csv", ".tsv", ".tab", ".txt", ".gz", ".zip", ".parquet", ".xlsx")


def fold(name: str) -> str:
    """Write a name in one Unicode form (NFC), without zero-width characters and surplus spaces."""
    if name.isascii() and name == name.strip() and "  " not in name:
        return name
    return " ".join(_ZERO_WIDTH.sub("", unicodedata.normalize("NFC", name)).split())


@dataclass
class _Spellings:
    """One name as it was first written, and its other spellings with the place of each."""

    first: str
    others: dict[str, str] = field(default_factory=dict)


class Names:
    """Names seen so far by column: those that differ in spaces or Unicode form only are one.

    The spelling that comes first stands for all of them.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], _Spellings] = {}

    def add(self, column: str, name: str) -> None:
        """Take a spelling from the scene, which goes before those of the files."""
        self._known.setdefault((column, fold(name)), _Spellings(name))

    def settle(self, column: str, cells: pd.Series[str], file: str) -> pd.Series[str]:
        """Write every name of a column in its first spelling."""
        spelled: dict[str, str] = {}
        for name in cells.unique():
            known = self._known.setdefault((column, fold(name)), _Spellings(name))
            if name == known.first:
                continue
            spelled[name] = known.first
            if name not in known.others:
                row = cells.index[cells == name][0]
                known.others[name] = f"{file}:{row}"
        return cells.replace(spelled) if spelled else cells

    def notices(self) -> list[Notice]:
        """Say which names have several spellings."""
        notices = []
        for (column, _), name in self._known.items():
            if name.others:
                places = ", ".join(name.others.values())
                text = (
                    f"{column} {name.first!r} is one name with another spelling in {places}: they"
                    " differ in spaces, zero-width characters or Unicode form only"
                )
                notices.append(Notice(text))
        return notices


def doubtful_ids(table: pd.DataFrame, place: Place) -> Iterator[Notice]:
    """Notice ids that look alike, and ids that read as a missing value, with the first row of each."""
    for column in IDS:
        firsts = table[column].drop_duplicates()
        names = firsts.tolist()
        rows = [_where(place(int(position))) for position in firsts.index]
        written = [f"{_written(name)} ({row})" for name, row in zip(names, rows, strict=True)]
        alike: dict[str, list[str]] = {}
        for name, text in zip(names, written, strict=True):
            alike.setdefault(_look(name), []).append(text)
            if is_missing(name):
                yield Notice(f"{column} {text} is taken as a name: is it a missing value?")
        for texts in alike.values():
            if len(texts) > 1:
                yield Notice(f"{column}s {', '.join(texts)} look alike and are kept apart")


def _where(place: Any) -> str:
    return f"{place['file']}:{place['row']}"


def _written(name: str) -> str:
    """Quote a name; letters that look like Latin ones are written by their number."""
    clipped = clip(name)
    return ascii(clipped) if name.translate(_HOMOGLYPHS) != name else repr(clipped)


def _look(name: str) -> str:
    """Reduce a name to what it looks like: without case, leading zeros, or the script of a letter."""
    plain = unicodedata.normalize("NFKC", fold(name)).translate(_HOMOGLYPHS).casefold()
    try:
        return f"{float(plain):.15g}"
    except ValueError:
        return plain.lstrip("0")


def ids_from_name(path: str, pattern: str | None, *, file: str) -> dict[str, str]:
    """Ids in a file's name, by the scene's pattern."""
    if pattern is None:
        return {}
    stem = PurePath(path).name
    while (lower := stem.lower()).endswith(_SUFFIXES):
        stem = stem[: lower.rindex(".")]
    text = re.escape(pattern)
    longest = re.fullmatch(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>.+)", text), stem)
    shortest = re.fullmatch(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>.+?)", text), stem)
    if longest is None or shortest is None:
        hint = "Correct [sessions] filename."
        raise UsageError(f"the name does not fit the pattern {pattern!r}.", file=file, hint=hint)
    if longest.groupdict() != shortest.groupdict():
        message = f"the name fits the pattern {pattern!r} in more than one way."
        hint = "Put separators into [sessions] filename that do not occur in the ids."
        raise UsageError(message, file=file, hint=hint)
    return longest.groupdict()
