"""Problems are collected, so that a user mends a file once and not once per error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from percept.errors import UsageError

_SHOWN = 10
_KEPT = 1000


def clip(value: str, length: int = 60) -> str:
    """Shorten a text from a file to at most `length` characters, for a message."""
    return value if len(value) <= length else value[: length - 1] + "…"


def shown(names: Sequence[str], limit: int = 12) -> str:
    """List names from a file in a message: quoted, control characters escaped, clipped."""
    listed = ", ".join(repr(clip(name)) for name in names[:limit])
    return listed + (f" and {len(names) - limit} more" if len(names) > limit else "")


class ReadError(UsageError):
    """Input that cannot be read as it stands; lists the first problems found.

    Parameters
    ----------
    problems : sequence of UsageError
        At least one, in the order they were found. The first one's file, row, column, value and hint are
        this error's own.
    total : int, optional
        How many there are in all, where not all were kept.

    Attributes
    ----------
    problems : tuple of UsageError
        All that were kept.
    """

    def __init__(self, problems: Sequence[UsageError], total: int | None = None) -> None:
        first = problems[0]
        super().__init__(
            first.message,
            file=first.file,
            row=first.row,
            column=first.column,
            key=first.key,
            value=first.value,
            hint=first.hint,
        )
        self.problems = tuple(problems)
        self.total = len(self.problems) if total is None else total

    def __str__(self) -> str:
        if self.total == 1:
            return str(self.problems[0])
        lines = [f"{self.total} problems:", *(f"  {problem}" for problem in self.problems[:_SHOWN])]
        if self.total > _SHOWN:
            lines.append(f"  and {self.total - _SHOWN} more")
        return "\n".join(lines)


class Problems:
    """A bounded list of problems; it counts on when it is full."""

    def __init__(self) -> None:
        self._kept: list[UsageError] = []
        self.total = 0

    def __len__(self) -> int:
        return self.total

    def add(self, message: str, *, value: object = None, **place: Any) -> None:
        """Record one problem; the arguments are those of :class:`~percept.errors.UsageError`."""
        self.extend(UsageError(message, value=clip(value) if isinstance(value, str) else value, **place))

    def first(self, places: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Give the places of problems that are worth a record each, and count the others."""
        kept = places[:_KEPT]
        self.total += len(places) - len(kept)
        return kept

    def extend(self, error: UsageError) -> None:
        """Record an error, or each problem of a :class:`ReadError`."""
        found = error.problems if isinstance(error, ReadError) else (error,)
        self._kept.extend(found[: max(0, _KEPT - len(self._kept))])
        self.total += error.total if isinstance(error, ReadError) else 1

    def raise_if_any(self) -> None:
        """Raise a :class:`ReadError` if a problem was recorded."""
        if self.total:
            raise ReadError(self._kept, self.total)
