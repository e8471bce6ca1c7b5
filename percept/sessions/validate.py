"""What percept says of files before an analysis: what it read, and every problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import ReadOptions
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Notice, ReadError, Source, summarised

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")
_VERDICTS = ("read without problems", "read, but no analysis is possible")
_Plain = dict[str, Any]


@dataclass(frozen=True)
class Validation:
    """What was read of a study, or why it cannot be read."""

    exit_code: int = 0  #: 0 read, 1 an analysis would refuse (one subject), 2 problems
    sessions: Sessions | None = None  #: None where there are problems
    problems: tuple[PerceptError, ...] = ()
    problems_total: int = 0  #: All of them, where not all were kept

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files read."""
        return self.sessions.sources if self.sessions else ()

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What the reader announced, with the warnings."""
        if self.sessions is None:
            return ()
        alone = (_ALONE,) if self.exit_code else ()
        return (*self.sessions.notices, *self.sessions.warnings, *alone)

    def to_dict(self) -> _Plain:
        """Return it as plain tables for JSON; of a problem its message, place, value and hint."""
        names = ("message", "file", "row", "column", "key", "value", "hint")
        read = self.sessions
        return {
            "exit_code": self.exit_code,
            "form": read and read.form,
            "sources": [asdict(source) for source in self.sources],
            "counts": dict(read.counts) if read else {},
            "notices": [asdict(notice) for notice in self.notices],
            "exclusions": [asdict(left) for left in read.exclusions] if read else [],
            "environments": _environments(read) if read else [],
            "units": _units(read) if read else {},
            "problems": [{name: getattr(own, name) for name in names} for own in self.problems],
            "problems_total": self.problems_total,
        }


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


def _units(sessions: Sessions) -> dict[str, str]:
    """Name the unit of each quantity's references."""
    return {name: sessions.quantities[name].unit for name in sessions.parameters}


def _environments(sessions: Sessions) -> list[_Plain]:
    """Say of each environment its references, subjects, and the fewest and most trials of one."""
    found = []
    for name, rows in sessions.by_environment():
        if sessions.form == "summary":
            references = dict(zip(rows["parameter"], rows["reference"].tolist(), strict=True))
            subjects = int(rows["n"].max())
            trials = None
        else:
            references = {p: float(rows[f"{p}_ref"].iloc[0]) for p in sessions.parameters}
            counts = rows.groupby("subject").size()
            subjects = len(counts)
            trials = [int(counts.min()), int(counts.max())]
        own = {"name": name, "references": references, "subjects": subjects, "trials": trials}
        found.append(own)
    return found


def format_validation(found: Validation, *, say: Callable[[str], str] = str) -> str:
    """Plain text of a validation, one finding per line, each beginning with its file and row.

    Parameters
    ----------
    found : Validation
        What `validate` gives.
    say : callable, optional
        What puts percept's words for environments and subjects into the study's.

    Returns
    -------
    str
    """
    lines = []
    for source in found.sources:
        lines.append(f"{source.name}: {source.rows} rows, sha256 {source.sha256}")
    if found.sessions is not None:
        for reason, number in found.sessions.counts.items():
            lines.append(f"  {number:>9}  {say(reason)}")
        units = _units(found.sessions)
        table = [_line(own, units, say) for own in _environments(found.sessions)]
        lines += pd.DataFrame(table).to_string(index=False).splitlines()
        lines += [f"notice: {notice}" for notice in found.notices]
        for left in found.sessions.exclusions:
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
    return "\n".join(printable(line) for line in lines)


def _line(own: _Plain, units: Mapping[str, str], say: Callable[[str], str]) -> dict[str, str | int]:
    """Line of the table of environments."""
    line: dict[str, str | int] = {say("environment"): printable(own["name"])}
    for p, unit in units.items():
        value = own["references"].get(p)
        written = "–" if value is None or value != value else f"{value:g}"
        line[f"{p}_ref ({unit})" if unit else f"{p}_ref"] = written
    line[say("subjects")] = own["subjects"]
    trials = own["trials"] or ["published"]
    line[say("trials per subject")] = " to ".join(map(str, dict.fromkeys(trials)))
    return line
