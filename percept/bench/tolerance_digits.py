"""Digits the tolerance factors keep, against their integral in thirty digits."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy import integrate, optimize, stats

from percept.inference import tolerance_factor
from percept.inference.classical.levels import OneMinus

# mpmath numbers have no types.
Number: TypeAlias = Any

_DIGITS = 30
_REACH = 8.0  # standard errors of the mean that are integrated over in doubles
#: Subjects, 1 - share and 1 - confidence.
CASES: tuple[tuple[int, float, float], ...] = (
    *((n, 0.01, 0.05) for n in (2, 3, 10, 100, 1000)),
    *((10, outside, 0.05) for outside in (0.5, 1e-4, 1e-9)),
    *((10, 0.01, doubt) for doubt in (0.5, 1e-4, 1e-9)),
)


@dataclass(frozen=True)
class ToleranceDigits:
    """Digits kept of one factor."""

    n: int  # Subjects
    outside: float
    doubt: float
    factor: float  # percept's
    ours: float
    direct: float


def tolerance_digits(cases: tuple[tuple[int, float, float], ...] = CASES) -> list[ToleranceDigits]:
    """Compare two-sided factors with 30-digit arithmetic. Needs mpmath."""
    rows = []
    for n, outside, doubt in cases:
        factor = float(tolerance_factor(n, OneMinus(outside), OneMinus(doubt)))
        exact = _exact(n, outside, doubt, factor)
        direct = _digits(_direct(n, outside, doubt), exact)
        rows.append(ToleranceDigits(n, outside, doubt, factor, _digits(factor, exact), direct))
    return rows


def _exact(n: int, outside: float, doubt: float, near: float) -> Number:
    """One secant step from a factor that is nearly right: its own error is squared by it."""
    import mpmath

    with mpmath.workdps(_DIGITS):
        first = mpmath.mpf(near)
        second = first * (1 + mpmath.mpf("1e-9"))
        short, shorter = (_shortfall(n, outside, c) - mpmath.mpf(doubt) for c in (first, second))
        return first - short * (second - first) / (shorter - short)


def _shortfall(n: int, outside: float, c: Number) -> Number:
    """Probability that mean ± c SD holds less than the share: the mean integrated out in mpmath."""
    import mpmath

    half = mpmath.mpf(n - 1) / 2

    def given(x: Number) -> Number:
        """Density of the mean's distance times the probability of too small an SD."""
        r = _radius(x, mpmath.mpf(outside))
        below = mpmath.gammainc(half, 0, half * r * r / (c * c), regularized=True)
        return 2 * mpmath.sqrt(n / (2 * mpmath.pi)) * mpmath.exp(-n * x * x / 2) * below

    ends = [mpmath.mpf(k) / mpmath.sqrt(n) for k in (0, 1, 2, 4, 8, 12)]
    return mpmath.quad(given, ends)


def _radius(x: Number, outside: Number) -> Number:
    """Solve Q(r + x) + Q(r - x) = outside, Q the upper tail, by Newton on its logarithm."""
    import mpmath

    def upper(z: Number) -> Number:
        return mpmath.erfc(z / mpmath.sqrt(2)) / 2

    r = mpmath.mpf(float(x) + stats.norm.isf(float(outside) / 2))
    for _ in range(60):
        held_out = upper(r + x) + upper(r - x)
        step = mpmath.log(held_out / outside) * held_out / (mpmath.npdf(r + x) + mpmath.npdf(r - x))
        r += step
        if abs(step) < mpmath.mpf(10) ** (4 - _DIGITS) * r:
            break
    return r


def _direct(n: int, outside: float, doubt: float) -> float:
    share, confidence, freedom = 1.0 - outside, 1.0 - doubt, n - 1

    def content(r: float, x: float) -> float:
        return float(stats.norm.cdf(x + r) - stats.norm.cdf(x - r)) - share

    def enough(c: float) -> float:
        def given(x: float) -> float:
            r = optimize.brentq(content, 0.0, x + 40.0, args=(x,))
            return float(
                2.0
                * stats.norm.pdf(x, scale=1.0 / np.sqrt(n))
                * stats.chi2.sf(freedom * (r / c) ** 2, freedom)
            )

        return float(integrate.quad(given, 0.0, _REACH / np.sqrt(n), limit=200)[0]) - confidence

    with warnings.catch_warnings():
        # The quadrature says itself that it reached less than asked; the digits say how much less.
        warnings.simplefilter("ignore", integrate.IntegrationWarning)
        try:
            return float(optimize.brentq(enough, 0.1, 1e4, xtol=1e-14, rtol=1e-14))
        except ValueError:
            return math.nan


def _digits(computed: float, exact: Number) -> float:
    error = float(abs(computed - exact) / exact)
    return 0.0 if math.isnan(error) else min(16.0, max(0.0, -math.log10(max(error, 1e-300))))
