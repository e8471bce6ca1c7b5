"""What the reader says beside the table: sources, notices, exclusions, and problems with places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Unpack

from percept.errors import Concerned, PerceptError, UsageError

IDS = ("subject", "session", "environment")
#: Mass of an environment (Eq. 7): a reference that nobody adjusts.
MASS = "m_ref"
SUMMARY_COLUMNS = ("environment", "parameter", "reference", "lower", "upper", "n", "level")
#: The same of a summary of means and SDs.
MOMENTS_COLUMNS = ("environment", "parameter", "reference", "mean", "sd", "n", "level")
#: Lines of a message about several problems.
_LISTED = 10
#: Problems that are kept; of a broken file of a million rows nobody reads more.
_KEPT = 1000
#: Problems of one kind that are written out.
_ALIKE = 3


#: Names, and characters of a text from a file, that a message shows.
_NAMES = 12
_CLIPPED = 60


def clip(value: str) -> str:
    """Shorten a text from a file for a message."""
    return value if len(value) <= _CLIPPED else value[: _CLIPPED - 1] + "…"


def shown(names: Sequence[str]) -> str:
    """List names from a file in a message: quoted, control characters escaped, clipped."""
    listed = ", ".join(repr(clip(name)) for name in names[:_NAMES])
    more = len(names) - _NAMES
    return f"{listed} and {more} more" if more > 0 else listed


@dataclass(frozen=True)
class Source:
    """A file that was read."""

    name: str  # In report.json without its folders
    sha256: str  # Of its bytes
    rows: int  # Of data


@dataclass(frozen=True)
class Notice:
    """Something the reader decided or noticed that the analyst should know."""

    text: str
    file: str | None = None
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        parts = [str(part) for part in (self.file, self.row, self.column) if part is not None]
        return ": ".join([":".join(parts), self.text]) if parts else self.text


class Found(NamedTuple):
    """What a check finds in a table: what is wrong, its column, row and value, and what to do."""

    message: str
    column: Any = None  # Its name, or a label that has one
    row: Any = None  # Label in the table
    value: object = None
    hint: str = ""


def once_per_text(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Merge notices that say the same of a column: the first, with their count."""
    alike: dict[object, list[Notice]] = {}
    for notice in dict.fromkeys(notices):
        alike.setdefault((notice.column, notice.text), []).append(notice)
    return tuple(
        replace(first, text=f"{first.text} (and {len(others)} more like this)") if others else first
        for first, *others in alike.values()
    )


@dataclass(frozen=True)
class Exclusion:
    """An observation or a subject that was left out, and where it stood."""

    who: str
    what: str
    why: str
    file: str | None = None
    row: int | None = None


@dataclass(frozen=True)
class Factors:
    """Columns of conditions or groups, their levels, and what each cell combines."""

    levels: Mapping[str, tuple[str, ...]]  # By column
    #: "VE1 (left, low)": VE1, at a level of each column
    cells: Mapping[str, tuple[str, tuple[str, ...]]]

    @property
    def environments(self) -> list[str]:
        """Environments in the order of their cells."""
        return list(dict.fromkeys(environment for environment, _ in self.cells.values()))

    @staticmethod
    def cell(environment: str, levels: Sequence[str]) -> str:
        """Name the cell of an environment at a level of each column."""
        return f"{environment} ({', '.join(levels)})"


class ReadError(UsageError):
    """Input that cannot be read as it stands; lists the first problems found.

    Parameters
    ----------
    problems : sequence of UsageError
        At least one, in the order they were found. The first one's file, row, column, value and
        hint are this error's own.
    total : int
        How many there are in all; not all may be kept.

    Attributes
    ----------
    problems : tuple of UsageError
        All that were kept.
    """

    def __init__(self, problems: Sequence[UsageError], total: int) -> None:
        super().__init__(problems[0].message)
        vars(self).update(vars(problems[0]))
        self.problems = tuple(problems)
        self.total = total
        # Pickle makes an error again from these: it comes back from a process of its own.
        self.args = (problems, total)

    def __str__(self) -> str:
        if self.total == 1:
            return str(self.problems[0])
        lines = [f"{self.total} problems:", *summarised(self.problems)[:_LISTED]]
        if self.total > _LISTED:
            lines.append("percept validate lists them by kind")
        return "\n  ".join(lines)


class NoDataError(UsageError):
    """A file without trials, of an aborted run or a tracker; left out if others have them."""


def summarised(problems: Sequence[PerceptError]) -> list[str]:
    """Give a line per problem, but for a kind in one column three and their number."""
    kinds: dict[tuple[object, ...], list[PerceptError]] = {}
    for problem in problems:
        kind = (problem.file, problem.column, problem.message)
        kinds.setdefault(kind, []).append(problem)
    lines: list[str] = []
    for of_kind in kinds.values():
        lines += [str(problem) for problem in of_kind[:_ALIKE]]
        rest = of_kind[_ALIKE:]
        if rest:
            rows = f"rows {rest[0].row} to {rest[-1].row}"
            where = f"{rest[0].file}, column {rest[0].column!r}, {rows}"
            lines.append(f"{where}: {len(rest)} more of this kind")
    return lines


class Problems:
    """A bounded list of problems, so that a user corrects a file once and not once per error."""

    def __init__(self) -> None:
        self._kept: list[UsageError] = []
        self.total = 0

    def add(self, message: str, **concerned: Unpack[Concerned]) -> None:
        """Record one problem; arguments as in :class:`~percept.errors.UsageError`."""
        value = concerned.get("value")
        if isinstance(value, str):
            concerned["value"] = clip(value)
        self.extend(UsageError(message, **concerned))

    def extend(self, error: UsageError) -> None:
        """Record an error, or each problem of a :class:`ReadError`."""
        problems = error.problems if isinstance(error, ReadError) else (error,)
        self._kept += problems[: _KEPT - len(self._kept)]
        self.total += error.total if isinstance(error, ReadError) else 1

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Record an error raised inside, so that the next file is read too."""
        try:
            yield
        except UsageError as error:
            self.extend(error)

    def raise_if_any(self) -> None:
        """Raise a :class:`ReadError` if a problem was recorded."""
        if self.total:
            raise ReadError(self._kept, self.total)
