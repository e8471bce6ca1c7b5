"""What percept says of files before an analysis: what it read, every problem, or a mapping of names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import ReadOptions
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Notice, ReadError, summarised

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")


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
