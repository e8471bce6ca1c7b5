"""Bands of a study's intervals against the impedance of its environments."""

from __future__ import annotations

import numpy as np
import pandas as pd

from percept.boundary.band import BandStudy, environment_magnitude_range, power_law
from percept.study.cells import both_limits

__all__ = ["band_study"]


def band_study(intervals: pd.DataFrame, *, omega: float, level: float) -> BandStudy:
    """Band of abs(Z_e) over each environment's rectangle of intervals, and its power law.

    Parameters
    ----------
    intervals : DataFrame
        `Study.intervals`.
    omega : float
        rad/s.
    level : float
        Level of the laws' parameter intervals.

    Returns
    -------
    BandStudy
    """
    marginal = intervals[intervals["joint"] == "marginal"]
    rows = []
    for (environment, method, kind, family), cell in marginal.groupby(
        ["environment", "method", "kind", "family"], sort=False
    ):
        found = both_limits(cell)
        if found is None:
            continue
        lower, upper = environment_magnitude_range(omega, *found)
        k_ref, b_ref = (float(cell.loc[cell["parameter"] == p, "reference"].iloc[0]) for p in ("k", "b"))
        impedance = float(np.hypot(b_ref, k_ref / omega))
        rows.append(
            {
                "environment": environment,
                "method": method,
                "kind": kind,
                "family": family,
                "impedance": impedance,
                "lower": lower,
                "upper": upper,
                "band": upper - lower,
                "relative": (upper - lower) / impedance,
            }
        )
    table = pd.DataFrame(rows)
    laws = [
        power_law(
            str(method),
            str(kind),
            str(family),
            part["impedance"].to_numpy(),
            part["band"].to_numpy(),
            level=level,
        )
        for (method, kind, family), part in table.groupby(["method", "kind", "family"], sort=False)
        if len(part) >= 3
    ]
    return BandStudy(omega, table, tuple(laws))
