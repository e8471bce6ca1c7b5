"""What percept says of files before an analysis: what it read, and every problem."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import DataTables
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
        found = {
            "exit_code": self.exit_code,
            "notices": [vars(notice) for notice in self.notices],
            "problems": [vars(problem) for problem in self.problems],
            "problems_total": self.problems_total,
        }
        if (read := self.sessions) is not None:
            found |= {
                "form": read.form,
                "sources": [vars(source) for source in read.sources],
                "counts": dict(read.counts),
                "exclusions": [vars(exclusion) for exclusion in read.exclusions],
                "environments": _environments(read),
            }
        return found


def validate(*paths: str | Path, scene: DataTables | None = None) -> Validation:
    """Read a study as `read_sessions` does, and report instead of raising.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`.
    scene : Scene, optional
        How to read them.

    Returns
    -------
    Validation
    """
    try:
        sessions = read_sessions(*paths, scene=scene)
    except ReadError as error:
        return Validation(error.exit_code, None, error.problems, error.total)
    except PerceptError as error:
        return Validation(error.exit_code, None, (error,), 1)
    return Validation(int(len(sessions.subjects) == 1), sessions)


def _environments(sessions: Sessions) -> list[dict[str, str | float | None]]:
    """Say of each environment its references, subjects, and the fewest and most trials of one."""
    references = sessions.references.to_dict("index")
    records = []
    for name, rows in sessions.by_environment():
        record: dict[str, str | float | None] = {"environment": name}
        for quantity in sessions.adjusted:
            unit = f" ({quantity.unit})" if quantity.unit else ""
            reference = float(references[name][quantity.name])
            record[f"{quantity.name}_ref{unit}"] = None if np.isnan(reference) else reference
        if sessions.form == "summary":
            record |= {"subjects": int(rows["n"].max()), "trials per subject": "published"}
        else:
            counts = rows["subject"].value_counts()
            fewest_and_most = dict.fromkeys([counts.min(), counts.max()])
            record["subjects"] = len(counts)
            record["trials per subject"] = " to ".join(map(str, fewest_and_most))
        records.append(record)
    return records


def format_validation(found: Validation) -> str:
    """Plain text of a validation, one finding per line, each beginning with its file and row."""
    lines = []
    if (read := found.sessions) is not None:
        for source in read.sources:
            lines.append(f"{source.name}: {source.rows} rows, sha256 {source.sha256}")
        lines += [f"  {number:>9}  {reason}" for reason, number in read.counts.items()]
        table = pd.DataFrame(_environments(read)).to_string(
            index=False,
            na_rep="–",
            float_format="{:g}".format,
            formatters={"environment": printable},
        )
        lines += table.splitlines()
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
