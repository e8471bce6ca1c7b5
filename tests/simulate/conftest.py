"""The t-interval from exact fractions and a 40-digit quantile: no code of percept's, none of
scipy's."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from decimal import Decimal
from fractions import Fraction

import mpmath
import numpy as np
import pandas as pd
import pytest

Printer = Callable[[Iterable[str], str, tuple[str, str]], tuple[str, str]]


@functools.cache
def t_quantile(level: str, dof: int) -> mpmath.mpf:
    """The two-sided quantile, as the root of the regularised incomplete beta function."""
    with mpmath.workdps(40):
        alpha = 1 - mpmath.mpf(level)
        half = dof / mpmath.mpf(2)
        return mpmath.findroot(
            lambda t: mpmath.betainc(half, 0.5, 0, dof / (dof + t * t), regularized=True) - alpha, 3
        )


@pytest.fixture(scope="session")
def printed_limits() -> Printer:
    """Eqs 14-15 on the decimal text of the values, printed with the decimals of the limits
    given."""

    def print_like(values: Iterable[str], level: str, like: tuple[str, str]) -> tuple[str, str]:
        numbers = [Fraction(value) for value in values]
        n = len(numbers)
        mean = sum(numbers) / n
        variance = sum((x - mean) ** 2 for x in numbers) / (n - 1) / n
        with mpmath.workdps(40):
            middle = mpmath.mpf(mean.numerator) / mean.denominator
            error = mpmath.sqrt(mpmath.mpf(variance.numerator) / variance.denominator)
            half = t_quantile(level, n - 1) * error
            lower, upper = (
                str(Decimal(mpmath.nstr(limit, 30)).quantize(Decimal(text)))
                for limit, text in zip((middle - half, middle + half), like, strict=True)
            )
        return lower, upper

    return print_like


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
