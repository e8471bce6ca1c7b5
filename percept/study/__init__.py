"""A study: everything an analysis can give, evaluated on demand; and what can be made of one or two."""

from __future__ import annotations

import importlib
from typing import Any

from percept.study.basics import Skipped
from percept.study.coupling import CouplingStudy
from percept.study.study import Study
from percept.study.views import StudyViews

__all__ = [
    "CouplingStudy",
    "Fit",
    "PairComparison",
    "Prediction",
    "Skipped",
    "Study",
    "StudyViews",
    "compare_studies",
    "predict",
]
# Resolved on first use: they import the hierarchical model, which the classical method does
# without.
_HOME = {
    "Fit": "fit",
    "PairComparison": "compare",
    "Prediction": "prediction",
    "compare_studies": "compare",
    "predict": "prediction",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
