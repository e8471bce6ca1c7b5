"""Paths to bytes and texts: folders, patterns, archives, encodings; what is no table is refused."""

from __future__ import annotations

import bz2
import codecs
import glob
import gzip
import io
import lzma
import os
import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import pandas as pd

from percept.errors import UsageError
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError, Notice

#: What tells a folder of results from one of sessions: the marker of `percept.files`.
_MARKER = ".percept"
#: Ends of the names of tables in archives.
_PACKED = (".csv", ".tsv", ".tab", ".txt", ".json", ".jsonl")
_SUFFIXES = (
    *_PACKED,
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
_ENDS = re.compile(rf"({'|'.join(map(re.escape, _SUFFIXES))})+$", re.IGNORECASE)
#: An id in an escaped pattern.
_ID = re.compile(r"\\\{(\w+)\\\}")
#: Bytes that are unpacked at a time.
_BLOCK = 8 << 20
#: Characters in which files of experiment software show what they are: the bound keeps the search
#: short.
_EARLY = 20_000
#: What opens a compressed file, by how it begins.
_OPENERS: dict[bytes, Callable[..., Any]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\0": lzma.open,
}
_ZIP = b"PK\x03\x04"
#: A zip archive that is an Excel workbook.
WORKBOOK = rb"(?s:PK\x03\x04.*xl/workbook\.xml)"
#: Byte-order marks, and the encodings that they tell.
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_ENCODINGS_HINT = (
    "Other letters are UTF-8: two programs wrote this file. Write it again in UTF-8, or declare"
    ' [sessions] encoding = "cp1252".'
)
_CSV_HINT = "Export the data as CSV in UTF-8."
_TRIALS_HINT = "Use the trial-by-trial .csv that PsychoPy writes next to it."
#: How files begin that are no tables of text, as bytes (each a character here) or as text.
_NO_TABLES = (
    (
        r"\x80[\x02-\x05]",
        "a Python pickle (PsychoPy's .psydat), which is never opened",
        _TRIALS_HINT,
    ),
    (r"\xd0\xcf\x11\xe0", "an old Office or E-Prime binary file", _CSV_HINT),
    (r"RDA[23]\n|A\n", "an R data file in ASCII", "In R: saveRDS(table, 'trials.rds')."),
    (
        r"MATLAB 7\.3",
        "a MATLAB file of version 7.3, which percept does not read",
        "Save it in MATLAB as save('T.mat', '-v7'), or by writetable(T, 'T.csv').",
    ),
    (r"Octave-1-|# Created by Octave", "a file of Octave's own", "In Octave, save with -v7."),
    (r"\x89HDF|\$FL[23]|<stata_dta>|%PDF", "another program's binary file", _CSV_HINT),
    (
        r"PK\x03\x04|\x1f\x8b|Rar!|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd",
        "an archive inside an archive, or in a format not read here",
        "Unpack it, or pack it as .zip or .gz.",
    ),
    (
        r"\s*\*\*\* Header Start \*\*\*",
        "an E-Prime log in frames, not a table",
        "In E-DataAid or E-Merge export it as tab-delimited or CSV text and read that.",
    ),
    (
        r"\s*reversal(Intensities|Indices)=",
        "PsychoPy's text summary of a staircase, not a table of trials",
        _TRIALS_HINT,
    ),
    # Means and raw values of conditions, or a block of extraInfo below them.
    (
        r"(?=[^\r\n]*_raw\b)[^\r\n]*_(mean|std)\b|(?ms:(?=.*?^[\t,; ]*extraInfo[\t,; ]*\r?$))",
        "PsychoPy's summary of conditions, not a table of trials",
        _TRIALS_HINT,
    ),
    (r"\s*(<!doctype|<html|<\?xml)", "a web page or XML, not a table", _CSV_HINT),
)


def expand(paths: Sequence[str | Path]) -> tuple[dict[str, bool], list[Notice]]:
    """Expand folders and globs to files, in the order given, and say what is left out.

    Of each file stands whether somebody named it, or a pattern that it fits.
    """
    if not paths:
        raise UsageError("no file was given.", hint="Name at least one session file or folder.")
    files: dict[Path, tuple[str, bool]] = {}  # By where their paths lead
    notices: list[Notice] = []
    for given in paths:
        if not isinstance(given, str | os.PathLike):
            hint = "A DataFrame goes to Sessions.from_frame."
            raise UsageError(f"a path is text, not {type(given).__name__}.", hint=hint)
        text = str(given)
        is_folder = Path(text).is_dir()
        if is_folder:
            names, results = _tables(Path(text))
            notices += [Notice("a folder of results is not read", file=name) for name in results]
        else:
            names = _named(text)
        if not names:
            message = "no file fits the pattern."
            if is_folder:
                message = f"the folder holds no table ({', '.join(_SUFFIXES)})."
            raise UsageError(message, file=text, hint="Check the path; quote a pattern in a shell.")
        for name in names:
            place = Path(name).resolve()
            if place in files:
                notices.append(Notice("a file that is named more than once is read once"))
            files.setdefault(place, (name, not is_folder))
    return dict(files.values()), notices


def _named(text: str) -> list[str]:
    """Return a file, or the files that a pattern fits, sorted."""
    place, _ = named_part(text)
    if Path(place).exists():
        return [text]
    if not any(sign in text for sign in "*?["):
        raise UsageError("there is no such file.", file=text, hint="Check the path.")
    # Path.glob takes no absolute pattern, and finds hidden files.
    names = sorted(glob.glob(text, recursive=True))  # noqa: PTH207
    return [name for name in names if not Path(name).is_dir()]


def named_part(text: str) -> tuple[str, str | None]:
    """Split "file.db::table" into the file and its part; None where no part is named."""
    place, separator, part = text.rpartition("::")
    if separator and not Path(text).exists() and Path(place).exists():
        return place, part
    return text, None


def _tables(folder: Path) -> tuple[list[str], list[str]]:
    """Look for tables and folders of results in a folder and those below it."""
    filled = {path.parent for path in folder.rglob(_MARKER)} - {folder}
    tables = [
        str(path)
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in _SUFFIXES
        and path.is_file()
        and filled.isdisjoint(path.parents)
        and not _is_hidden(path.relative_to(folder))
    ]
    return tables, sorted(map(str, filled))


def _is_hidden(path: PurePath) -> bool:
    """Whether a path is what a system or a program hides."""
    return any(part.startswith((".", "~$", "__MACOSX")) and part != ".." for part in path.parts)


def ids_from_name(path: str, pattern: str | None, *, file: str) -> dict[str, str]:
    """Ids in a file's name and folders, by the scene's pattern.

    A pattern with "/" goes over as many folders. "*" stands for anything; an id then ends where
    what follows it in the pattern first stands.
    """
    if pattern is None:
        return {}
    *folders, name = PurePath(path).parts[-1 - pattern.count("/") :]
    name = "/".join([*folders, _ENDS.sub("", name)])
    text = re.escape(pattern).replace(r"\*", "[^/]*")
    longest = re.fullmatch(_ID.sub(r"(?P<\1>[^/]+)", text), name)
    shortest = re.fullmatch(_ID.sub(r"(?P<\1>[^/]+?)", text), name)
    if longest is None or shortest is None:
        hint = "Correct [sessions] filename."
        raise UsageError(f"the name does not fit the pattern {pattern!r}.", file=file, hint=hint)
    if "*" not in pattern and longest.groupdict() != shortest.groupdict():
        message = f"the name fits the pattern {pattern!r} in more than one way."
        hint = "Put separators into [sessions] filename that do not occur in the ids."
        raise UsageError(message, file=file, hint=hint)
    return shortest.groupdict()


@dataclass(frozen=True)
class Input:
    """One file to read: its name for messages, its path on disk or in an archive, its bytes."""

    name: str
    path: str
    data: bytes
    limits: FileLimits
    part: str | None = None  # The sheet, table or variable that is named behind "::"

    def hold_table(self, rows: int, columns: int) -> None:
        """Refuse a table of more rows or cells than the limits."""
        self.limits.hold_table(rows, columns, self.name)


@contextmanager
def refusing(file: str, what: str = "file") -> Iterator[None]:
    """Refuse a file in which a reader meets what it cannot read, or that needs another package."""
    try:
        yield
    except UsageError as error:
        error.file = file
        raise
    except ImportError as error:
        hint = f"Install it: pip install {error.name}."
        raise UsageError(f"this file needs {error.name}.", file=file, hint=hint) from None
    # What readers meet in a broken file escapes: KeyError, zlib.error and others.
    except Exception as error:  # noqa: BLE001
        message = f"a broken {what}: {str(error).rstrip('.')}."
        hint = "Write it again without a password, or as CSV."
        raise UsageError(message, file=file, hint=hint) from None


def load(name: str, limits: FileLimits) -> Iterator[Input]:
    """Read one path; an archive gives its members, in memory only."""
    place, part = named_part(name)
    try:
        with Path(place).open("rb") as stream:
            data = stream.read(limits.size + 1)
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}.", file=name) from None
    limits.hold("size", len(data), name)
    if data.startswith(_ZIP) and not re.match(WORKBOOK, data):
        yield from _members(data, name, limits)
        return
    for signature, unpack in _OPENERS.items():
        if data.startswith(signature):
            data = _unpacked(partial(unpack, io.BytesIO(data)), name, limits)
            break
    yield Input(name, place, data, limits, part)


def csv_frame(path: str, limits: FileLimits) -> pd.DataFrame:
    """Read a CSV of numbers within the limits, packed or not.

    Parameters
    ----------
    path : str
        The file.
    limits : FileLimits
        Most bytes, unpacked too, rows and cells.

    Returns
    -------
    DataFrame

    Raises
    ------
    UsageError
        The file cannot be read, or passes a limit.
    """
    entry, *_ = load(path, limits)
    try:
        table = pd.read_csv(io.BytesIO(entry.data))
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error
    limits.hold_table(len(table), len(table.columns), path)
    return table


def _members(data: bytes, name: str, limits: FileLimits) -> Iterator[Input]:
    """Unpack the tables of a zip archive, one by one."""
    with refusing(name, "archive"):
        archive = zipfile.ZipFile(io.BytesIO(data))
    limits.hold("size", sum(member.file_size for member in archive.infolist()), name)
    tables = [
        member
        for member in sorted(archive.namelist())
        if member.lower().endswith(_PACKED) and not _is_hidden(PurePath(member))
    ]
    if not tables:
        raise UsageError(f"the archive holds no table ({', '.join(_PACKED)}).", file=name)
    for member in tables:
        content = _unpacked(partial(archive.open, member), f"{name}!{member}", limits)
        # Some archivers write backslashes.
        yield Input(f"{name}!{member}", member.replace("\\", "/"), content, limits)


def _unpacked(packed: Callable[[], Any], name: str, limits: FileLimits) -> bytes:
    """Unpack one table, and no more of it than the limit."""
    content = io.BytesIO()
    with refusing(name, "archive"), packed() as stream:
        while content.tell() <= limits.size and (part := stream.read(_BLOCK)):
            content.write(part)
    limits.hold("size", content.tell(), name)
    return content.getvalue()


def decode(entry: Input, declared: str | None) -> tuple[str, str]:
    """Decode an input, and name its encoding.

    A byte-order mark says it, then the scene; else it is strict UTF-8, then Windows-1252.
    """
    data = entry.data
    if not data:
        hint = "Leave it out, or export it again."
        raise NoDataError("the file is empty.", file=entry.name, hint=hint)
    _refuse_no_table(data[:_EARLY].decode("latin-1"), entry.name)
    for mark, marked in _BYTE_ORDER_MARKS.items():
        if data.startswith(mark):
            data = data[len(mark) :]
            declared = marked
            break
    encoding = declared or "utf-8"
    try:
        text = _decoded(data, encoding, entry.name)
    except UsageError as problem:
        if declared:
            raise
        # A byte that leads a letter in UTF-8, and one that follows.
        if re.search(rb"[\xc3-\xf4][\x80-\xbf]", data):
            problem.hint = _ENCODINGS_HINT
            raise
        encoding = "cp1252"
        text = _decoded(data, encoding, entry.name)
    before, nul, _ = text.partition("\0")
    if nul:
        message = "a NUL character: this is a binary file, or UTF-16 without a byte-order mark."
        hint = 'Export it as CSV in UTF-8, or declare [sessions] encoding = "utf-16-le".'
        raise UsageError(message, file=entry.name, row=_row_below(before), hint=hint)
    _refuse_no_table(text[:_EARLY], entry.name)
    return text, encoding


def _decoded(data: bytes, encoding: str, file: str) -> str:
    """Decode bytes, or say which of them is no text."""
    try:
        text = data.decode(encoding)
        # Escapes may write half of a character, which no file can hold.
        text.encode()
        return text
    except LookupError:
        hint = 'Use a name such as "utf-8".'
        raise UsageError(f"unknown encoding {encoding!r}.", hint=hint) from None
    except UnicodeError as error:
        start = getattr(error, "start", 0)
        row = _row_below(data[:start].decode("latin-1"))
        message = f"byte 0x{data[start]:02x} is not text in {encoding}."
        raise UsageError(message, file=file, row=row, hint=_CSV_HINT) from None


def _row_below(text: str) -> int:
    """Line that a text ends on; CR LF, LF or CR ends one."""
    return 1 + max(text.count("\n"), text.count("\r"))


def _refuse_no_table(text: str, file: str) -> None:
    """Refuse what begins as no table does."""
    for pattern, what, hint in _NO_TABLES:
        if re.match(pattern, text, re.IGNORECASE):
            raise UsageError(f"this is {what}.", file=file, hint=hint)
