"""Names and units of the two parameters."""

from __future__ import annotations

__all__ = ["NAMES", "UNITS"]

NAMES = {"k": "stiffness", "b": "damping"}
UNITS = {"k": "N/m", "b": "N·s/m"}
