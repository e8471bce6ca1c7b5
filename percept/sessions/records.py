"""What the reader says beside the table: sources, notices, exclusions, and problems in one message."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from percept.errors import PerceptError, UsageError

IDS = ("subject", "session", "environment")
#: Mass of an environment (Eq. 7): a reference that nobody adjusts.
MASS = "m_ref"
SUMMARY_COLUMNS = ("environment", "parameter", "reference", "lower", "upper", "n", "level")
#: Problems that a message lists, and problems that are kept.
_LISTED, _KEPT = 10, 1000
#: Problems of one kind that are written out.
_ALIKE = 3

#: From a row's position in a table to its `file` and `row`.
Place = Callable[[int], Mapping[str, Any]]


def clip(value: str, length: int = 60) -> str:
    """Shorten a text from a file to at most `length` characters, for a message."""
    return value if len(value) <= length else value[: length - 1] + "…"


def shown(names: Sequence[str], limit: int = 12) -> str:
    """List names from a file in a message: quoted, control characters escaped, clipped."""
    listed = ", ".join(repr(clip(name)) for name in names[:limit])
    return listed + (f" and {len(names) - limit} more" if len(names) > limit else "")


@dataclass(frozen=True)
class Source:
    """One file that was read: its name, the SHA-256 of its bytes, and its data rows."""

    name: str
    sha256: str
    rows: int


@dataclass(frozen=True)
class Notice:
    """Something the reader decided or noticed that the analyst should know."""

    text: str
    file: str | None = None
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        place = ":".join(
            str(part) for part in (self.file, self.row, self.column) if part is not None
        )
        return f"{place}: {self.text}" if place else self.text


@dataclass(frozen=True)
class Exclusion:
    """One observation or subject left out: who, what was left out, why, and where it stood."""

    who: str
    what: str
    why: str
    file: str | None = None
    row: int | None = None


@dataclass(frozen=True)
class Factor:
    """A factor within subjects: its column, its levels, and the reference and level of each cell."""

    name: str
    levels: tuple[str, ...]
    cells: Mapping[str, tuple[str, str]]  # "VE1 (left)": VE1 at left

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Levels two by two; the second is compared with the first."""
        return list(combinations(self.levels, 2))

    @property
    def environments(self) -> list[str]:
        """Environments in the order of their cells."""
        return list(dict.fromkeys(environment for environment, _ in self.cells.values()))

    def cell(self, environment: str, level: str) -> str:
        """Name the cell of an environment at a level."""
        return f"{environment} ({level})"


class ReadError(UsageError):
    """Input that cannot be read as it stands; lists the first problems found.

    Parameters
    ----------
    problems : sequence of UsageError
        At least one, in the order they were found. The first one's file, row, column, value and
        hint are this error's own.
    total : int, optional
        How many there are in all, where not all were kept.

    Attributes
    ----------
    problems : tuple of UsageError
        All that were kept.
    """

    def __init__(self, problems: Sequence[UsageError], total: int | None = None) -> None:
        first = problems[0]
        place = {
            name: getattr(first, name) for name in ("file", "row", "column", "key", "value", "hint")
        }
        super().__init__(first.message, **place)
        self.problems = tuple(problems)
        self.total = len(self.problems) if total is None else total

    def __str__(self) -> str:
        if self.total == 1:
            return str(self.problems[0])
        lines = summarised(self.problems)[:_LISTED]
        more = ["percept validate lists them by kind"] if self.total > _LISTED else []
        return "\n  ".join([f"{self.total} problems:", *lines, *more])


class NoDataError(UsageError):
    """A file without trials, as an aborted run or a tracker leaves; it is left out where others have them."""


def summarised(problems: Sequence[PerceptError]) -> list[str]:
    """Give a line per problem; of a kind in one column of a file, three and how many more there are."""
    kinds: dict[tuple[object, ...], list[PerceptError]] = {}
    for problem in problems:
        kinds.setdefault((problem.file, problem.column, problem.message), []).append(problem)
    lines: list[str] = []
    for alike in kinds.values():
        lines += map(str, alike[:_ALIKE])
        if more := alike[_ALIKE:]:
            where = (
                f"{more[0].file}, column {more[0].column!r}, rows {more[0].row} to {more[-1].row}"
            )
            lines.append(f"{where}: {len(more)} more of this kind")
    return lines


class Problems:
    """A bounded list of problems, so that a user mends a file once and not once per error."""

    def __init__(self) -> None:
        self._kept: list[UsageError] = []
        self.total = 0

    def add(self, message: str, *, value: object = None, **place: Any) -> None:
        """Record one problem; arguments as in :class:`~percept.errors.UsageError`."""
        self.extend(
            UsageError(message, value=clip(value) if isinstance(value, str) else value, **place)
        )

    def extend(self, error: UsageError) -> None:
        """Record an error, or each problem of a :class:`ReadError`."""
        found = error.problems if isinstance(error, ReadError) else (error,)
        self._kept.extend(found[: max(0, _KEPT - len(self._kept))])
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
