"""What percept says of files before an analysis: what it read, and every problem."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import ReadOptions
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Notice, ReadError, summarised

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")
_VERDICTS = ("read without problems", "read, but no analysis is possible")


@dataclass(frozen=True)
class Validation:
    """What was read of a study, or why it cannot be read."""

    exit_code: int = 0  #: 0 read, 1 an analysis would refuse (one subject), 2 problems
    sessions: Sessions | None = None  #: None where there are problems
    problems: tuple[PerceptError, ...] = ()
    problems_total: int = 0  #: All of them, where not all were kept

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What the reader announced, with the warnings."""
        if self.sessions is None:
            return ()
        alone = (_ALONE,) if self.exit_code else ()
        return (*self.sessions.notices, *self.sessions.warnings, *alone)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain tables for JSON; of a problem its message, place, value and hint."""
        names = ("message", "file", "row", "column", "key", "value", "hint")
        problems = [{name: getattr(problem, name) for name in names} for problem in self.problems]
        found = {
            "exit_code": self.exit_code,
            "notices": [asdict(notice) for notice in self.notices],
            "problems": problems,
            "problems_total": self.problems_total,
        }
        if (read := self.sessions) is not None:
            found |= {
                "form": read.form,
                "sources": [asdict(source) for source in read.sources],
                "counts": dict(read.counts),
                "exclusions": [asdict(exclusion) for exclusion in read.exclusions],
                "environments": _environments(read),
                "units": {name: read.quantities[name].unit for name in read.parameters},
            }
        return found


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
    """
    try:
        sessions = read_sessions(*paths, scene=options)
    except ReadError as error:
        return Validation(error.exit_code, None, error.problems, error.total)
    except PerceptError as error:
        return Validation(error.exit_code, None, (error,), 1)
    return Validation(int(len(sessions.subjects) == 1), sessions)


def _environments(sessions: Sessions) -> list[dict[str, Any]]:
    """Say of each environment its references, subjects, and the fewest and most trials of one."""
    found = []
    for name, rows in sessions.by_environment():
        if sessions.form == "summary":
            references = dict(zip(rows["parameter"], rows["reference"].tolist(), strict=True))
            subjects = int(rows["n"].max())
            trials = None
        else:
            references = {p: float(rows[f"{p}_ref"].iloc[0]) for p in sessions.parameters}
            counts = rows["subject"].value_counts()
            subjects = len(counts)
            trials = [int(counts.min()), int(counts.max())]
        environment = {"references": references, "subjects": subjects, "trials": trials}
        found.append({"name": name, **environment})
    return found


def format_validation(found: Validation) -> str:
    """Plain text of a validation, one finding per line, each beginning with its file and row."""
    lines = []
    if (read := found.sessions) is not None:
        for source in read.sources:
            lines.append(f"{source.name}: {source.rows} rows, sha256 {source.sha256}")
        lines += [f"  {number:>9}  {reason}" for reason, number in read.counts.items()]
        table = [_line(read, environment) for environment in _environments(read)]
        lines += pd.DataFrame(table).to_string(index=False).splitlines()
        lines += [f"notice: {notice}" for notice in found.notices]
        for left in read.exclusions:
            place = f"{left.file}:{left.row}"
            lines.append(f"left out: {place}: subject {left.who}, {left.what}: {left.why}")
    lines += summarised(found.problems)
    unkept = found.problems_total - len(found.problems)
    if unkept:
        lines.append(f"and {unkept} more problems")
    if found.problems:
        lines.append(counted(found.problems_total, "problem"))
    else:
        lines.append(_VERDICTS[found.exit_code])
    return "\n".join(map(printable, lines))


def _line(sessions: Sessions, environment: dict[str, Any]) -> dict[str, str | int]:
    """Line of the table of environments."""
    line: dict[str, str | int] = {"environment": printable(environment["name"])}
    for name in sessions.parameters:
        unit = sessions.quantities[name].unit
        value = environment["references"].get(name)
        written = "–" if value is None or value != value else f"{value:g}"
        line[f"{name}_ref ({unit})" if unit else f"{name}_ref"] = written
    line["subjects"] = environment["subjects"]
    trials = environment["trials"] or ["published"]
    line["trials per subject"] = " to ".join(map(str, dict.fromkeys(trials)))
    return line
