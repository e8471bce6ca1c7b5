"""Paths to bytes and text: folders, globs, archives, encodings, and files that are no tables."""

from __future__ import annotations

import codecs
import glob
import gzip
import hashlib
import io
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import IO, BinaryIO, TextIO

from percept.errors import UsageError
from percept.sessions.options import FileLimits
from percept.sessions.records import NoDataError, Notice

#: What tells a folder of results from one of sessions.
_RESULTS = ("report.sha256", "fit.sha256", "reproduction.sha256", "batch.sha256")
_PACKED = (".csv", ".tsv", ".tab", ".txt")
_SUFFIXES = (*_PACKED, ".gz", ".zip", ".parquet", ".xlsx")
#: R's files; their compression may hide what is in them.
_R_SUFFIXES = (".rda", ".rdata", ".rds")
_BROKEN = (
    zipfile.BadZipFile, zlib.error, OSError, NotImplementedError, EOFError, RuntimeError, ValueError,
)  # fmt: skip
#: Files are read in blocks of about this many characters; from a sixteenth of it on by pandas'
#: parser.
BLOCK = 8 << 20
#: Files of experiment software show early what they are; the bound keeps the search short.
_EARLY = 20_000
_GZIP = b"\x1f\x8b"
_ZIP = b"PK\x03\x04"
#: What a zip archive holds that is an Excel workbook.
_WORKBOOK = "xl/workbook.xml"

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_CSV = "Export the data as CSV in UTF-8."
_TRIALS = "Use the trial-by-trial .csv that PsychoPy writes next to it."
_R = ("an R data file, which only R opens", "In R: write.csv(table, 'trials.csv').")
#: How files begin that are no tables of text, as bytes (each a character here) or as text.
_NO_TABLES = (
    (r"\x80[\x02-\x05]", "a Python pickle (PsychoPy's .psydat), which is never opened", _TRIALS),
    (r"\xd0\xcf\x11\xe0", "an old Office or E-Prime binary file", _CSV),
    (r"RD[AX][23]\n|[XA]\n\0\0\0", *_R),
    (r"MATLAB 5|\x89HDF|\$FL[23]|<stata_dta>|%PDF|SQLite format 3", "another program's binary file", _CSV),
    (r"PK\x03\x04|\x1f\x8b|Rar!|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd",
     "an archive inside an archive, or in a format not read here", "Unpack it, or pack it as .zip or .gz."),
    (r"\s*\*\*\* Header Start \*\*\*", "an E-Prime log in frames, not a table",
     "In E-DataAid or E-Merge export it as tab-delimited or CSV text and read that."),
    (r"\s*reversal(Intensities|Indices)=", "PsychoPy's text summary of a staircase, not a table of trials",
     _TRIALS),
    # Means and raw values of conditions, or a block of extraInfo below them.
    (r"(?=[^\r\n]*_raw\b)[^\r\n]*_(mean|std)\b|(?ms:(?=.*?^[\t,; ]*extraInfo[\t,; ]*\r?$))",
     "PsychoPy's summary of conditions, not a table of trials", _TRIALS),
    (r"\s*(<!doctype|<html|<\?xml|\{\s*[\"}]|\[\s*[\[{])", "a web page, XML or JSON, not a table",
     "Export it as CSV (jsPsych: jsPsych.data.get().csv())."),
)  # fmt: skip


@dataclass(frozen=True)
class Input:
    """One table to read: its name for messages, and the path of the file or archive member."""

    name: str
    path: str
    data: bytes | None = None  # None: a large file, read from `path` in blocks

    def open(self) -> io.BufferedReader | io.BytesIO:
        """Give its bytes from the start."""
        return Path(self.path).open("rb") if self.data is None else io.BytesIO(self.data)

    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the bytes."""
        with self.open() as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()


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
        if is_folder := Path(text).is_dir():
            tables, results = _inside(Path(text))
            if not tables:
                message = f"the folder holds no table ({', '.join(_SUFFIXES)})."
                raise UsageError(message, file=text, hint="Check the path.")
            found = [name for name in tables if wants(name)]
            notices += [Notice("a folder of results is not read", file=name) for name in results]
        elif Path(text).exists():
            found = [text]
        elif is_pattern(text):
            found = [name for name in fitting(text) if not Path(name).is_dir()]
            if not found:
                hint = "Check it, and quote it in a shell."
                raise UsageError("no file fits the pattern.", file=text, hint=hint)
        else:
            raise UsageError("there is no such file.", file=text, hint="Check the path.")
        for name in found:
            place = str(Path(name).resolve())
            if place in places:
                notices.append(Notice("a file that is named more than once is read once"))
            else:
                files[name] = not is_folder
            places.add(place)
    if not files:
        message, hint = "no file in the folders fits include and exclude.", "Correct the patterns."
        raise UsageError(message, key="sessions.files", hint=hint)
    return files, notices


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
        return not any((found / name).exists() for name in _RESULTS) and bool(_inside(found)[0])
    return found.suffix.lower() in _SUFFIXES


def _inside(folder: Path) -> tuple[list[str], list[str]]:
    """Look for tables and folders of results in a folder and those below it."""
    filled = {p.parent for name in _RESULTS for p in folder.rglob(name)} - {folder}
    paths = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in _SUFFIXES and path.is_file()
    ]
    paths = [path for path in paths if filled.isdisjoint(path.parents)]
    return [str(path) for path in paths if not _hidden(path.relative_to(folder))], sorted(
        map(str, filled)
    )


def _hidden(path: PurePath) -> bool:
    return any(part.startswith((".", "~$", "__MACOSX")) and part != ".." for part in path.parts)


def load(name: str, limits: FileLimits) -> Iterator[Input]:
    """Read one path; an archive gives its members, in memory only."""
    if name.lower().endswith(_R_SUFFIXES):
        raise UsageError(f"this is {_R[0]}.", file=name, hint=_R[1])
    try:
        with Path(name).open("rb") as stream:
            status = os.fstat(stream.fileno())
            if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
                raise UsageError("this is a device, not a file.", file=name, hint="Check the path.")
            data = stream.read(4)
            if not data.startswith((_GZIP, _ZIP, b"PAR1")) and status.st_size > BLOCK // 16:
                yield Input(name, name)
                return
            limits.hold_size(status.st_size, name)
            data += stream.read(limits.size)
            limits.hold_size(len(data), name)
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}.", file=name) from None
    if data.startswith(_GZIP):
        yield Input(name, name, _unpacked(partial(gzip.open, io.BytesIO(data)), name, limits))
    elif data.startswith(_ZIP):
        with _archive(data, name) as archive:
            limits.hold_size(sum(member.file_size for member in archive.infolist()), name)
            if _WORKBOOK in archive.namelist():
                yield Input(name, name, data)
            else:
                yield from _members(archive, name, limits)
    else:
        yield Input(name, name, data)


def is_workbook(data: bytes, name: str) -> bool:
    """Whether bytes are a zip archive that is an Excel workbook."""
    if not data.startswith(_ZIP):
        return False
    with _archive(data, name) as archive:
        return _WORKBOOK in archive.namelist()


def _archive(data: bytes, name: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(io.BytesIO(data))
    except _BROKEN as error:
        raise UsageError(f"a broken archive: {error}.", file=name, hint="Pack it again.") from None


def _members(archive: zipfile.ZipFile, name: str, limits: FileLimits) -> Iterator[Input]:
    tables = [
        member
        for member in sorted(archive.namelist())
        if member.lower().endswith(_PACKED) and not _hidden(PurePath(member))
    ]
    if not tables:
        raise UsageError(f"the archive holds no table ({', '.join(_PACKED)}).", file=name)
    for member in tables:
        content = _unpacked(partial(archive.open, member), f"{name}!{member}", limits)
        # Some archivers write backslashes.
        yield Input(f"{name}!{member}", member.replace("\\", "/"), content)


def _unpacked(
    packed: Callable[[], IO[bytes] | gzip.GzipFile], name: str, limits: FileLimits
) -> bytes:
    """Unpack one table, and no more of it than the limit."""
    content = io.BytesIO()
    try:
        with packed() as stream:
            while (size := content.tell()) <= limits.size and (part := stream.read(BLOCK)):
                content.write(part)
    except _BROKEN as error:
        hint = "Pack it again, without a password, or unpack it first."
        raise UsageError(f"a broken archive: {error}.", file=name, hint=hint) from None
    limits.hold_size(size, name)
    return content.getvalue()


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


def open_text(entry: Input, declared: str | None) -> tuple[TextIO, str]:
    """Open an input as text, and name its encoding.

    A byte-order mark says it, then the scene; else it is strict UTF-8, then Windows-1252.
    """
    with entry.open() as stream:
        head = stream.read(_EARLY)
        if not head:
            raise NoDataError(
                "the file is empty.", file=entry.name, hint="Leave it out, or export it again."
            )
        _refuse(head.decode("latin-1"), entry.name)
        mark, marked = next(
            ((m, name) for m, name in _MARKS if head.startswith(m)), (b"", declared)
        )
        *others, encoding = [marked] if marked else ["cp1252", "utf-8"]
        while problem := _undecodable(stream, encoding, entry.name, start=len(mark)):
            if not others:
                raise problem
            encoding = others.pop()
    with _text_from(entry, encoding, len(mark)) as early:
        _refuse(early.read(_EARLY), entry.name)
    return _text_from(entry, encoding, len(mark)), encoding


def _text_from(entry: Input, encoding: str, start: int) -> TextIO:
    stream = entry.open()
    stream.seek(start)
    return io.TextIOWrapper(stream, encoding=encoding, newline="")


def _undecodable(stream: BinaryIO, encoding: str, file: str, *, start: int) -> UsageError | None:
    """Decode all bytes; return what is wrong with the first that are no text, and raise on a NUL."""
    try:
        # Refuses what codecs knows beside encodings of text, too.
        io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        decoder = codecs.getincrementaldecoder(encoding)()
    except LookupError:
        hint = 'Use a name such as "utf-8".'
        raise UsageError(f"unknown encoding {encoding!r}.", hint=hint) from None
    stream.seek(start)
    row, data = 1, b"-"
    while data:
        data = stream.read(BLOCK)
        try:
            text = decoder.decode(data, final=not data)
        except UnicodeError as error:
            if not isinstance(error, UnicodeDecodeError):
                message = f"not text in {encoding}: {error}."
                hint = 'Declare the byte order, [sessions] encoding = "utf-16-le", or another name.'
                return UsageError(message, file=file, hint=hint)
            row += error.object.count(b"\n", 0, error.start)
            message = f"byte 0x{error.object[error.start]:02x} is not text in {encoding}."
            return UsageError(message, file=file, row=row, hint=_CSV)
        row += line_ends(text.partition("\0")[0])
        if "\0" in text:
            message = "a NUL character: this is a binary file, or UTF-16 without a byte-order mark."
            hint = 'Export it as CSV in UTF-8, or declare [sessions] encoding = "utf-16-le".'
            raise UsageError(message, file=file, row=row, hint=hint)
    return None


def line_ends(text: str) -> int:
    """How many lines end in a text; CR LF, LF and CR each end a line."""
    return text.count("\n") + (text.count("\r") - text.count("\r\n") if "\r" in text else 0)


def _refuse(text: str, file: str) -> None:
    """Refuse what begins as no table does."""
    for pattern, what, hint in _NO_TABLES:
        if re.match(pattern, text, re.IGNORECASE):
            raise UsageError(f"this is {what}.", file=file, hint=hint)
