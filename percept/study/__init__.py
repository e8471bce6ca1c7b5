"""A study: everything an analysis can give, evaluated on demand; and what can be made of one or two."""

from __future__ import annotations

import importlib
from typing import Any

from percept.study.basics import Skipped
from percept.study.coupling import CouplingStudy
from percept.study.device import DeviceSensitivity
from percept.study.study import Study

__all__ = [
    "CouplingStudy",
    "DeviceSensitivity",
    "Fit",
    "LeftOut",
    "ModelChecks",
    "ModelChoice",
    "PairComparison",
    "Prediction",
    "Skipped",
    "Study",
    "SubjectChecks",
    "compare_studies",
    "leave_one_environment_out",
    "predict",
    "split_by",
]
# Resolved on first use: they import the hierarchical model, which the classical method does without.
_HOME = {
    "Fit": "fit",
    "LeftOut": "prediction",
    "ModelChecks": "checks",
    "ModelChoice": "model_choice",
    "PairComparison": "compare",
    "Prediction": "prediction",
    "SubjectChecks": "checks",
    "compare_studies": "compare",
    "leave_one_environment_out": "prediction",
    "predict": "prediction",
    "split_by": "compare",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
