"""Rows of the interval table that belong to one environment."""

from __future__ import annotations

import pandas as pd

__all__ = ["Limits", "both_limits"]

Limits = tuple[float, float]


def both_limits(rows: pd.DataFrame) -> tuple[Limits, Limits] | None:
    """Take the limits of stiffness and damping from the rows of one interval.

    Parameters
    ----------
    rows : DataFrame
        At most one row per parameter.

    Returns
    -------
    stiffness, damping : tuple of float
        Lower and upper, N/m and N·s/m; None where a parameter is missing.
    """
    limits = {
        str(p): (float(low), float(high))
        for p, low, high in rows[["parameter", "lower", "upper"]].itertuples(index=False)
    }
    return (limits["k"], limits["b"]) if len(limits) == 2 else None
