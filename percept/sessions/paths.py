"""Paths to files: folders, patterns, and what a file's name says."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath

from percept.errors import UsageError
from percept.sessions.records import Notice

#: What tells a folder of results from one of sessions: the marker of `percept.files`.
_MARKER = ".percept"
#: Ends of the names of tables in archives.
PACKED = (".csv", ".tsv", ".tab", ".txt", ".json", ".jsonl")
_SUFFIXES = (
    *PACKED,
    ".gz",
    ".bz2",
    ".xz",
    ".zip",
    ".parquet",
    ".xlsx",
    ".mat",
    ".rds",
    ".rda",
    ".rdata",
    ".db",
    ".sqlite",
)
#: An id in an escaped pattern.
_ID = re.compile(r"\\\{(\w+)\\\}")


def expand(
    paths: Sequence[str | Path], wants: Callable[[str], bool] = lambda _: True
) -> tuple[dict[str, bool], list[Notice]]:
    """Expand folders and globs to files, in the order given, and say what is left out.

    Of a folder's tables those stay that are wanted. Of each file stands whether somebody named it.
    """
    if not paths:
        raise UsageError("no file was given.", hint="Name at least one session file or folder.")
    files: dict[str, bool] = {}
    places: set[str] = set()  # Where their paths lead
    notices: list[Notice] = []
    for given in paths:
        if not isinstance(given, str | os.PathLike):
            hint = "A DataFrame goes to Sessions.from_frame."
            raise UsageError(f"a path is text, not {type(given).__name__}.", hint=hint)
        text = str(given)
        is_folder = Path(text).is_dir()
        if is_folder:
            tables, results = _inside(Path(text))
            names = [name for name in tables if wants(name)]
            notices += [Notice("a folder of results is not read", file=name) for name in results]
        else:
            names = _named(text)
        for name in names:
            place = str(Path(name).resolve())
            if place in places:
                notices.append(Notice("a file that is named more than once is read once"))
            else:
                files[name] = not is_folder
            places.add(place)
    if not files:
        message = "no file in the folders fits include and exclude."
        raise UsageError(message, key="sessions.files", hint="Correct the patterns.")
    return files, notices


def _named(text: str) -> list[str]:
    """Return a file, or the files that a pattern fits."""
    if Path(named_part(text)[0]).exists():
        return [text]
    if not is_pattern(text):
        raise UsageError("there is no such file.", file=text, hint="Check the path.")
    names = [name for name in fitting(text) if not Path(name).is_dir()]
    if not names:
        hint = "Check it, and quote it in a shell."
        raise UsageError("no file fits the pattern.", file=text, hint=hint)
    return names


def named_part(text: str) -> tuple[str, str | None]:
    """Split "file.db::table" into the file and its part; None where no part is named."""
    place, separator, part = text.rpartition("::")
    if separator and not Path(text).exists() and Path(place).exists():
        return place, part
    return text, None


def is_pattern(text: str) -> bool:
    """Whether a path is a glob pattern: it has a sign of one, and nothing is called so."""
    return any(sign in text for sign in "*?[") and not Path(text).exists()


def fitting(pattern: str) -> list[str]:
    """Return the files and folders that a pattern fits, sorted."""
    return sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207 - a pattern may be absolute


def may_be_study(path: str) -> bool:
    """Whether a path is a table, or a folder of tables that percept did not write."""
    place = Path(path)
    if not place.is_dir():
        return place.suffix.lower() in _SUFFIXES
    return not (place / _MARKER).exists() and bool(_tables(place)[0])


def _inside(folder: Path) -> tuple[list[str], list[str]]:
    """Return the tables of a folder, of which there are some, and its folders of results."""
    tables, results = _tables(folder)
    if not tables:
        message = f"the folder holds no table ({', '.join(_SUFFIXES)})."
        raise UsageError(message, file=str(folder), hint="Check the path.")
    return tables, results


def _tables(folder: Path) -> tuple[list[str], list[str]]:
    """Look for tables and folders of results in a folder and those below it."""
    filled = {path.parent for path in folder.rglob(_MARKER)} - {folder}
    tables = []
    for path in sorted(folder.rglob("*")):
        is_table = path.suffix.lower() in _SUFFIXES and path.is_file()
        if is_table and filled.isdisjoint(path.parents) and not is_hidden(path.relative_to(folder)):
            tables.append(str(path))
    return tables, sorted(str(path) for path in filled)


def is_hidden(path: PurePath) -> bool:
    """Whether a path is what a system or a program hides."""
    return any(part.startswith((".", "~$", "__MACOSX")) and part != ".." for part in path.parts)


def ids_from_name(path: str, pattern: str | None, *, file: str) -> dict[str, str]:
    """Ids in a file's name and folders, by the scene's pattern.

    A pattern with "/" goes over as many folders. "*" stands for anything; an id then ends where
    what follows it in the pattern first stands.
    """
    if pattern is None:
        return {}
    depth = pattern.count("/") + 1
    parts = [*PurePath(path).parts[-depth:]]
    parts[-1] = _stem(parts[-1])
    name = "/".join(parts)
    text = re.escape(pattern).replace(r"\*", "[^/]*")
    greedy = _ID.sub(r"(?P<\1>[^/]+)", text)
    lazy = _ID.sub(r"(?P<\1>[^/]+?)", text)
    longest = re.fullmatch(greedy, name)
    shortest = re.fullmatch(lazy, name)
    if longest is None or shortest is None:
        hint = "Correct [sessions] filename."
        raise UsageError(f"the name does not fit the pattern {pattern!r}.", file=file, hint=hint)
    if "*" not in pattern and longest.groupdict() != shortest.groupdict():
        message = f"the name fits the pattern {pattern!r} in more than one way."
        hint = "Put separators into [sessions] filename that do not occur in the ids."
        raise UsageError(message, file=file, hint=hint)
    return shortest.groupdict()


def _stem(name: str) -> str:
    """Take the ends of known formats off a file's name."""
    while (lower := name.lower()).endswith(_SUFFIXES):
        name = name[: lower.rindex(".")]
    return name
