"""Simulated studies: from the hierarchical model, and like a published table of limits.

Nothing here is measured, and every table made here says so in its column `source`.
"""

from __future__ import annotations

from percept.simulate.design import Design
from percept.simulate.like import Correlations, realised_correlations, simulate_like, simulate_like_csv
from percept.simulate.model import (
    Hyperparameters,
    Responses,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
)
from percept.simulate.published import PublishedLimits, read_summary
from percept.simulate.study import SimulatedStudy, simulate
from percept.simulate.tables import session_table, write_sessions

__all__ = [
    "Correlations",
    "Design",
    "Hyperparameters",
    "PublishedLimits",
    "Responses",
    "SimulatedStudy",
    "TrueValues",
    "draw_environments",
    "draw_hyperparameters",
    "draw_responses",
    "read_summary",
    "realised_correlations",
    "session_table",
    "simulate",
    "simulate_like",
    "simulate_like_csv",
    "write_sessions",
]
