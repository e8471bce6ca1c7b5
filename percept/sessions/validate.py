"""What percept says of files before an analysis: what it read, every problem, or a mapping of names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.columns import resolve
from percept.sessions.files import expand, load
from percept.sessions.grids import Grid
from percept.sessions.options import ReadOptions
from percept.sessions.quantities import IMPEDANCE, quantity_of
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.reading import open_blocks
from percept.sessions.records import IDS, MASS, Notice, Problems, ReadError, summarised
from percept.sessions.values import is_missing

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")
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
#: Files of a folder that are looked at, rows of each, and different numbers above which their range
#: is told.
_FILES, _ROWS, _RANGE = 20, 5000, 20


def validate(*paths: str | Path, options: ReadOptions | None = None) -> dict[str, Any]:
    """Read a study as `read_sessions` does, and report instead of raising.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`.
    options : ReadOptions, optional
        How to read them.

    Returns
    -------
    dict
        Ready for JSON. `exit_code`: 0 read, 1 an analysis would refuse (fewer than two subjects), 2
        problems. `form`, `sources`, `counts`, `notices` (with the warnings) and `exclusions` as in
        :class:`~percept.sessions.Sessions`, `units` of the references. `environments`: of each its
        `name`, `references`, `subjects`, and fewest and most `trials` of one (None for published
        limits). `problems`: message, file, row, column, key, value and hint of each;
        `problems_total` counts them all.
    """
    out: dict[str, Any] = {
        "exit_code": 0,
        "form": None,
        "sources": [],
        "counts": {},
        "environments": [],
    }
    out |= {"units": {}, "notices": [], "exclusions": [], "problems": [], "problems_total": 0}
    try:
        sessions = read_sessions(*paths, options=options)
    except PerceptError as error:
        names = ("message", "file", "row", "column", "key", "value", "hint")
        problems, total = (
            (error.problems, error.total) if isinstance(error, ReadError) else ((error,), 1)
        )
        said = [{name: getattr(problem, name) for name in names} for problem in problems]
        return out | {"exit_code": error.exit_code, "problems": said, "problems_total": total}
    alone = sessions.form == "trials" and len(sessions.subjects) < 2
    notices = (*sessions.notices, *sessions.warnings, *([_ALONE] if alone else []))
    return out | {
        "exit_code": int(alone),
        "form": sessions.form,
        "sources": [vars(source) for source in sessions.sources],
        "counts": dict(sessions.counts),
        "environments": list(_understood(sessions)),
        "units": {name: sessions.quantities[name].unit for name in sessions.parameters},
        "notices": [vars(notice) for notice in notices],
        "exclusions": [vars(exclusion) for exclusion in sessions.exclusions],
    }


def _understood(sessions: Sessions) -> Iterator[dict[str, Any]]:
    """Give a record of each environment: references, subjects, and trials of a subject."""
    for name, rows in sessions.by_environment():
        if sessions.form == "summary":
            references = dict(zip(rows["parameter"], rows["reference"].tolist(), strict=True))
            yield {
                "name": name,
                "references": references,
                "subjects": int(rows["n"].max()),
                "trials": None,
            }
            continue
        trials = rows.groupby("subject").size()
        references = {p: float(rows[f"{p}_ref"].iloc[0]) for p in sessions.parameters}
        several = [int(trials.min()), int(trials.max())]
        yield {"name": name, "references": references, "subjects": len(trials), "trials": several}


def format_validation(found: Mapping[str, Any], *, say: Callable[[str], str] = str) -> str:
    """Plain text of a validation, one finding per line, each beginning with its file and row.

    Parameters
    ----------
    found : mapping
        As `validate` returns it.
    say : callable, optional
        What puts percept's words for environments and subjects into the study's.

    Returns
    -------
    str
    """
    lines = ["{name}: {rows} rows, sha256 {sha256}".format(**source) for source in found["sources"]]
    lines += [f"  {number:>9}  {say(reason)}" for reason, number in found["counts"].items()]
    rows = []
    for one in found["environments"]:
        row = {say("environment"): printable(one["name"])}
        for p, unit in found["units"].items():
            value = one["references"].get(p, np.nan)
            row[f"{p}_ref ({unit})".replace(" ()", "")] = "–" if value != value else f"{value:g}"
        trials = (
            "published"
            if one["trials"] is None
            else " to ".join(map(str, dict.fromkeys(one["trials"])))
        )
        rows.append(row | {say("subjects"): one["subjects"], say("trials per subject"): trials})
    lines += pd.DataFrame(rows).to_string(index=False).splitlines() if rows else []
    lines += [f"notice: {Notice(**notice)}" for notice in found["notices"]]
    lines += [
        "left out: {file}:{row}: subject {who}, {what}: {why}".format(**e)
        for e in found["exclusions"]
    ]
    problems, total = (
        [PerceptError(**problem) for problem in found["problems"]],
        found["problems_total"],
    )
    lines += summarised(problems)
    if total > len(problems):
        lines.append(f"and {total - len(problems)} more problems")
    verdicts = (
        "read without problems",
        "read, but no analysis is possible",
        counted(total, "problem"),
    )
    return "\n".join(map(printable, [*lines, verdicts[found["exit_code"]]]))


@dataclass(frozen=True)
class Proposal:
    """How percept would read a file with unknown column names."""

    text: str  # TOML of a scene; comments say what was seen and what was not found
    guessed: tuple[str, ...]  # Canonical columns that rest on a guess of this module
    missing: tuple[str, ...]  # Canonical columns that an analysis needs and that were not found


class _Column:
    """One column of the file: its words, the unit that its name gives, and its cells."""

    def __init__(self, name: str, cells: pd.Series[str]) -> None:
        self.name, self.cells = name, cells
        stem, unit = name, None
        if bracket := re.search(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$", name):
            stem, unit = name[: bracket.start()], bracket[1]
        words = re.findall(r"[A-Za-z0-9]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", stem))
        if unit is None and len(words) > 1 and words[-1] in _UNITS:
            unit = words.pop()
        self.unit, self.words = unit, [word.casefold() for word in words]
        self.texts = list(dict.fromkeys(cell.strip() for cell in cells if not is_missing(cell)))
        try:
            self.numbers = sorted(float(text.replace(",", ".")) for text in self.texts)
        except ValueError:
            self.numbers = []

    def seen(self) -> str:
        """Say what the column holds, for a comment."""
        if len(self.numbers) > _RANGE:
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
        `text`, TOML of a scene; `guessed`, columns that rest on words and values; `missing`, needed
        ones.

    Raises
    ------
    UsageError
        The file is no table.
    """
    options = options or ReadOptions()
    found: list[Proposal] = []
    problems = Problems()
    for file in islice(expand([path])[0], _FILES):
        for entry in islice(load(file, options.files), _FILES):
            with problems.collecting(), closing(open_blocks(entry, options, [])) as blocks:
                found.append(_proposal(next(blocks).grid(), options, entry.name))
    if not found:
        problems.raise_if_any()
    return min(found, key=lambda one: len(one.missing))


def _proposal(grid: Grid, options: ReadOptions, file: str) -> Proposal:
    cells = grid.cells.head(_ROWS)
    columns = {name: _Column(name, cells[at]) for at, name in enumerate(grid.header)}
    remarks = [
        f"What percept makes of {printable(Path(file).name)}: look through it before you go on."
    ]
    found: dict[str, _Column] = {}
    try:
        rules = resolve(grid.header, options, file=file).rules
        found = {c: columns[rule.name] for c, rule in rules.items() if rule.name in columns}
    except PerceptError as error:
        # Several columns with one meaning: the first that fits best is proposed, and the others are
        # said.
        remarks.append(str(error))
    known = tuple(found)
    free = [column for column in columns.values() if column not in found.values()]
    quantities: dict[str, str] = {}
    if not any(c.endswith("_adj") for c in known):
        numbers, quantities = _numbers(free)
        found |= numbers
        # A reference may be what tells environments apart.
        free = [
            column
            for column in free
            if column not in (found[c] for c in numbers if c.endswith("_adj"))
        ]
    for canonical, words in _IDS.items():
        if canonical not in found and (column := _id(words, free)):
            found[canonical] = column
    references = [column for c, column in found.items() if c.endswith("_ref")]
    if references:
        found.setdefault("environment", references[0])
    stems = dict.fromkeys(quantity_of(c) for c in found if c not in (*_IDS, MASS)) or ["NAME"]
    needed = [
        "subject",
        "environment",
        *(f"{stem}_{kind}" for stem in stems for kind in ("ref", "adj")),
    ]
    declared = {name for references in options.environments.values() for name in references}
    missing = tuple(c for c in needed if c not in found and c not in declared)
    ask = "  # no name of a column gives it: fill it in"
    lines = [*(f"# {' '.join(remark.split())}" for remark in remarks), ""]
    lines += [
        f"[quantities.{n}]\nunit = {_toml(u)}{'' if u else ask}\n" for n, u in quantities.items()
    ]
    lines.append("[columns]")
    for canonical in sorted(found, key=lambda c: [*_IDS, c].index(c) + c.endswith("_adj")):
        column, own = found[canonical], quantities.get(quantity_of(canonical), "")
        name = _toml(column.name)
        if canonical not in _IDS and column.unit and column.unit != own:
            name = f"{{ name = {name}, unit = {_toml(column.unit)} }}"
        lines.append(f"{canonical} = {name}  # {column.seen()}")
    lines += [
        f'# {canonical} = ""  # not found: fill in the name of its column' for canonical in missing
    ]
    ids = [column.cells for c, column in found.items() if c in _IDS]
    repeats = int(pd.concat(ids, axis=1).duplicated().sum()) if ids else 0
    if "trial" not in found and not options.sessions.keep and repeats:
        seen = (
            f"{counted(repeats, 'row')} of {len(cells)} repeat a subject and environment, without"
            " numbers"
        )
        lines += ["", "[sessions]", f'trial = "order"  # {seen}']
    rest = [c for c in columns.values() if c not in found.values()]
    lines += ["", *(f"# not used: {_toml(c.name)}: {c.seen()}" for c in rest)]
    return Proposal(
        "\n".join(lines).rstrip() + "\n", tuple(c for c in found if c not in known), missing
    )


def _numbers(free: Sequence[_Column]) -> tuple[dict[str, _Column], dict[str, str]]:
    """Find adjustments and their references among columns of numbers, and the quantities they are of."""
    found: dict[str, _Column] = {}
    quantities: dict[str, str] = {}
    numeric = [column for column in free if column.numbers]
    adjusted = [column for column in numeric if _ADJUSTED & set(column.words)]
    references = [
        column for column in numeric if _REFERENCE & set(column.words) and column not in adjusted
    ]
    for column in adjusted:
        about = column.about(_ADJUSTED)
        own = [ref for ref in references if ref.about(_REFERENCE) == about]
        if not own and (len(references) == 1 or len(adjusted) == 1):
            own = references
        unit = column.unit or next((ref.unit for ref in own[:1] if ref.unit), None) or ""
        name = (
            about
            or "".join(ref.about(_REFERENCE) for ref in own[:1])
            or _UNITS.get(unit, "response")
        )
        name = {"stiffness": "k", "damping": "b"}.get(name, name)
        if re.match("[a-z]", name) and f"{name}_adj" not in found:
            if name not in IMPEDANCE:
                quantities[name] = unit
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


def _toml(text: str) -> str:
    """Write a TOML string: a JSON one, but for DEL, which TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
