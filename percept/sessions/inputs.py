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
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

from percept.errors import UsageError
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError, Notice

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
#: What broken and locked archives raise.
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    OSError,
    NotImplementedError,
    EOFError,
    RuntimeError,
    ValueError,
)
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
#: What a zip archive holds that is an Excel workbook.
_WORKBOOK = "xl/workbook.xml"
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
    files: dict[str, bool] = {}
    resolved: set[Path] = set()  # Where their paths lead
    notices: list[Notice] = []
    for given in paths:
        if not isinstance(given, str | os.PathLike):
            hint = "A DataFrame goes to Sessions.from_frame."
            raise UsageError(f"a path is text, not {type(given).__name__}.", hint=hint)
        text = str(given)
        is_folder = Path(text).is_dir()
        if is_folder:
            names, results = _inside(Path(text))
            notices += [Notice("a folder of results is not read", file=name) for name in results]
        else:
            names = _named(text)
        for name in names:
            place = Path(name).resolve()
            if place in resolved:
                notices.append(Notice("a file that is named more than once is read once"))
            else:
                files[name] = not is_folder
            resolved.add(place)
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


@dataclass(frozen=True)
class Input:
    """One file to read: its name for messages, its path on disk or in an archive, its bytes."""

    name: str
    path: str
    data: bytes
    part: str | None = None  # The sheet, table or variable that is named behind "::"


def load(name: str, limits: FileLimits) -> Iterator[Input]:
    """Read one path; an archive gives its members, in memory only."""
    place, part = named_part(name)
    try:
        with Path(place).open("rb") as stream:
            status = os.fstat(stream.fileno())
            if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
                raise UsageError("this is a device, not a file.", file=name, hint="Check the path.")
            limits.hold_size(status.st_size, name)
            data = stream.read(limits.size + 1)
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}.", file=name) from None
    limits.hold_size(len(data), name)
    if data.startswith(_ZIP):
        with _archive(data, name) as archive:
            limits.hold_size(sum(member.file_size for member in archive.infolist()), name)
            if _WORKBOOK not in archive.namelist():
                yield from _members(archive, name, limits)
                return
    for signature, unpack in _OPENERS.items():
        if data.startswith(signature):
            data = _unpacked(partial(unpack, io.BytesIO(data)), name, limits)
            break
    yield Input(name, place, data, part)


def is_workbook(data: bytes, name: str) -> bool:
    """Whether bytes are a zip archive that is an Excel workbook."""
    if not data.startswith(_ZIP):
        return False
    with _archive(data, name) as archive:
        return _WORKBOOK in archive.namelist()


def _archive(data: bytes, name: str) -> zipfile.ZipFile:
    """Open a zip archive, or say that it is broken."""
    try:
        return zipfile.ZipFile(io.BytesIO(data))
    except _BROKEN as error:
        raise UsageError(f"a broken archive: {error}.", file=name, hint="Pack it again.") from None


def _members(archive: zipfile.ZipFile, name: str, limits: FileLimits) -> Iterator[Input]:
    """Unpack the tables of an archive, one by one."""
    tables = [
        member
        for member in sorted(archive.namelist())
        if member.lower().endswith(PACKED) and not is_hidden(PurePath(member))
    ]
    if not tables:
        raise UsageError(f"the archive holds no table ({', '.join(PACKED)}).", file=name)
    for member in tables:
        content = _unpacked(partial(archive.open, member), f"{name}!{member}", limits)
        # Some archivers write backslashes.
        yield Input(f"{name}!{member}", member.replace("\\", "/"), content)


def _unpacked(packed: Callable[[], Any], name: str, limits: FileLimits) -> bytes:
    """Unpack one table, and no more of it than the limit."""
    content = io.BytesIO()
    try:
        with packed() as stream:
            while (size := content.tell()) <= limits.size and (part := stream.read(_BLOCK)):
                content.write(part)
    except _BROKEN as error:
        hint = "Pack it again, without a password, or unpack it first."
        raise UsageError(f"a broken archive: {error}.", file=name, hint=hint) from None
    limits.hold_size(size, name)
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
        # Refuses what codecs knows beside encodings of text, too.
        io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        return codecs.getincrementaldecoder(encoding)().decode(data, final=True)
    except LookupError:
        hint = 'Use a name such as "utf-8".'
        raise UsageError(f"unknown encoding {encoding!r}.", hint=hint) from None
    except UnicodeError as error:
        # A missing byte-order mark is an error of decoding since Python 3.13 only.
        if not isinstance(error, UnicodeDecodeError) or "BOM" in error.reason:
            message = f"not text in {encoding}: {error}."
            hint = 'Declare the byte order, [sessions] encoding = "utf-16-le", or another name.'
            raise UsageError(message, file=file, hint=hint) from None
        row = _row_below(data[: error.start].decode(encoding, "replace"))
        message = f"byte 0x{data[error.start]:02x} is not text in {encoding}."
        raise UsageError(message, file=file, row=row, hint=_CSV_HINT) from None


def _row_below(text: str) -> int:
    """Line that a text ends on; CR LF, LF and CR each end one."""
    return 1 + text.count("\n") + text.count("\r") - text.count("\r\n")


def _refuse_no_table(text: str, file: str) -> None:
    """Refuse what begins as no table does."""
    for pattern, what, hint in _NO_TABLES:
        if re.match(pattern, text, re.IGNORECASE):
            raise UsageError(f"this is {what}.", file=file, hint=hint)
