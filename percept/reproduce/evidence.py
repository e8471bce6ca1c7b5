"""What the published numbers say on one sentence of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

__all__ = ["Evidence", "Value", "evidence", "undecided"]

#: What braces in a text take: a number, a text, a list of them, numbers by name, or a record.
Value: TypeAlias = Any


@dataclass(frozen=True)
class Evidence:
    """The cases that decide a verdict, and the values that `claims.toml` names in braces."""

    cases: list[bool] | None  # None where no published number decides
    values: Mapping[str, Value]


def evidence(cases: Iterable[object], **values: Value) -> Evidence:
    """Return what decides: true or false in each case, and the values of the text."""
    return Evidence([bool(case) for case in cases], values)


def undecided(**values: Value) -> Evidence:
    """Return the values of a text on a sentence that no published number decides."""
    return Evidence(None, values)
