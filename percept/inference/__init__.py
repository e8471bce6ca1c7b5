"""Classical inference on users; the hierarchical model is in `percept.inference.model`."""

from __future__ import annotations

from percept.inference.classical.intervals import (
    prediction_interval,
    t_interval,
    tolerance_factor,
    tolerance_interval,
)
from percept.inference.classical.moments import Moments, check_normality
from percept.inference.record import Interval

__all__ = [
    "Interval",
    "Moments",
    "check_normality",
    "prediction_interval",
    "t_interval",
    "tolerance_factor",
    "tolerance_interval",
]
