"""Inference on users: classical intervals, regions of stiffness and damping, and the hierarchical model.

Names are resolved on first use, so that asking for a classical interval imports no sampler.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "covers": ("coverage_sentence",),
    "intervals": ("Interval",),
    "regions": ("EllipseRegion", "RectangleRegion"),
    "classical.bias": ("Bias", "Equivalence", "bias", "equivalence_test"),
    "classical.diagnostics": ("Influence", "Normality", "check_normality", "influence"),
    "classical.exact": ("MomentsAccumulator",),
    "classical.joint": ("ellipse_region", "rectangle_region"),
    "classical.levels": ("OneMinus",),
    "classical.moments": ("Moments",),
    "classical.sample_intervals": ("prediction_interval", "t_interval", "tolerance_interval"),
    "classical.spread": ("RelativeSpread", "coefficient_of_variation", "weber_fraction"),
    "classical.tolerance": ("howe_factor", "tolerance_factor"),
    "classical.trials": ("SubjectMeans", "subject_means"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
