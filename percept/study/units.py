"""Names of the two parameters."""

from __future__ import annotations

NAMES = {"k": "stiffness", "b": "damping"}
