"""Mutated session files against the reader, which reads a file rightly or says why not.

`make evidence` reads ten thousand. A file is a known dialect with a few random
edits. A scan that shares nothing with the reader checks what it accepts against the file's own
text.
"""

from __future__ import annotations

import re
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from percept import Scene
from percept.errors import PerceptError
from percept.sessions import Sessions, read_sessions
from tests.sessions.dialects import WRITERS, example

_TOKEN = re.compile(r"[+-]?[0-9.,]+(?:[eE][+-]?[0-9]+)?")
_NOT_DROPPED = frozenset(
    {
        "rows read",
        "observations",
        "subjects",
        "environments",
        "empty cells (subject × environment)",
        "missing repeats",
        "rows without k",
        "rows without b",
        "blank line",
        "repeated header",
        "end-of-file mark",
        "comment",
    }
)
_PIECES = [
    *(
        rb'" "" \" , ; \0 1,286 1.286 - NaN null inf 1e400 1e-400 0x10 1_0 True =1+1 {"k":1}'
        rb" 0 -1 None sep=; k_adj .. + e5"
    ).split(b" "),
    *b"\t|\n|\r|\r\n|\0|\xef\xbb\xbf|\xff\xfe|\x80|[1.5, 2]|1 000|\xd9\xa1|sep=;\n".split(b"|"),
    *b"END OF FILE| |\xc2\xa0|\xe2\x80\xa8|\x1a|\x0c".split(b"|"),
    b"9" * 400,
]


@dataclass
class Outcome:
    """What became of the files."""

    files: int = 0
    accepted: int = 0
    failures: list[tuple[int, str]] = field(default_factory=list)


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Edit a file at random: one to four edits of bytes, pieces, lines or length."""
    for _ in range(int(rng.integers(1, 5))):
        data = _EDITS[int(rng.integers(len(_EDITS)))](data, rng)
    return data


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + _PIECES[int(rng.integers(len(_PIECES)))] + data[at:]


def _delete(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 20)) :]


def _cell(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace one run of a cell's characters, so that the table keeps its shape."""
    cells = list(re.finditer(rb"[^,;\t\r\n\"\0]+", data))
    if not cells:
        return data
    cell = cells[int(rng.integers(len(cells)))]
    return data[: cell.start()] + _PIECES[int(rng.integers(len(_PIECES)))] + data[cell.end() :]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat, drop or swap lines."""
    lines = data.split(b"\n")
    i, j = (int(rng.integers(len(lines))) for _ in range(2))
    kind = int(rng.integers(3))
    if kind == 0:
        lines.insert(j, lines[i])
    elif kind == 1:
        del lines[i]
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)]


def _translate(data: bytes, rng: np.random.Generator) -> bytes:
    """Exchange one separator or mark for another throughout."""
    marks = b".,;\t\"'\r\n"
    a, b = (marks[int(rng.integers(len(marks)))] for _ in range(2))
    return data.translate(bytes.maketrans(bytes([a]), bytes([b])))


_EDITS: Sequence[Callable[[bytes, np.random.Generator], bytes]] = (
    _flip, _insert, _delete, _cell, _cell, _cell, _lines, _cut, _translate,
)  # fmt: skip


def check(sessions: Sessions, data: bytes, options: Scene) -> str | None:
    """Look for every number of an accepted file in its text, and for every row."""
    text = _text(data)
    # Two carriage returns and a line feed end one line.
    lines = re.split(r"\r{0,2}\n|\r", text)
    everywhere = _numbers(text)
    joined = '"' in text and any(line.count('"') % 2 for line in lines)
    numbers = ("k_ref", "b_ref", "k_adj", "b_adj")
    for at, row in zip(sessions.table.index, sessions.table[list(numbers)].to_numpy(), strict=True):
        line = sessions.locate(int(at))[1] - 1
        here = everywhere if joined or options.sessions.keep else _numbers(lines[line])
        for name, value in zip(numbers, row.tolist(), strict=True):
            if value == value and value not in (here if name.endswith("_adj") else everywhere):
                return f"{name} = {value!r} is not in row {line + 1}"
    counts = dict(sessions.counts)
    wide = (
        any("{environment}" in rule.name for rule in options.columns.values()) or "k_adj_" in text
    )
    dropped = sum(number for reason, number in counts.items() if reason not in _NOT_DROPPED)
    if not wide and counts["rows read"] != len(sessions.table) + dropped:
        return f"{counts['rows read']} rows became {len(sessions.table)} and {dropped}"
    if not np.isfinite(sessions.table[["k_adj", "b_adj"]].to_numpy()).any(axis=1).all():
        return "a row without an adjustment"
    return None


def _text(data: bytes) -> str:
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"", "utf-8-sig")):
        if data.startswith(mark):
            try:
                return data.decode(encoding)
            except UnicodeDecodeError:
                break
    return data.decode("cp1252")


def _numbers(text: str) -> set[float]:
    """All numbers a text can be read to hold, with either decimal mark."""
    found: set[float] = set()
    for token in _TOKEN.findall(text):
        for piece in {token, *re.split("[,]", token), *re.split("[.]", token)}:
            for reading in (piece, piece.replace(",", ".")):
                try:
                    found.add(float(reading))
                except ValueError:
                    continue
    return found


def fuzz(files: int, *, seed: int = 0, seconds_per_100kb: float = 1.0) -> Outcome:
    """Read mutated files and collect what became of them."""
    outcome = Outcome()
    cases = [
        (data, writer.options)
        for writer in WRITERS.values()
        for data in writer.write(example(writer.decimals)).values()
    ]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = Path(folder) / "sub-001_ses-01.csv"
        for at in range(files):
            rng = np.random.default_rng([seed, at])
            data, options = cases[int(rng.integers(len(cases)))]
            mutant = mutate(data, rng)
            path.write_bytes(mutant)
            _one(path, mutant, options, at, outcome, seconds_per_100kb)
    return outcome


def _one(
    path: Path, data: bytes, options: Scene, at: int, outcome: Outcome, allowed: float
) -> None:
    start = time.process_time()
    try:
        sessions = read_sessions(path, scene=options)
    except PerceptError:
        wrong = None
    except Exception as error:  # noqa: BLE001 - any exception that is not ours is what is looked for
        wrong = f"{type(error).__name__}: {error}"
    else:
        outcome.accepted += 1
        wrong = check(sessions, data, options)
    took = time.process_time() - start
    outcome.files += 1
    if took > allowed * max(1.0, len(data) / 1e5):
        wrong = wrong or f"took {took:.1f} s of processor time for {len(data)} bytes"
    if wrong:
        outcome.failures.append((at, wrong))
