"""Rows of the interval table that belong to one environment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

Limits = tuple[float, float]


def paired_limits(
    intervals: pd.DataFrame, labels: Sequence[str]
) -> Iterator[tuple[dict[str, dict[str, Any]], tuple[Limits, Limits]]]:
    """Pair the rows of stiffness and damping that agree in all labels."""
    pairs: dict[tuple[Any, ...], dict[str, dict[str, Any]]] = {}
    for row in intervals.to_dict("records"):
        one = {str(name): value for name, value in row.items()}
        pairs.setdefault(tuple(one[label] for label in labels), {})[one["parameter"]] = one
    for rows in pairs.values():
        if len(rows) == 2:
            k, b = ((float(rows[p]["lower"]), float(rows[p]["upper"])) for p in ("k", "b"))
            yield rows, (k, b)
