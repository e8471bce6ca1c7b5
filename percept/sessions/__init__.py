"""Session files to one checked, tidy table: nothing guessed, nothing lost."""

from __future__ import annotations

from percept.sessions.cell_sums import Reduced
from percept.sessions.options import ColumnRule, ExcludeRule, ReadOptions
from percept.sessions.problems import ReadError
from percept.sessions.read import read_sessions
from percept.sessions.records import Exclusion, Notice, Sessions, Source
from percept.sessions.reduce import reduce_sessions
from percept.sessions.validation import Validation, format_validation, propose_columns, validate

__all__ = [
    "ColumnRule",
    "ExcludeRule",
    "Exclusion",
    "Notice",
    "ReadError",
    "ReadOptions",
    "Reduced",
    "Sessions",
    "Source",
    "Validation",
    "format_validation",
    "propose_columns",
    "read_sessions",
    "reduce_sessions",
    "validate",
]
