"""A mapping proposed for a file with unknown column names, and tried on the whole file."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import pandas as pd

from percept.errors import PerceptError, UsageError, counted, printable
from percept.sessions.columns import Header, resolve
from percept.sessions.files import Input, load
from percept.sessions.options import ReadOptions
from percept.sessions.paths import expand
from percept.sessions.quantities import IMPEDANCE, quantity_of
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.reading import open_blocks
from percept.sessions.records import IDS, MASS, Problems, ReadError
from percept.sessions.values import is_missing

__all__ = ["Proposal", "propose_columns"]

_WORDS = {
    "subject": "participant subject subj sub pp ppid vp observer person respondent id",
    "session": "session visit day",
    "environment": "environment condition standard stimulus reference cond stim level item",
    "trial": "trial repetition rep repeat",
    "adjusted": (
        "response resp adjusted adjustment adj match matched matching estimate estimated final "
        "reproduced reproduction judgment judgement setting answer"
    ),
    "reference": "reference ref standard stimulus stim target true actual physical presented",
    "timing": "started stopped onset rt latency timestamp date clock frame frames",
    "empty": "value mean level size magnitude the of in id nr no num number",
}
#: Words of each id, the likeliest first.
_ID_WORDS = {name: _WORDS[name].split() for name in (*IDS, "trial")}
_ADJUSTED = frozenset(_WORDS["adjusted"].split())
_REFERENCE = frozenset(_WORDS["reference"].split())
#: Words of columns that hold when something happened, which nobody adjusts.
_TIMING = frozenset(_WORDS["timing"].split())
#: Words that say nothing of what was adjusted.
_EMPTY = frozenset(_WORDS["empty"].split()).union(*_ID_WORDS.values())
#: What a unit is of, where no word says it; of an impedance the names are percept's own.
_UNITS = {
    "ms": "duration", "s": "duration", "sec": "duration", "g": "weight", "kg": "weight",
    "mm": "length", "cm": "length", "m": "length", "N": "force", "Hz": "frequency", "dB": "level",
    "deg": "angle", "N/m": "k", "N/mm": "k", "N*s/m": "b", "N·s/m": "b", "Ns/m": "b",
}  # fmt: skip
#: Files of a folder, and members of an archive, that are looked at.
_FILES = 20
#: Share of numbers among the different cells of a column of numbers.
_NUMERIC = 0.9
#: More different numbers than these are described by their range.
_LISTED_NUMBERS = 20
#: Columns of texts that a comment quotes.
_LISTED_TEXTS = 4


@dataclass(frozen=True)
class Proposal:
    """How percept would read a file with unknown column names."""

    text: str  #: TOML of a scene; comments say what was seen and what was not found
    guessed: tuple[str, ...]  #: Canonical columns that rest on words and values
    missing: tuple[str, ...]  #: Canonical columns that an analysis needs and that were not found
    refused: UsageError | None = None  #: Why the file is not read under the proposal


class _Column:
    """One column of the file: its words, the unit that its name gives, and its cells."""

    def __init__(self, name: str, cells: pd.Series[str]) -> None:
        self.name = name
        self.cells = cells
        self.unit: str | None = None
        stem = name
        if bracket := re.search(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$", name):
            stem = name[: bracket.start()]
            self.unit = bracket[1]
        humps = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", stem)
        words = re.findall(r"[A-Za-z0-9]+", humps)
        if self.unit is None and len(words) > 1 and words[-1] in _UNITS:
            self.unit = words.pop()
        self.words = [word.casefold() for word in words]
        texts = (cell.strip() for cell in cells.unique() if not is_missing(cell))
        self.texts = list(dict.fromkeys(texts))
        numbers = [number for text in self.texts if (number := _number(text)) is not None]
        # A slip in a cell leaves a column one of numbers.
        numeric = len(numbers) >= _NUMERIC * len(self.texts)
        self.numbers = sorted(numbers) if numeric else []

    def seen(self) -> str:
        """Say what the column holds, for a comment."""
        if len(self.numbers) > _LISTED_NUMBERS:
            return f"{self.numbers[0]:g} to {self.numbers[-1]:g}"
        listed = ", ".join(self.texts[:_LISTED_TEXTS])
        if len(self.texts) > _LISTED_TEXTS:
            listed += " …"
        return printable(f"{len(self.texts)} different: {listed}")[:80]

    def about(self, roles: frozenset[str]) -> str:
        """Name what the column is of: the words that give no role."""
        silent = roles | _EMPTY
        return "_".join(w for w in self.words if w not in silent and not w.isdigit())

    def may_be_trial(self) -> bool:
        """Whether all cells are whole numbers."""
        complete = len(self.numbers) == len(self.texts)
        return complete and all(number.is_integer() for number in self.numbers)


def _number(text: str) -> float | None:
    """Read a number with either decimal mark; None for other texts."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return None


@dataclass
class _Mapping:
    """What stands where, as far as names and numbers of the columns tell."""

    found: dict[str, _Column]
    known: frozenset[str]  # Canonical columns that the reader finds without a guess
    units: dict[str, str] = field(default_factory=dict)  # Of new quantities
    remarks: list[str] = field(default_factory=list)
    repeats: int = 0  # Rows whose ids stand before them, where no number tells trials apart

    def missing(self, options: ReadOptions) -> tuple[str, ...]:
        """Name the columns that an analysis needs and that were not found."""
        names = (quantity_of(c) for c in self.found if c not in (*_ID_WORDS, MASS))
        needed = ["subject", "environment"]
        for name in dict.fromkeys(names) or ["NAME"]:
            needed += [f"{name}_ref", f"{name}_adj"]
        declared = {name for own in options.environments.values() for name in own}
        return tuple(c for c in needed if c not in self.found and c not in declared)

    def drop(self, canonical: str) -> None:
        """Take a guess back, and with a reference the environments that it told apart."""
        column = self.found.pop(canonical)
        if canonical.endswith("_ref") and self.found.get("environment") is column:
            del self.found["environment"]

    def guessed(self) -> tuple[str, ...]:
        """Name the columns that rest on a guess."""
        return tuple(c for c in self.found if c not in self.known)


def propose_columns(*paths: str | Path, options: ReadOptions | None = None) -> Proposal:
    """Propose how to read files with unknown column names, and try it on all of them.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`; the first table with adjustments counts.
    options : ReadOptions, optional
        How to read them; columns that it declares stay.

    Returns
    -------
    Proposal
        With `refused`, where the files are not read under it.

    Raises
    ------
    UsageError
        No file is a table.
    """
    options = options or ReadOptions()
    problems = Problems()
    proposals: list[Proposal] = []
    for file in islice(expand(paths)[0], _FILES):
        for entry in islice(load(file, options.files), _FILES):
            with problems.collecting():
                table = _Table(entry, options)
                proposals.append(_tried(table, paths, options))
    if not proposals:
        problems.raise_if_any()
    return min(proposals, key=lambda proposal: len(proposal.missing))


class _Table:
    """The columns of a whole file."""

    def __init__(self, entry: Input, options: ReadOptions) -> None:
        self.name = entry.name
        with closing(open_blocks(entry, options, [])) as blocks:
            grids = [block.grid() for block in blocks]
        self.header = grids[0].header
        cells = pd.concat([grid.cells for grid in grids])
        self.rows = len(cells)
        self.columns = {name: _Column(name, cells[at]) for at, name in enumerate(self.header)}


def _tried(table: _Table, paths: Sequence[str | Path], options: ReadOptions) -> Proposal:
    """Propose a mapping; guesses that the files refute are dropped."""
    mapping = _mapping(table, options)
    refused: UsageError | None = None
    while mapping.guessed() and not mapping.missing(options):
        try:
            sessions = _read_under(_text(mapping, table, options), paths, options)
        except UsageError as error:
            refused = error
            wrong = _refuted(mapping, table.rows, error)
        else:
            refused = None
            wrong = _moment(mapping, sessions)
            if wrong is None:
                remark = f"Tried on the whole file: {counted(len(sessions.table), 'row')} of"
                mapping.remarks.append(f"{remark} {table.rows} give an adjustment.")
                break
        if wrong is None:
            break
        mapping.drop(wrong)
        _number_by_order(mapping, options)
    text = _text(mapping, table, options)
    return Proposal(text, mapping.guessed(), mapping.missing(options), refused)


def _read_under(text: str, paths: Sequence[str | Path], options: ReadOptions) -> Sessions:
    """Read all files under a proposal."""
    tables = tomllib.loads(text)
    sessions = options.sessions.model_dump() | tables.get("sessions", {})
    columns = {**options.columns, **tables["columns"]}
    changed = {"columns": columns, "sessions": sessions}
    if "quantities" in tables:
        changed["quantities"] = tables["quantities"]
    return read_sessions(*paths, scene=ReadOptions(**dict(options) | changed))


def _refuted(mapping: _Mapping, rows: int, error: UsageError) -> str | None:
    """Name a guess that an attempt to read refutes; a few wrong cells refute none."""
    guessed = mapping.guessed()
    problems = error.problems if isinstance(error, ReadError) else (error,)
    for problem in problems:
        if problem.column in guessed and problem.column.endswith("_ref"):
            # It differs within an environment.
            return problem.column
    names = [problem.column for problem in problems]
    for canonical in guessed:
        if names.count(mapping.found[canonical].name) > (1.0 - _NUMERIC) * rows:
            return canonical
    repeated = None in names
    return "trial" if repeated and "trial" in guessed else None


def _moment(mapping: _Mapping, sessions: Sessions) -> str | None:
    """Name a guessed reference that differs in nearly every row: it is a time or a measurement."""
    environments = len(sessions.environments)
    if environments <= _LISTED_NUMBERS or environments < len(sessions.table) / 2:
        return None
    return next((c for c in mapping.guessed() if c.endswith("_ref")), None)


def _mapping(table: _Table, options: ReadOptions) -> _Mapping:
    """Guess what stands where."""
    mapping = _Mapping({}, frozenset())
    try:
        rules = resolve(Header(table.header, table.name), options).rules
    except PerceptError as error:
        # Several columns with one meaning: the first that fits is proposed.
        mapping.remarks.append(str(error))
    else:
        for canonical, rule in rules.items():
            if rule.name in table.columns:
                mapping.found[canonical] = table.columns[rule.name]
    mapping.known = frozenset(mapping.found)
    free = [column for column in table.columns.values() if column not in mapping.found.values()]
    if not any(c.endswith("_adj") for c in mapping.known):
        _add_numbers(mapping, free)
        # A reference may be what tells environments apart.
        adjusted = [column for c, column in mapping.found.items() if c.endswith("_adj")]
        free = [column for column in free if column not in adjusted]
    for canonical in _ID_WORDS:
        column = None if canonical in mapping.found else _id(canonical, free)
        if column is not None:
            mapping.found[canonical] = column
    references = [column for c, column in mapping.found.items() if c.endswith("_ref")]
    if references:
        mapping.found.setdefault("environment", references[0])
    _number_by_order(mapping, options)
    return mapping


def _number_by_order(mapping: _Mapping, options: ReadOptions) -> None:
    """Let the order of rows number the trials, where rows repeat their ids without a number."""
    if "trial" in mapping.found or options.sessions.keep:
        return
    ids = [column.cells for c, column in mapping.found.items() if c in IDS]
    if ids:
        mapping.repeats = int(pd.concat(ids, axis=1).duplicated().sum())


def _add_numbers(mapping: _Mapping, free: Sequence[_Column]) -> None:
    """Find adjustments, their references and quantities among columns of numbers."""
    numeric = [column for column in free if column.numbers and not _TIMING & set(column.words)]
    adjusted = [column for column in numeric if _ADJUSTED & set(column.words)]
    references = [
        column for column in numeric if _REFERENCE & set(column.words) and column not in adjusted
    ]
    for column in adjusted:
        reference = _reference_of(column, references, alone=len(adjusted) == 1)
        unit = column.unit or (reference.unit if reference else None) or ""
        name = column.about(_ADJUSTED)
        if not name and reference:
            name = reference.about(_REFERENCE)
        name = name or _UNITS.get(unit, "response")
        name = {"stiffness": "k", "damping": "b"}.get(name, name)
        if not re.match("[a-z]", name) or f"{name}_adj" in mapping.found:
            continue
        if name not in IMPEDANCE:
            mapping.units[name] = unit
        mapping.found[f"{name}_adj"] = column
        if reference:
            mapping.found[f"{name}_ref"] = reference


def _reference_of(
    adjusted: _Column, references: Sequence[_Column], *, alone: bool
) -> _Column | None:
    """Return the reference of the same thing, or the likeliest where there is no choice."""
    about = adjusted.about(_ADJUSTED)
    for reference in references:
        if reference.about(_REFERENCE) == about:
            return reference
    return references[0] if references and (alone or len(references) == 1) else None


def _id(canonical: str, free: Sequence[_Column]) -> _Column | None:
    """Return the column whose words most likely name an id; a whole name goes before a part."""
    words = _ID_WORDS[canonical]
    if canonical == "trial":
        free = [column for column in free if column.may_be_trial()]
    for word in words:
        for column in free:
            if "".join(column.words) == word:
                return column
    others = set() if canonical == "trial" else set(_ID_WORDS["trial"])
    for word in words:
        for column in free:
            if word in column.words and word != "id" and not others & set(column.words):
                return column
    return None


def _text(mapping: _Mapping, table: _Table, options: ReadOptions) -> str:
    """Write a proposal as TOML with comments."""
    name = printable(Path(table.name).name)
    remarks = [f"What percept makes of {name}: look through it before you go on."]
    lines = [f"# {' '.join(remark.split())}" for remark in (*remarks, *mapping.remarks)]
    for quantity, unit in mapping.units.items():
        if f"{quantity}_adj" in mapping.found:
            ask = "" if unit else "  # no name of a column gives it: fill it in"
            lines += ["", f"[quantities.{quantity}]", f"unit = {_toml(unit)}{ask}"]
    lines += ["", "[columns]"]
    for canonical in _in_order(mapping.found):
        column = mapping.found[canonical]
        value = _toml(column.name)
        own = mapping.units.get(quantity_of(canonical), "")
        if canonical not in _ID_WORDS and column.unit and column.unit != own:
            value = f"{{ name = {value}, unit = {_toml(column.unit)} }}"
        lines.append(f"{canonical} = {value}  # {column.seen()}")
    for canonical in mapping.missing(options):
        lines.append(f'# {canonical} = ""  # not found: fill in the name of its column')
    if mapping.repeats:
        seen = f"{counted(mapping.repeats, 'row')} of {table.rows} repeat a subject and environment"
        lines += ["", "[sessions]", f'trial = "order"  # {seen}, without numbers']
    lines.append("")
    for column in table.columns.values():
        if column not in mapping.found.values():
            lines.append(f"# not used: {_toml(column.name)}: {column.seen()}")
    return "\n".join(lines).rstrip() + "\n"


def _in_order(found: dict[str, _Column]) -> list[str]:
    """Order canonical columns: ids, references, adjustments."""
    ids = [c for c in _ID_WORDS if c in found]
    references = [c for c in found if c.endswith("_ref")]
    adjusted = [c for c in found if c.endswith("_adj")]
    rest = [c for c in found if c not in (*ids, *references, *adjusted)]
    return [*ids, *references, *adjusted, *rest]


def _toml(text: str) -> str:
    """Write a TOML string: a JSON one, but for DEL, which TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
