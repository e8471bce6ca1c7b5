"""What percept says of files before an analysis: what it read, and every problem."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from percept.errors import PerceptError, counted, printable
from percept.sessions.options import ReadOptions
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Exclusion, Notice, ReadError, Source, summarised

_ALONE = Notice("there is one subject; an interval over subjects needs at least two")
_VERDICTS = ("read without problems", "read, but no analysis is possible")


@dataclass(frozen=True)
class EnvironmentRead:
    """What was understood of one environment."""

    name: str
    references: Mapping[str, float]  #: By quantity, in its unit
    subjects: int
    #: Fewest and most trials of a subject; None for published limits.
    trials: tuple[int, int] | None


@dataclass(frozen=True)
class Validation:
    """What was read of a study, or why it cannot be read."""

    exit_code: int = 0  #: 0 read, 1 an analysis would refuse (one subject), 2 problems
    form: str | None = None  #: As the next four, of :class:`~percept.sessions.Sessions`
    sources: tuple[Source, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[Notice, ...] = ()  #: With the warnings
    exclusions: tuple[Exclusion, ...] = ()
    environments: tuple[EnvironmentRead, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)  #: Of the references, by quantity
    problems: tuple[PerceptError, ...] = ()
    problems_total: int = 0  #: All of them, where not all were kept

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain tables for JSON; of a problem its message, place, value and hint."""
        names = ("message", "file", "row", "column", "key", "value", "hint")
        problems = [{name: getattr(problem, name) for name in names} for problem in self.problems]
        plain = dataclasses.asdict(dataclasses.replace(self, problems=()))
        return plain | {"problems": problems}


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
        return Validation(
            exit_code=error.exit_code, problems=error.problems, problems_total=error.total
        )
    except PerceptError as error:
        return Validation(exit_code=error.exit_code, problems=(error,), problems_total=1)
    notices = [*sessions.notices, *sessions.warnings]
    alone = sessions.form == "trials" and len(sessions.subjects) < 2
    if alone:
        notices.append(_ALONE)
    return Validation(
        exit_code=int(alone),
        form=sessions.form,
        sources=sessions.sources,
        counts=dict(sessions.counts),
        notices=tuple(notices),
        exclusions=sessions.exclusions,
        environments=tuple(_environments(sessions)),
        units={name: sessions.quantities[name].unit for name in sessions.parameters},
    )


def _environments(sessions: Sessions) -> Iterator[EnvironmentRead]:
    """Give a record of each environment: references, subjects, and trials of a subject."""
    for name, rows in sessions.by_environment():
        if sessions.form == "summary":
            references = dict(zip(rows["parameter"], rows["reference"].tolist(), strict=True))
            yield EnvironmentRead(name, references, int(rows["n"].max()), None)
            continue
        trials = rows.groupby("subject").size()
        references = {p: float(rows[f"{p}_ref"].iloc[0]) for p in sessions.parameters}
        several = (int(trials.min()), int(trials.max()))
        yield EnvironmentRead(name, references, len(trials), several)


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
    for reason, number in found.counts.items():
        lines.append(f"  {number:>9}  {say(reason)}")
    if found.environments:
        table = pd.DataFrame([_line(environment, found, say) for environment in found.environments])
        lines += table.to_string(index=False).splitlines()
    lines += [f"notice: {notice}" for notice in found.notices]
    for left in found.exclusions:
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


def _line(
    environment: EnvironmentRead, found: Validation, say: Callable[[str], str]
) -> dict[str, str | int]:
    """Line of the table of environments."""
    line: dict[str, str | int] = {say("environment"): printable(environment.name)}
    for p, unit in found.units.items():
        value = environment.references.get(p)
        written = "–" if value is None or value != value else f"{value:g}"
        line[f"{p}_ref ({unit})" if unit else f"{p}_ref"] = written
    trials = "published"
    if environment.trials is not None:
        trials = " to ".join(str(number) for number in dict.fromkeys(environment.trials))
    line[say("subjects")] = environment.subjects
    line[say("trials per subject")] = trials
    return line
