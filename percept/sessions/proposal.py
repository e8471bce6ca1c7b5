"""A mapping for files with unknown column names: which column is which, by its words and its values."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from percept.errors import PerceptError, UsageError, counted, printable
from percept.sessions.columns import resolve
from percept.sessions.files import expand, load
from percept.sessions.grids import Grid
from percept.sessions.options import ReadOptions
from percept.sessions.reading import open_blocks
from percept.sessions.records import IDS, MASS
from percept.sessions.values import is_missing

_WORDS = {
    "subject": "participant subject subj sub pp ppid vp observer person respondent id",
    "session": "session visit day",
    "environment": "environment condition standard stimulus reference cond stim level item",
    "trial": "trial repetition rep repeat",
    "adjusted": "response resp adjusted adjustment adj match matched matching estimate estimated final "
    "reproduced reproduction judgment judgement setting answer",
    "reference": "reference ref standard stimulus stim target true actual physical presented",
    "empty": "value mean level size magnitude the of in id nr no num number",
}
#: Words of each id, the likeliest first.
_IDS = {name: _WORDS[name].split() for name in (*IDS, "trial")}
_ADJUSTED, _REFERENCE = (frozenset(_WORDS[name].split()) for name in ("adjusted", "reference"))
#: Words that say nothing of what was adjusted.
_EMPTY = frozenset(_WORDS["empty"].split()).union(*_IDS.values())
#: What a unit is of, where no word says it; of an impedance the names are percept's own.
_UNITS: Mapping[str, str] = {
    "ms": "duration", "s": "duration", "sec": "duration", "g": "weight", "kg": "weight", "mm": "length",
    "cm": "length", "m": "length", "N": "force", "Hz": "frequency", "dB": "level", "deg": "angle",
    "N/m": "k", "N/mm": "k", "N*s/m": "b", "N·s/m": "b", "Ns/m": "b",
}  # fmt: skip
_IMPEDANCE: Mapping[str, tuple[str, str]] = {
    "k": ("k", "N/m"), "b": ("b", "N·s/m"), "stiffness": ("k", "N/m"), "damping": ("b", "N·s/m"),
}  # fmt: skip
#: Files of a folder that are looked at, and rows of each.
_FILES, _ROWS = 20, 5000


@dataclass(frozen=True)
class Proposal:
    """How percept would read a file with unknown column names."""

    text: str  # TOML of a scene, what was seen as comments; of what was not found commented lines
    guessed: tuple[str, ...]  # Canonical columns that rest on a guess of this module
    missing: tuple[str, ...]  # Canonical columns that an analysis needs and that were not found


@dataclass
class _Column:
    """One column of the file: its words, the unit that its name gives, and its cells."""

    name: str
    cells: list[str]
    unit: str | None = None
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        stem = self.name
        if bracket := re.search(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$", stem):
            stem, self.unit = stem[: bracket.start()], bracket[1]
        spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", stem)
        words = [word for word in re.split(r"[^A-Za-z0-9]+", spaced) if word]
        if self.unit is None and len(words) > 1 and words[-1] in _UNITS:
            self.unit = words.pop()
        self.words = [word.casefold() for word in words]
        self.texts = list(dict.fromkeys(cell.strip() for cell in self.cells if not is_missing(cell)))
        try:
            self.numbers = sorted(float(text.replace(",", ".")) for text in self.texts)
        except ValueError:
            self.numbers = []

    def seen(self) -> str:
        """Say what the column holds, for a comment."""
        if self.numbers and len(self.numbers) > _FILES:
            return f"{self.numbers[0]:g} to {self.numbers[-1]:g}"
        some = ", ".join(self.texts[:4]) + (" …" if len(self.texts) > 4 else "")
        return printable(f"{len(self.texts)} different: {some}")[:80]

    def about(self, roles: frozenset[str]) -> str:
        """Name what the column is of: the words that give no role."""
        return "_".join(w for w in self.words if w not in roles | _EMPTY and not w.isdigit())


def propose_columns(path: str | Path, *, options: ReadOptions | None = None) -> Proposal:
    """Propose how to read a file with unknown column names.

    Parameters
    ----------
    path : str or Path
        A file; of an archive or a folder the first table with adjustments counts.
    options : ReadOptions, optional
        How to read it; columns that it declares stay.

    Returns
    -------
    Proposal
        `text`, TOML of a scene; `guessed`, columns that rest on words and values; `missing`, needed ones.

    Raises
    ------
    UsageError
        The file is no table.
    """
    options = options or ReadOptions()
    best: Proposal | None = None
    for file in expand([path]).files[:_FILES]:
        for entry in islice(load(file), _FILES):
            try:
                with closing(open_blocks(entry, options, [])) as blocks:
                    found = _proposal(next(blocks).grid(), options, entry.name)
            except UsageError:
                if best is None and file == str(path):
                    raise
                continue
            if not found.missing:
                return found
            best = min(best or found, found, key=lambda one: len(one.missing))
    if best is None:
        raise UsageError("the folder holds no table to propose a mapping for.", file=str(path))
    return best


def _proposal(grid: Grid, options: ReadOptions, file: str) -> Proposal:
    columns = [_Column(name, grid.cells[at].tolist()[:_ROWS]) for at, name in enumerate(grid.header)]
    by_name = {column.name: column for column in columns}
    remarks = [f"What percept makes of {printable(Path(file).name)}: look through it before you go on."]
    try:
        known = {c: rule.name for c, rule in resolve(grid.header, options, file=file).rules.items()}
    except PerceptError as error:
        # Several columns with one meaning: the first that fits best is proposed, and the others are said.
        known, remarks = {}, [*remarks, str(error)]
    known = {c: name for c, name in known.items() if name in by_name}
    free = [column for column in columns if column.name not in known.values()]
    quantities: dict[str, str] = {}
    guessed: dict[str, _Column] = {}
    if not any(c.endswith("_adj") for c in known):
        guessed, quantities = _numbers(free)
    for canonical, words in _IDS.items():
        taken = {column.name for c, column in guessed.items() if c.endswith("_adj")}
        if canonical not in known and (column := _id(words, [c for c in free if c.name not in taken])):
            guessed[canonical] = column
    if "environment" not in known and "environment" not in guessed:
        # The reference itself tells environments apart.
        numbers = [by_name[n] for c, n in known.items() if c.endswith("_ref")]
        numbers += [column for c, column in guessed.items() if c.endswith("_ref")]
        if numbers:
            guessed["environment"] = numbers[0]
    found = {c: by_name[name] for c, name in known.items()} | guessed
    stems = dict.fromkeys(c.rpartition("_")[0] for c in found if c.endswith(("_ref", "_adj")) and c != MASS)
    needed = [
        "subject",
        "environment",
        *(f"{n}_{kind}" for n in stems or ["NAME"] for kind in ("ref", "adj")),
    ]
    declared = {name for references in options.environments.values() for name in references}
    missing = tuple(c for c in needed if c not in found and c not in declared)
    experiment = next((c for c in columns if c.words == ["experiment"] and len(c.texts) > 1), None)
    tables = _columns_table(found, missing, quantities, experiment) + _sessions_table(
        found, options, experiment
    )
    head = [f"# {' '.join(remark.split())}" for remark in remarks]
    ask = "  # no name of a column gives it: fill it in"
    units = [f"[quantities.{n}]\nunit = {_toml(u)}{'' if u else ask}\n" for n, u in quantities.items()]
    rest = [f"# not used: {_toml(c.name)}: {c.seen()}" for c in columns if c not in found.values()]
    text = "\n".join([*head, "", *units, *tables, "", *rest]).rstrip() + "\n"
    return Proposal(text, tuple(guessed), missing)


def _numbers(free: Sequence[_Column]) -> tuple[dict[str, _Column], dict[str, str]]:
    """Find adjustments and their references among columns of numbers, and the quantities they are of."""
    found: dict[str, _Column] = {}
    quantities: dict[str, str] = {}
    numeric = [column for column in free if column.numbers]
    adjusted = [column for column in numeric if _ADJUSTED & set(column.words)]
    references = [column for column in numeric if _REFERENCE & set(column.words) and column not in adjusted]
    for column in adjusted:
        about = column.about(_ADJUSTED)
        own = [ref for ref in references if ref.about(_REFERENCE) == about] or (
            references if len(references) == 1 or len(adjusted) == 1 else []
        )
        unit = column.unit or next((ref.unit for ref in own[:1] if ref.unit), None)
        name = about or next((n for ref in own[:1] if (n := ref.about(_REFERENCE))), "")
        name = name or _UNITS.get(unit or "", "response")
        name, usual = _IMPEDANCE.get(name, (name, ""))
        if not re.match("[a-z]", name) or f"{name}_adj" in found:
            continue
        if not usual:
            quantities[name] = unit or ""
        found[f"{name}_adj"] = column
        found |= {f"{name}_ref": ref for ref in own[:1]}
    return found, quantities


def _id(words: Sequence[str], free: Sequence[_Column]) -> _Column | None:
    """Return the column whose words most likely name an id; a whole name goes before a part."""
    for word in words:
        whole = [column for column in free if "".join(column.words) == word]
        part = [column for column in free if word in column.words and word != "id"]
        if whole or part:
            return (whole or part)[0]
    return None


def _columns_table(
    found: Mapping[str, _Column],
    missing: Sequence[str],
    quantities: Mapping[str, str],
    experiment: _Column | None,
) -> list[str]:
    order = [*_IDS, *sorted((c for c in found if c not in _IDS), key=lambda c: c.endswith("_adj"))]
    lines = ["[columns]"]
    for canonical in (c for c in order if c in found):
        column = found[canonical]
        name = _toml(column.name)
        own = quantities.get(canonical.rpartition("_")[0], "")
        if canonical not in _IDS and column.unit and column.unit != own:
            name = f"{{ name = {name}, unit = {_toml(column.unit)} }}"
        lines.append(f"{canonical} = {name}  # {column.seen()}")
    lines += [f'# {canonical} = ""  # not found: fill in the name of its column' for canonical in missing]
    if experiment is not None and "subject" in found:
        both = f"subject = [{_toml(experiment.name)}, {_toml(found['subject'].name)}]"
        if _repeats(found, experiment) < _repeats(found):
            lines[1] = f"{both}  # numbers seem to restart with every experiment"
        else:
            lines.append(f"# {both}  # in its place, if numbers restart with every experiment")
    return lines


def _repeats(found: Mapping[str, _Column], *also: _Column | None) -> int:
    """How many rows repeat a subject, session, environment and trial."""
    ids = [found[c].cells for c in _IDS if c in found] + [column.cells for column in also if column]
    rows = list(zip(*ids, strict=True))
    return len(rows) - len(set(rows))


def _sessions_table(
    found: Mapping[str, _Column], options: ReadOptions, experiment: _Column | None
) -> list[str]:
    """Propose that trials are numbered by their order where cells repeat without numbers."""
    if "trial" in found or options.keep:
        return []
    repeats, rows = _repeats(found, experiment), len(next(iter(found.values())).cells) if found else 0
    seen = f"{counted(repeats, 'row')} of {rows} repeat a subject and environment, without numbers"
    return ["", "[sessions]", f'trial = "order"  # {seen}'] if repeats else []


def _toml(text: str) -> str:
    # A JSON string is a TOML basic string, but for DEL, which TOML wants escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
