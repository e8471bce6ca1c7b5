"""Paths to bytes: files, folders, globs, standard input, and the members of gz and zip archives."""

from __future__ import annotations

import glob
import gzip
import hashlib
import io
import re
import sys
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path, PurePath, PurePosixPath
from typing import NamedTuple

from percept.errors import UsageError

#: What tells a folder of results from one of sessions.
_RESULTS = ("report.sha256", "fit.sha256", "reproduction.sha256", "leave_one_out.sha256", "batch.parquet")
_SUFFIXES = (".csv", ".tsv", ".tab", ".txt", ".gz", ".zip", ".parquet", ".xlsx")
# An archive that claims or gives more than this is refused: unpacked files of any size can be read in chunks.
LIMIT = 1 << 30


@dataclass(frozen=True)
class Input:
    """One table to read: its name for messages, its bytes, and the path of the file or archive member."""

    name: str
    data: bytes
    path: str

    @cached_property
    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the bytes."""
        return hashlib.sha256(self.data).hexdigest()


class Expanded(NamedTuple):
    """What paths stand for."""

    files: list[str]  # In the order given
    ignored: list[str]  # Files of folders whose suffix is not that of a table
    results: list[str]  # Folders below the given ones that percept has filled, whose tables are left out
    repeated: int = 0  # Times a file was named again


def expand(paths: Sequence[str | Path]) -> Expanded:
    """Expand folders and globs to files."""
    if not paths:
        raise UsageError("no file was given.", hint="Name at least one session file or folder.")
    files: dict[str, str] = {}
    ignored: list[str] = []
    results: list[str] = []
    repeated = 0
    for given in paths:
        if not isinstance(given, str | PathLike):
            raise UsageError(
                f"a path is text, not {type(given).__name__}.",
                hint="A DataFrame goes to Sessions.from_frame.",
            )
        text = str(given)
        path = Path(text)
        if text == "-":
            found = ["-"]
        elif path.is_dir():
            inside = _inside(path)
            found = inside.files
            ignored += inside.ignored
            results += inside.results
            if not found:
                raise UsageError(
                    f"the folder holds no table ({', '.join(_SUFFIXES)}).", file=text, hint="Check the path."
                )
        elif path.exists():
            found = [text]
        elif is_pattern(text):
            found = [name for name in fitting(text) if not Path(name).is_dir()]
            if not found:
                raise UsageError(
                    "no file fits the pattern.", file=text, hint="Check it, and quote it in a shell."
                )
        else:
            raise UsageError("there is no such file.", file=text, hint="Check the path.")
        for name in found:
            own = name if name == "-" else str(Path(name).resolve())
            repeated += own in files
            files.setdefault(own, name)
    return Expanded(list(files.values()), ignored, results, repeated)


def is_pattern(text: str) -> bool:
    """Whether a path is a glob pattern: it has a sign of one, and nothing is called so."""
    return any(sign in text for sign in "*?[") and not Path(text).exists()


def fitting(pattern: str) -> list[str]:
    """Return the files and folders that a pattern fits, sorted."""
    return sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207 - a pattern may be absolute


def may_be_study(path: str) -> bool:
    """Whether what a pattern fits is a table, or a folder of tables that percept has not filled itself."""
    found = Path(path)
    if found.is_dir():
        return not any((found / name).exists() for name in _RESULTS) and bool(_inside(found).files)
    return found.suffix.lower() in _SUFFIXES


def _inside(folder: Path) -> Expanded:
    """Look for tables in a folder and those below it."""
    filled = {p.parent for name in _RESULTS for p in folder.rglob(name)} - {folder}
    inside = sorted(
        p
        for p in folder.rglob("*")
        if p.is_file() and not _hidden(p, folder) and filled.isdisjoint(p.parents)
    )
    tables = [p.suffix.lower() in _SUFFIXES for p in inside]
    return Expanded(
        [str(p) for p, table in zip(inside, tables, strict=True) if table],
        [str(p) for p, table in zip(inside, tables, strict=True) if not table],
        sorted(map(str, filled)),
    )


def _hidden(path: Path, folder: Path) -> bool:
    return any(part.startswith((".", "~$", "__MACOSX")) for part in path.relative_to(folder).parts)


def load(name: str) -> Iterator[Input]:
    """Read one path; an archive gives its members, in memory only."""
    try:
        data = sys.stdin.buffer.read() if name == "-" else Path(name).read_bytes()
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}.", file=name) from None
    label = "standard input" if name == "-" else name
    if data.startswith(b"\x1f\x8b"):
        yield Input(label, _flat(_gunzip(data, label), label), name)
    elif data.startswith(b"PK\x03\x04") and not is_workbook(data, label):
        yield from _members(data, label)
    else:
        yield Input(label, data, name)


def is_workbook(data: bytes, name: str) -> bool:
    """Whether a zip archive is an Excel workbook."""
    with _open(data, name) as archive:
        return "xl/workbook.xml" in archive.namelist()


def _open(data: bytes, name: str) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
        raise UsageError(f"a broken zip archive: {error}.", file=name, hint="Pack it again.") from None
    for member in archive.infolist():
        if member.file_size > LIMIT:
            raise UsageError(
                f"a member claims {member.file_size} bytes; more than {LIMIT} are not unpacked.",
                file=name,
                value=member.filename[:60],
                hint="If it is real, unpack it and read the file itself.",
            )
    return archive


def _members(data: bytes, name: str) -> Iterator[Input]:
    with _open(data, name) as archive:
        members = sorted(
            (m for m in archive.infolist() if not m.is_dir() and not _skip(m.filename)),
            key=lambda m: m.filename,
        )
        if not members:
            raise UsageError(f"the archive holds no table ({', '.join(_SUFFIXES[:4])}).", file=name)
        for member in members:
            label = f"{name}!{member.filename}"
            if member.flag_bits & 1:
                raise UsageError("the archive is encrypted.", file=label, hint="Unpack it first.")
            try:
                with archive.open(member) as stream:
                    content = stream.read(LIMIT + 1)
            except (
                zipfile.BadZipFile,
                zlib.error,
                OSError,
                NotImplementedError,
                EOFError,
                RuntimeError,
            ) as error:
                raise UsageError(
                    f"a broken zip member: {error}.", file=label, hint="Pack it again."
                ) from None
            # Some archivers write backslashes.
            yield Input(label, _flat(content, label), member.filename.replace("\\", "/"))


def _flat(content: bytes, name: str) -> bytes:
    if content.startswith((b"\x1f\x8b", b"PK\x03\x04")):
        raise UsageError("an archive inside an archive.", file=name, hint="Unpack the outer one first.")
    return content


def _skip(member: str) -> bool:
    parts = PurePosixPath(member).parts
    return any(p.startswith((".", "__MACOSX")) and p != ".." for p in parts) or not member.lower().endswith(
        _SUFFIXES[:4]
    )


def _gunzip(data: bytes, name: str) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            content = stream.read(LIMIT + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise UsageError(f"a broken gz file: {error}.", file=name, hint="Pack it again.") from None
    if len(content) > LIMIT:
        raise UsageError(
            f"unpacks to more than {LIMIT} bytes.", file=name, hint="Unpack it and read the file itself."
        )
    return content


def names_from_file(path: str, pattern: str | None, *, file: str) -> dict[str, str]:
    """Ids in a file's name, by the scene's pattern."""
    if pattern is None:
        return {}
    stem = PurePath(path).name
    while (lower := stem.lower()).endswith(_SUFFIXES):
        stem = stem[: lower.rindex(".")]
    text = re.escape(pattern)
    readings = []
    for repeat in ("+", "+?"):
        found = re.fullmatch(re.sub(r"\\\{(\w+)\\\}", rf"(?P<\1>.{repeat})", text), stem)
        readings.append(found.groupdict() if found else {})
    if not readings[0]:
        raise UsageError(
            f"the name does not fit the pattern {pattern!r}.", file=file, hint="Correct [sessions] filename."
        )
    if readings[0] != readings[1]:
        raise UsageError(
            f"the name fits the pattern {pattern!r} in more than one way.",
            file=file,
            hint="Put separators into [sessions] filename that do not occur in the ids.",
        )
    return readings[0]
