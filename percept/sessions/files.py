"""Paths to bytes and text: folders, globs, archives, encodings, and files that are no tables."""

from __future__ import annotations

import codecs
import glob
import gzip
import hashlib
import io
import os
import re
import sys
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import IO, BinaryIO, NamedTuple, TextIO

from percept.errors import UsageError, counted
from percept.sessions.records import NoDataError, Notice

#: What tells a folder of results from one of sessions.
_RESULTS = ("report.sha256", "fit.sha256", "reproduction.sha256", "batch.parquet")
#: Suffixes of files of other kinds that are named.
_KINDS = 6
_SUFFIXES = (".csv", ".tsv", ".tab", ".txt", ".gz", ".zip", ".parquet", ".xlsx")
#: An archive that claims or gives more than this is refused: unpacked files of any size can be read.
LIMIT = 1 << 30
_BROKEN = (
    zipfile.BadZipFile, zlib.error, OSError, NotImplementedError, EOFError, RuntimeError, ValueError,
)  # fmt: skip
#: Files are read in blocks of about this many characters; from a sixteenth of it on by pandas' parser.
BLOCK = 8 << 20
#: Files of experiment software show early what they are; the bound keeps the search short.
_EARLY = 20_000

_MARKS = (
    # UTF-32's little-endian mark begins with UTF-16's, so it is looked for first.
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_R = (rb"(RD[AX][23]\n|[XA]\n\0\0\0)", "an R data file, which only R opens",
      "In R: write.csv(table, 'trials.csv').")  # fmt: skip
#: Their compression may hide what is in them.
_R_SUFFIXES = (".rda", ".rdata", ".rds")
_BINARY = (
    (rb"\x80[\x02-\x05]", "a Python pickle (PsychoPy's .psydat), which is never opened",
     "Use the .csv that PsychoPy writes next to it."),
    (rb"\xd0\xcf\x11\xe0", "an old Office or E-Prime binary file", "Save it as .xlsx, or as CSV in UTF-8."),
    _R,
    (rb"(MATLAB 5|\x89HDF)", "a MATLAB or HDF5 file", "In MATLAB: writetable(T, 'trials.csv')."),
    (rb"(\$FL[23]|<stata_dta>)", "an SPSS or Stata file", "Export the data as CSV."),
    (rb"%PDF", "a PDF", "Use the table it was made from, as CSV."),
    (rb"SQLite format 3", "a database file", "Export the table from it as CSV."),
    (rb"(Rar!|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd)", "an archive in a format not read here",
     "Unpack it, or pack it as .zip or .gz."),
)  # fmt: skip
_NO_TABLES = (
    (r"\s*\*\*\* Header Start \*\*\*", "an E-Prime log in frames, not a table",
     "In E-DataAid or E-Merge export it as tab-delimited or CSV text and read that."),
    (r"\s*reversal(Intensities|Indices)=", "PsychoPy's text summary of a staircase, not a table of trials",
     "Use the trial-by-trial .csv that PsychoPy writes next to it."),
    (r"\s*(<!doctype|<html|<\?xml)", "a web page or XML, not a table", "Export the data as CSV."),
    (r"\s*(\{\s*[\"}]|\[\s*[\[{])", "JSON, not a table",
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


class Expanded(NamedTuple):
    """What paths stand for."""

    files: list[str]  # In the order given
    inside: frozenset[str]  # Files that a folder held, and nobody named
    notices: list[Notice]  # What is left out


def expand(paths: Sequence[str | Path], wants: Callable[[str], bool] = lambda _: True) -> Expanded:
    """Expand folders and globs to files; of a folder's tables those that are wanted."""
    if not paths:
        raise UsageError("no file was given.", hint="Name at least one session file or folder.")
    files: dict[str, str] = {}  # From where a path leads to its name
    inside: set[str] = set()
    results: list[str] = []
    kinds: Counter[str] = Counter()
    left = repeated = 0
    for given in paths:
        if not isinstance(given, str | os.PathLike):
            hint = "A DataFrame goes to Sessions.from_frame."
            raise UsageError(f"a path is text, not {type(given).__name__}.", hint=hint)
        text = str(given)
        if Path(text).is_dir():
            tables, others, filled = _inside(Path(text))
            if not tables:
                message = f"the folder holds no table ({', '.join(_SUFFIXES)})."
                raise UsageError(message, file=text, hint="Check the path.")
            found = [name for name in tables if wants(name)]
            inside.update(found)
            left += len(tables) - len(found)
            kinds.update(Path(name).suffix or Path(name).name for name in others)
            results += filled
        elif text == "-" or Path(text).exists():
            found = [text]
        elif is_pattern(text):
            found = [name for name in fitting(text) if not Path(name).is_dir()]
            if not found:
                hint = "Check it, and quote it in a shell."
                raise UsageError("no file fits the pattern.", file=text, hint=hint)
        else:
            raise UsageError("there is no such file.", file=text, hint="Check the path.")
        for name in found:
            own = name if name == "-" else str(Path(name).resolve())
            repeated += own in files
            files.setdefault(own, name)
    if not files:
        message, hint = "no file in the folders fits include and exclude.", "Correct the patterns."
        raise UsageError(message, key="sessions.files", hint=hint)
    notices = [Notice("a folder of results is not read", file=folder) for folder in results]
    if kinds:
        text = f"{counted(kinds.total(), 'file')} of other kinds in the folders not read"
        notices.append(Notice(f"{text} ({', '.join(sorted(kinds)[:_KINDS])})"))
    if left:
        notices.append(Notice(f"{counted(left, 'file')} in the folders left out by [sessions.files]"))
    if repeated:
        notices.append(Notice("a file that is named more than once is read once"))
    return Expanded(list(files.values()), frozenset(inside), notices)


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


def _inside(folder: Path) -> tuple[list[str], list[str], list[str]]:
    """Look for tables, other files and folders of results in a folder and those below it."""
    filled = {p.parent for name in _RESULTS for p in folder.rglob(name)} - {folder}
    tables: list[str] = []
    others: list[str] = []
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not _hidden(path.relative_to(folder)) and filled.isdisjoint(path.parents):
            (tables if path.suffix.lower() in _SUFFIXES else others).append(str(path))
    return tables, others, sorted(map(str, filled))


def _hidden(path: PurePath) -> bool:
    return any(part.startswith((".", "~$", "__MACOSX")) and part != ".." for part in path.parts)


def load(name: str) -> Iterator[Input]:
    """Read one path; an archive gives its members, in memory only."""
    label = "standard input" if name == "-" else name
    large = False
    try:
        if name == "-":
            data = sys.stdin.buffer.read()
        else:
            with Path(name).open("rb") as stream:
                data = stream.read(4)
                large = os.fstat(stream.fileno()).st_size > BLOCK // 16
                if not large or data.startswith((b"\x1f\x8b", b"PK\x03\x04", b"PAR1")):
                    large, data = False, data + stream.read()
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}.", file=name) from None
    if large:
        yield Input(label, name)
    elif data.startswith(b"\x1f\x8b"):
        yield Input(label, name, _unpacked(partial(gzip.open, io.BytesIO(data)), label, "gz file"))
    elif data.startswith(b"PK\x03\x04") and not is_workbook(data, label):
        yield from _members(data, label)
    else:
        yield Input(label, name, data)


def is_workbook(data: bytes, name: str) -> bool:
    """Whether a zip archive is an Excel workbook."""
    with _open(data, name) as archive:
        return "xl/workbook.xml" in archive.namelist()


def _open(data: bytes, name: str) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except _BROKEN as error:
        raise UsageError(f"a broken zip archive: {error}.", file=name, hint="Pack it again.") from None
    for member in archive.infolist():
        if member.file_size > LIMIT:
            message = f"a member claims {member.file_size} bytes; more than {LIMIT} are not unpacked."
            hint = "If it is real, unpack it and read the file itself."
            raise UsageError(message, file=name, value=member.filename[:60], hint=hint)
    return archive


def _members(data: bytes, name: str) -> Iterator[Input]:
    packed = _SUFFIXES[:4]
    with _open(data, name) as archive:
        members = [
            m
            for m in sorted(archive.infolist(), key=lambda m: m.filename)
            if not m.is_dir() and m.filename.lower().endswith(packed) and not _hidden(PurePath(m.filename))
        ]
        if not members:
            raise UsageError(f"the archive holds no table ({', '.join(packed)}).", file=name)
        for member in members:
            label = f"{name}!{member.filename}"
            if member.flag_bits & 1:
                raise UsageError("the archive is encrypted.", file=label, hint="Unpack it first.")
            content = _unpacked(partial(archive.open, member), label, "zip member")
            # Some archivers write backslashes.
            yield Input(label, member.filename.replace("\\", "/"), content)


def _unpacked(packed: Callable[[], IO[bytes] | gzip.GzipFile], name: str, what: str) -> bytes:
    """Unpack one table, if it is no archive itself, and no more than the limit."""
    try:
        with packed() as stream:
            content = stream.read(LIMIT + 1)
    except _BROKEN as error:
        raise UsageError(f"a broken {what}: {error}.", file=name, hint="Pack it again.") from None
    if len(content) > LIMIT:
        hint = "Unpack it and read the file itself."
        raise UsageError(f"unpacks to more than {LIMIT} bytes.", file=name, hint=hint)
    if content.startswith((b"\x1f\x8b", b"PK\x03\x04")):
        raise UsageError("an archive inside an archive.", file=name, hint="Unpack the outer one first.")
    return content


def ids_from_name(path: str, pattern: str | None, *, file: str) -> dict[str, str]:
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
        hint = "Correct [sessions] filename."
        raise UsageError(f"the name does not fit the pattern {pattern!r}.", file=file, hint=hint)
    if readings[0] != readings[1]:
        hint = "Put separators into [sessions] filename that do not occur in the ids."
        raise UsageError(f"the name fits the pattern {pattern!r} in more than one way.", file=file, hint=hint)
    return readings[0]


def open_text(entry: Input, declared: str | None) -> tuple[TextIO, str]:
    """Open an input as text, and name its encoding: by its mark, else strict UTF-8, else Windows-1252."""
    with entry.open() as stream:
        head = stream.read(_EARLY)
        _refuse_binary(head, entry.name)
        mark, marked = next(((m, name) for m, name in _MARKS if head.startswith(m)), (b"", None))
        settled = _settled(declared, marked)
        *others, encoding = [settled] if declared or marked else ["cp1252", "utf-8"]
        while problem := _undecodable(stream, encoding, entry.name, start=len(mark)):
            if not others:
                raise problem
            encoding = others.pop()
    with _text_from(entry, encoding, len(mark)) as early:
        _refuse_text(early.read(_EARLY), entry.name)
    return _text_from(entry, encoding, len(mark)), encoding


def _text_from(entry: Input, encoding: str, start: int) -> TextIO:
    stream = entry.open()
    stream.seek(start)
    return io.TextIOWrapper(stream, encoding=encoding, newline="")


def _settled(declared: str | None, marked: str | None) -> str:
    """Return the declared encoding, its byte order by the mark; else the marked one."""
    if declared is None:
        return marked or "utf-8"
    try:
        # Refuses what codecs knows beside encodings of text, too.
        io.TextIOWrapper(io.BytesIO(), encoding=declared)
        family = codecs.lookup(declared).name
    except LookupError:
        hint = 'Use a name such as "utf-8".'
        raise UsageError(f"unknown encoding {declared!r}.", hint=hint) from None
    return marked if marked is not None and marked.startswith(f"{family}-") else declared


def _undecodable(stream: BinaryIO, encoding: str, file: str, *, start: int) -> UsageError | None:
    """Decode all bytes; return what is wrong with the first that are no text, and raise on a NUL."""
    decoder = codecs.getincrementaldecoder(encoding)()
    position, data = 0, b"-"
    stream.seek(start)
    while data:
        data = stream.read(BLOCK)
        pending = len(decoder.getstate()[0])
        try:
            text = decoder.decode(data, final=not data)
        except UnicodeDecodeError as error:
            position += error.start - pending
            beside = " (nor in UTF-8)" if encoding == "cp1252" else ""
            message = f"byte {position + 1} is not text in {encoding}{beside}."
            stream.seek(start)
            row = 1 + stream.read(position).count(b"\n")
            return UsageError(message, file=file, row=row, hint="Export the table again as CSV in UTF-8.")
        if (nul := text.find("\0")) >= 0:
            stream.seek(start)
            before = stream.read(position).decode(encoding, errors="ignore")
            message = "a NUL character: this is a binary file, or UTF-16 without a byte-order mark."
            hint = 'Export it as CSV in UTF-8, or declare [sessions] encoding = "utf-16-le".'
            raise UsageError(message, file=file, row=1 + line_ends(before + text[:nul]), hint=hint)
        position += len(data)
    return None


def line_ends(text: str) -> int:
    """How many lines end in a text; CR LF, LF and CR each end a line."""
    return text.count("\n") + (text.count("\r") - text.count("\r\n") if "\r" in text else 0)


def _refuse_binary(data: bytes, file: str) -> None:
    if not data:
        raise NoDataError("the file is empty.", file=file, hint="Leave it out, or export it again.")
    for pattern, what, hint in _BINARY:
        if re.match(pattern, data):
            if file.lower().endswith(_R_SUFFIXES):
                what, hint = _R[1:]
            raise UsageError(f"this is {what}.", file=file, hint=hint)


def _refuse_text(text: str, file: str) -> None:
    for pattern, what, hint in _NO_TABLES:
        if re.match(pattern, text, re.IGNORECASE):
            raise UsageError(f"this is {what}.", file=file, hint=hint)
    # PsychoPy's summary holds means and raw values of conditions, or a block of extraInfo follows them.
    lines = text.splitlines()
    header = re.split(r"[\t,;]", lines[0].strip()) if lines else []
    raw = any(name.endswith("_raw") for name in header)
    averaged = any(name.endswith(("_mean", "_std")) for name in header)
    if (raw and averaged) or any(line.strip("\t,; ") == "extraInfo" for line in lines):
        message = "this is PsychoPy's summary of conditions, not a table of trials."
        hint = "Use the trial-by-trial .csv (saveAsWideText) that PsychoPy writes next to it."
        raise UsageError(message, file=file, hint=hint)
