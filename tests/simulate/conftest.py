"""What simulated studies are held to."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pandas as pd
from scipy import stats


def printed_limits(values, level, like):
    """Eqs 14-15 by SciPy, printed with the decimals of the limits given."""
    numbers = np.array(list(values), dtype=float)
    limits = stats.t.interval(float(level), len(numbers) - 1, numbers.mean(), stats.sem(numbers))
    return tuple(
        str(Decimal(float(limit)).quantize(Decimal(text)))
        for limit, text in zip(limits, like, strict=True)
    )


def correlations(sessions: pd.DataFrame) -> tuple[float, float]:
    """Average correlation of log k and log b in one environment, and of either in two, pair by
    pair."""
    logs = {
        (name, environment): np.log(group.sort_values("subject")[f"{name}_adj"].to_numpy())
        for environment, group in sessions.groupby("environment")
        for name in ("k", "b")
    }
    names = sorted({environment for _, environment in logs})
    within = [np.corrcoef(logs["k", e], logs["b", e])[0, 1] for e in names]
    across = [
        np.corrcoef(logs[p, e], logs[p, f])[0, 1]
        for p in ("k", "b")
        for e in names
        for f in names
        if e < f
    ]
    assert len(across) == 20
    return float(np.mean(within)), float(np.mean(across))
