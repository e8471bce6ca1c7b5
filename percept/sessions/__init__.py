"""Session files to one checked, tidy table: nothing guessed, nothing lost."""

from __future__ import annotations

from percept.sessions.options import ColumnRule, ExcludeRule
from percept.sessions.proposals import propose_scene
from percept.sessions.quantities import Quantity
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.records import Exclusion, Notice, ReadError, Source
from percept.sessions.validate import Validation, format_validation, validate

__all__ = [
    "ColumnRule",
    "ExcludeRule",
    "Exclusion",
    "Notice",
    "Quantity",
    "ReadError",
    "Sessions",
    "Source",
    "Validation",
    "format_validation",
    "propose_scene",
    "read_sessions",
    "validate",
]
