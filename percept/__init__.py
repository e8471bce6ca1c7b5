"""Realistic performance boundaries of haptic systems, from perception experiments.

Start with :func:`read_sessions`, :class:`Scene` and :class:`Study`; the building blocks are in
:mod:`percept.haptics`, :mod:`percept.inference` and :mod:`percept.boundary`.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

__all__ = [
    "PerceptError",
    "RefusalError",
    "Scene",
    "Sessions",
    "Study",
    "UsageError",
    "__version__",
    "read_sessions",
]

# Names are resolved on first use, so that `import percept` and `percept --help` start at once.
_HOME = {
    "PerceptError": "percept.errors",
    "RefusalError": "percept.errors",
    "Scene": "percept.scene",
    "Sessions": "percept.sessions",
    "Study": "percept.study",
    "UsageError": "percept.errors",
    "read_sessions": "percept.sessions",
}
_SUBPACKAGES = frozenset({"boundary", "haptics", "inference"})


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _SUBPACKAGES:
        return importlib.import_module(f"percept.{name}")
    raise AttributeError(f"module 'percept' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_SUBPACKAGES])
