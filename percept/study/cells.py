"""Rows of the interval table that belong to one environment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

__all__ = ["Limits", "paired_limits"]

Limits = tuple[float, float]


def paired_limits(
    intervals: pd.DataFrame, labels: Sequence[str]
) -> Iterator[tuple[dict[str, dict[str, Any]], tuple[Limits, Limits]]]:
    """Pair the rows of stiffness and damping that agree in all labels.

    Parameters
    ----------
    intervals : DataFrame
        Of `Study.intervals`, at most one row per parameter and labels.
    labels : sequence of str
        Columns.

    Yields
    ------
    rows : dict of str to dict
        Both rows by parameter; pairs in order of first appearance, those without one of the two left out.
    limits : pair of (float, float)
        Lower and upper of stiffness and of damping, N/m and N·s/m.
    """
    pairs: dict[tuple[Any, ...], dict[str, dict[str, Any]]] = {}
    for row in intervals.to_dict("records"):
        one = {str(name): value for name, value in row.items()}
        pairs.setdefault(tuple(one[label] for label in labels), {})[one["parameter"]] = one
    for rows in pairs.values():
        if len(rows) == 2:
            k, b = ((float(rows[p]["lower"]), float(rows[p]["upper"])) for p in ("k", "b"))
            yield rows, (k, b)
