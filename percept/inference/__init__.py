"""Inference on users: classical intervals, and the hierarchical model.

Names are resolved on first use, so that asking for a classical interval imports no sampler.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "record": ("Interval",),
    "classical.intervals": (
        "bias", "prediction_interval", "t_interval", "tolerance_interval", "weber_fraction"
    ),
    "classical.moments": ("Moments",),
    "classical.tolerance": ("tolerance_factor",),
    "classical.trials": ("check_normality",),
}  # fmt: skip
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
