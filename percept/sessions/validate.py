"""What `percept validate` says: what was read, every notice, every problem, and the exit code."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import ReadOptions
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Exclusion, Notice, ReadError, Source, summarised

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")


@dataclass(frozen=True)
class Validation:
    """The outcome of reading a study.

    Attributes
    ----------
    exit_code : {0, 1, 2}
        0: read; 1: an analysis would refuse; 2: problems.
    form : {"trials", "summary"}, optional
        None where nothing could be read.
    sources, notices, exclusions : tuple
        As in :class:`~percept.sessions.Sessions`.
    counts : mapping of str to int
    environments : tuple of mapping
        What was understood: per environment its `references` by quantity, `subjects`, and the fewest and most
        `trials` of a subject (None for published limits).
    units : mapping of str to str
        Of the references.
    problems : tuple of PerceptError
        All that were kept; `total` counts them all.
    """

    exit_code: int
    form: str | None = None
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    environments: tuple[Mapping[str, Any], ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    problems: tuple[PerceptError, ...] = ()
    total: int = 0

    def to_json(self) -> str:
        """JSON object with the same keys; a problem has message, file, row, column, key, value and hint."""
        names = ("message", "file", "row", "column", "key", "value", "hint")
        out = {
            "exit_code": self.exit_code,
            "form": self.form,
            "sources": [vars(source) for source in self.sources],
            "counts": dict(self.counts),
            "environments": list(self.environments),
            "units": dict(self.units),
            "notices": [vars(notice) for notice in self.notices],
            "exclusions": [vars(exclusion) for exclusion in self.exclusions],
            "problems": [{name: getattr(problem, name) for name in names} for problem in self.problems],
            "problems_total": self.total,
        }
        return json.dumps(out, ensure_ascii=False, indent=2, default=str)


def validate(*paths: str | Path, options: ReadOptions | None = None) -> Validation:
    """Read a study as `read_sessions` does, and report instead of raising.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`.
    options : ReadOptions, optional
        How to read them.

    Returns
    -------
    Validation
        It also tells what every analysis would refuse for want of data: fewer than two subjects.
    """
    try:
        sessions = read_sessions(*paths, options=options)
    except PerceptError as error:
        problems = error.problems if isinstance(error, ReadError) else (error,)
        total = error.total if isinstance(error, ReadError) else 1
        return Validation(error.exit_code, problems=problems, total=total)
    alone = sessions.form == "trials" and len(sessions.subjects) < 2
    return Validation(
        exit_code=int(alone),
        form=sessions.form,
        sources=sessions.sources,
        notices=(*sessions.notices, *sessions.warnings, *([_ALONE] if alone else [])),
        exclusions=sessions.exclusions,
        counts=sessions.counts,
        environments=tuple(_understood(sessions)),
        units={name: sessions.quantities[name].unit for name in sessions.parameters},
    )


def _understood(sessions: Sessions) -> Iterator[dict[str, Any]]:
    """Give a record of each environment: references, subjects, and trials of a subject."""
    for name, rows in sessions.by_environment():
        if sessions.form == "summary":
            references = dict(zip(rows["parameter"], rows["reference"].tolist(), strict=True))
            yield {"name": name, "references": references, "subjects": int(rows["n"].max()), "trials": None}
            continue
        trials = rows.groupby("subject").size()
        yield {
            "name": name,
            "references": {p: float(rows[f"{p}_ref"].iloc[0]) for p in sessions.parameters},
            "subjects": len(trials),
            "trials": [int(trials.min()), int(trials.max())],
        }


def _table(record: Validation, say: Callable[[str], str]) -> list[str]:
    """Lay out what was understood, a line per environment."""
    rows = []
    for one in record.environments:
        row = {say("environment"): printable(one["name"])}
        for p, unit in record.units.items():
            value = one["references"].get(p, np.nan)
            row[f"{p}_ref ({unit})".replace(" ()", "")] = "–" if value != value else f"{value:g}"
        trials = "published" if one["trials"] is None else " to ".join(map(str, dict.fromkeys(one["trials"])))
        rows.append(row | {say("subjects"): one["subjects"], say("trials per subject"): trials})
    return pd.DataFrame(rows).to_string(index=False).splitlines() if rows else []


def format_validation(record: Validation, *, say: Callable[[str], str] = str) -> str:
    """Plain text of a validation, one finding per line, each beginning with its file:row:column.

    Parameters
    ----------
    record : Validation
    say : callable, optional
        What puts percept's words for environments and subjects into the study's.

    Returns
    -------
    str
    """
    lines = [f"{s.name}: {s.rows} rows, sha256 {s.sha256}" for s in record.sources]
    lines += [f"  {number:>9}  {say(reason)}" for reason, number in record.counts.items()]
    lines += _table(record, say)
    lines += [f"notice: {notice}" for notice in record.notices]
    for e in record.exclusions:
        lines.append(f"left out: {f'{e.file}:{e.row}: ' if e.file else ''}subject {e.who}, {e.what}: {e.why}")
    lines += summarised(record.problems, _problem)
    if record.total > len(record.problems):
        lines.append(f"and {record.total - len(record.problems)} more problems")
    verdicts = (
        "read without problems",
        "read, but no analysis is possible",
        counted(record.total, "problem"),
    )
    return "\n".join(map(printable, [*lines, verdicts[record.exit_code]]))


def _problem(problem: PerceptError) -> str:
    parts = (problem.file, problem.row, problem.column, problem.key)
    place = ":".join(str(part) for part in parts if part is not None)
    value = f" (found {problem.value!r})" if problem.value is not None else ""
    hint = f" {problem.hint}" if problem.hint else ""
    return f"{place + ': ' if place else ''}{problem.message}{value}{hint}"
