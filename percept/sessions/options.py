"""How to read a study's files: the scene's [columns], [sessions] and [environments] as one record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["ReadOptions"]


@dataclass(frozen=True)
class ReadOptions:
    """How to read a study's files."""

    columns: Mapping[str, Any] | None = None

    @classmethod
    def from_mapping(cls, tables: Mapping[str, Any]) -> ReadOptions:
        """Build from the scene's tables `columns`, `sessions` and `environments`."""
        return cls(columns=tables.get("columns"))
