"""Names and units of the two parameters."""

from __future__ import annotations

from percept.sessions.units import UNITS

__all__ = ["NAMES", "UNITS"]

NAMES = {"k": "stiffness", "b": "damping"}
