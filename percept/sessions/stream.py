"""Large plain files in blocks: pandas' C parser where it changes nothing, the careful path elsewhere.

pandas accepts what this reader does not ("True" for 1, short lines, "1e400"), so a block is taken from it
only if its bytes and numbers exclude all of these; any other block is read again, cell by cell. Ids are read
as objects: pandas makes the categories "001" and "1" of one column the same number.
"""

from __future__ import annotations

import csv
import ctypes
import hashlib
import io
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.cores import cores
from percept.errors import UsageError
from percept.sessions.columns import Resolution, resolve
from percept.sessions.decode import decode
from percept.sessions.dialect import read_grid, split_plain
from percept.sessions.numbers import MISSING, decimal_mark
from percept.sessions.observations import read_part
from percept.sessions.options import IDS, NUMBERS, ReadOptions
from percept.sessions.part import Part, check_columns
from percept.sessions.problems import Problems
from percept.sessions.units import convert

# Below this a file is read at once: the careful path takes about as long as starting this one.
LARGE = 4 << 20
_BLOCK = 8 << 20
_HEAD = 1 << 16
_NEWLINE = ord("\n")
_NA = sorted({form for word in MISSING for form in (word, word.upper(), word.capitalize(), "NaN")})
# Since pandas 3.1 the parser rounds correctly by default; before, it had to be asked.
_EXACT: dict[str, Any] = (
    {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
)


@dataclass
class Stream:
    """A large file, block by block."""

    file: str  # Its name
    part: Part  # Counts, notices and exclusions so far
    header: list[str]
    delimiter: str
    mark: Literal[".", ","]
    resolution: Resolution
    options: ReadOptions
    named: Mapping[str, str]
    problems: Problems
    skip: int
    sha256: str = ""  # Of the whole file
    _row: int = field(default=2, repr=False)

    def frames(self) -> Iterator[pd.DataFrame]:
        """Yield the observations of each block: the canonical columns and `row`."""
        digest = hashlib.sha256()
        pending: deque[tuple[bytes, Future[tuple[pd.DataFrame | None, int]]]] = deque()
        workers = min(4, cores())
        with ThreadPoolExecutor(workers) as pool, Path(self.file).open("rb") as source:
            digest.update(source.read(self.skip))
            for raw in self._blocks(source):
                # The parser lets go of the interpreter, and so does the digest: they run side by side.
                pending.append((raw, pool.submit(self._fast, raw)))
                digest.update(raw)
                if len(pending) > workers:
                    yield self._finish(*pending.popleft())
            while pending:
                yield self._finish(*pending.popleft())
        self.sha256 = digest.hexdigest()

    def _blocks(self, source: BinaryIO) -> Iterator[bytes]:
        """Cut the file after line ends."""
        while block := source.read(_BLOCK):
            line = source.readline(_BLOCK)
            if len(line) == _BLOCK:
                raise UsageError(
                    f"a line of more than {_BLOCK} bytes.",
                    file=self.file,
                    hint="This is no session table, or its line ends are lost.",
                )
            yield block + line

    def _fast(self, raw: bytes) -> tuple[pd.DataFrame | None, int]:
        """Parse a block with pandas, None where it needs the careful path; and count its lines."""
        if b'"' in raw or (b"\r" in raw and raw.count(b"\r") != raw.count(b"\r\n")):
            raise NotPlain
        characters = np.frombuffer(raw, dtype=np.uint8)
        lines = int(np.count_nonzero(characters == _NEWLINE)) + (characters[-1] != _NEWLINE)
        delimiters = int(np.count_nonzero(characters == ord(self.delimiter)))
        if b"\0" in raw or delimiters != lines * (len(self.header) - 1) or not _is_utf8(raw):
            return None, lines
        frame = self._parsed(raw)
        if frame is None or len(frame) != lines:
            return None, lines
        for c in (c for c in IDS if c in frame):
            frame[c] = _coded(np.ascontiguousarray(frame[c].to_numpy()))
        return (frame if self._unchanged(frame, raw) else None), lines

    def _parsed(self, raw: bytes) -> pd.DataFrame | None:
        columns = self.resolution.slots[0].columns
        names = {at: name for name, at in columns.items()}
        kinds: dict[str, Any] = {name: object if name in IDS else "float64" for name in columns}
        if "trial" in columns:
            kinds["trial"] = "int64"
        try:
            return pd.read_csv(
                io.BytesIO(raw),
                sep=self.delimiter,
                header=None,
                names=[names.get(at, at) for at in range(len(self.header))],
                usecols=list(columns),
                dtype=kinds,
                decimal=self.mark,
                keep_default_na=False,
                na_values={name: _NA for name in columns if name in NUMBERS},
                quoting=csv.QUOTE_NONE,
                skip_blank_lines=False,
                engine="c",
                **_EXACT,
            )
        except (ValueError, OverflowError):
            return None

    def _unchanged(self, frame: pd.DataFrame, raw: bytes) -> bool:
        """Whether no value can be one that pandas made of something else."""
        if any(not name.strip() for c in IDS if c in frame for name in frame[c].cat.categories):
            return False
        adjusted = np.zeros(len(frame), dtype=bool)
        for name in (c for c in NUMBERS if c in frame):
            values = frame[name].to_numpy()
            # 0 may be an underflow, inf an overflow or a word, nothing but ones a column of True.
            if (values == 0).any() or np.isinf(values).any() or ((values == 1).all() and _says_true(raw)):
                return False
            if name.endswith("_adj"):
                adjusted |= ~np.isnan(values)
        if "trial" in frame and bool((frame["trial"] <= 1).all()) and _says_true(raw):
            return False
        return bool(adjusted.all())

    def _finish(self, raw: bytes, parsed: Future[tuple[pd.DataFrame | None, int]]) -> pd.DataFrame:
        frame, lines = parsed.result()
        row, self._row = self._row, self._row + lines
        if frame is None:
            return self._careful(raw, row)
        self.part.counts["rows read"] += len(frame)
        for c in IDS:
            if c not in frame:
                frame[c] = np.full(len(frame), self.named.get(c, "1"), dtype=object)
        for c in NUMBERS:
            if c not in frame:
                frame[c] = np.nan
            elif self.resolution.rules[c].unit is not None:
                frame[c] = convert(frame[c].to_numpy(), self.resolution.rules[c].unit, c[0])
        if "trial" not in frame:
            frame["trial"] = np.int64(1)
        frame["row"] = np.arange(row, row + len(frame), dtype=np.int64)
        return frame

    def _careful(self, raw: bytes, row: int) -> pd.DataFrame:
        text = decode(raw, file=self.file, encoding="utf-8").text
        if not text.strip():
            self.part.counts["blank line"] += text.count("\n")
            return pd.DataFrame()
        grid = split_plain(text, self.header, delimiter=self.delimiter, file=self.file, first_row=row)
        options = replace(self.options, decimal=self.mark)
        part = read_part(grid, file=self.file, options=options, named=self.named, problems=self.problems)
        self.part.counts.update(part.counts)
        self.part.exclusions += part.exclusions
        return part.frame


class NotPlain(Exception):  # noqa: N818 - a control value: the caller reads the file as a whole
    """The file cannot be cut into blocks at its line ends."""


def open_stream(
    file: str, *, options: ReadOptions, named: Mapping[str, str], problems: Problems
) -> Stream | None:
    """Open a large file for reading in blocks."""
    path = Path(file)
    if not path.is_file() or path.stat().st_size < LARGE or not _simple(options):
        return None
    with path.open("rb") as source:
        head = source.read(_HEAD)
    head = head[: head.rfind(b"\n") + 1]
    mark = b"\xef\xbb\xbf"
    body = head.removeprefix(mark)
    if not body or b'"' in head or b"\0" in head or not _is_utf8(body) or body[:4].lower() == b"sep=":
        return None
    text = body.decode()
    try:
        grid = read_grid(
            text, file=file, delimiter=options.delimiter, resolves=lambda h: _resolves(h, options, file)
        )
        resolution = resolve(grid.header, options.columns, file=file)
    except UsageError:
        return None
    first = text.partition("\n")[0].rstrip("\r").split(grid.dialect.delimiter)
    slots = resolution.slots
    if resolution.form == "summary" or len(slots) > 1 or slots[0].environment is not None:
        return None
    if any(rule.path for rule in resolution.rules.values()) or [n.strip() for n in first] != grid.header:
        return None
    doubts = Problems()
    columns = slots[0].columns
    used = [(c, [r[at] for r in grid.cells]) for c, at in columns.items() if c in (*NUMBERS, "trial")]
    decimal = decimal_mark(used, grid.rows, file=file, declared=options.decimal, problems=doubts)
    if len(doubts) or decimal.evidence or "group" in grid.header:
        return None
    part = Part("trials", pd.DataFrame())
    check_columns(part, grid.header, resolution, file=file, options=options, named=named)
    skip = len(head) - len(body) + body.index(b"\n") + 1
    delimiter, sign = grid.dialect.delimiter, decimal.sign
    return Stream(file, part, grid.header, delimiter, sign, resolution, options, named, problems, skip)


def _says_true(raw: bytes) -> bool:
    return any(word in raw for word in (b"True", b"TRUE", b"true", b"False", b"FALSE", b"false"))


def _coded(ids: npt.NDArray[np.object_]) -> pd.Categorical:
    """Categories of a column of texts in order of first appearance, by its runs of equal ones."""
    # The parser gives equal texts of a column one object: comparing addresses is much faster than comparing
    # texts, and two addresses of one text would only make the runs shorter.
    start = ctypes.cast(ids.ctypes.data, ctypes.POINTER(ctypes.c_ssize_t))
    addresses = np.ctypeslib.as_array(start, shape=ids.shape)
    starts = np.flatnonzero(np.concatenate([[True], addresses[1:] != addresses[:-1]]))
    codes, names = pd.factorize(ids[starts])
    return pd.Categorical.from_codes(np.repeat(codes, np.diff(starts, append=len(ids))), pd.Index(names))


def _simple(options: ReadOptions) -> bool:
    plain = options.encoding in (None, "utf-8", "utf-8-sig")
    return plain and not (options.keep or options.groups or options.only or options.exclude)


def _resolves(header: list[str], options: ReadOptions, file: str) -> bool:
    try:
        return bool(resolve(header, options.columns, file=file).present & {"k_adj", "b_adj"})
    except UsageError:
        return False


def _is_utf8(raw: bytes) -> bool:
    if raw.isascii():
        return True
    try:
        return "\ufeff" not in raw.decode()
    except UnicodeDecodeError:
        return False
