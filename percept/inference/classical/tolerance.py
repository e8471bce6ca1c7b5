"""How many standard deviations hold a stated share of a normal population, with stated confidence.

Two-sided, the factor c solves, with ν = n − 1 and Φ(x + r) − Φ(x − r) = P defining r(x),

    ∫₀^∞ P(χ²_ν < ν r(x)²/c²) · 2 √(n/2π) exp(−n x²/2) dx = 1 − γ.

The left side is the chance that the interval holds too little. Writing it through the lower tail of χ² makes
it a sum of positive terms as small as 1 − γ itself, so nothing cancels however close γ is to one; P enters
through its tail 1 − P likewise. One-sided, the same is done with one limit, which gives the quantile of the
noncentral t to all digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from percept.errors import UsageError
from percept.inference.classical.checks import fitted, subject_counts
from percept.inference.classical.levels import OneMinus, tail
from percept.inference.classical.moments import plain
from percept.inference.classical.quantiles import normal_upper
from percept.inference.classical.shortfall import (
    NEWTON_STEPS,
    least_spread,
    normal_nodes,
    one_limit_factor,
    reach_of,
    solve_factor,
)
from percept.inference.intervals import FloatOrArray

_BLOCK = 512  # requests handled at once
_TABLE = 1 << 16  # whole numbers this close together are looked up

Array: TypeAlias = NDArray[np.float64]


def tolerance_factor(
    n: ArrayLike,
    share: ArrayLike | OneMinus,
    confidence: ArrayLike | OneMinus,
    *,
    sided: Literal["two", "one"] = "two",
) -> FloatOrArray:
    """Work out the exact factor of a normal tolerance interval.

    Mean ± factor·SD holds at least `share` of the population with `confidence`; one-sided, so does everything
    below mean + factor·SD (or above mean − factor·SD). Repeated requests are worked out once.

    Parameters
    ----------
    n : int or array_like of int
        Subjects, at least 2.
    share : float, array_like or OneMinus
        Share P of the population; 0 to 1, exclusive.
    confidence : float, array_like or OneMinus
        Confidence γ; 0 to 1, exclusive.
    sided : {"two", "one"}
        Whether both limits are set together or only one.

    Returns
    -------
    float or ndarray
        Broadcast shape; a float where every argument is a single number.

    Raises
    ------
    UsageError
        A share or confidence outside (0, 1), or so close to 1 that the factor is lost to doubles; an n that
        is not whole, shapes that do not fit.
    RefusalError
        Fewer than 2 subjects.

    References
    ----------
    ISO 16269-6:2014; Krishnamoorthy and Mathew, Statistical Tolerance Regions, sections 2.2 and 2.3.
    """
    if sided not in ("two", "one"):
        raise UsageError('sided must be "two" or "one".', value=sided)
    return _per_distinct(_two_sided if sided == "two" else _one_sided, n, share, confidence)


def howe_factor(n: ArrayLike, share: ArrayLike | OneMinus, confidence: ArrayLike | OneMinus) -> FloatOrArray:
    """Work out Howe's approximation to the two-sided factor, as the NIST handbook prints it.

    For comparison with published work that used it: at n = 43, P = .90, γ = .99 it gives 2.2173 where the
    exact factor is 2.2228. Use `tolerance_factor` for anything else.

    Parameters
    ----------
    n, share, confidence
        As `tolerance_factor`.

    Returns
    -------
    float or ndarray
        z_{(1+P)/2} √(ν (1 + 1/n) / χ²_{ν, 1−γ}).

    Raises
    ------
    UsageError, RefusalError
        As `tolerance_factor`.

    References
    ----------
    Howe, "Two-sided tolerance limits for normal populations", JASA 64 (1969).
    """

    def factor(count: Array, outside: Array, doubt: Array) -> Array:
        return normal_upper(outside / 2.0) * np.sqrt(1.0 + 1.0 / count) / least_spread(count, doubt)

    return _per_distinct(factor, n, share, confidence)


def _per_distinct(
    factor: Callable[[Array, Array, Array], Array],
    n: ArrayLike,
    share: ArrayLike | OneMinus,
    confidence: ArrayLike | OneMinus,
) -> FloatOrArray:
    asked = subject_counts(n), tail(share, "share"), tail(confidence, "confidence")
    requests = fitted("n, share and confidence", *asked)
    # one whole number per combination of n, share and confidence, from 0 up without gaps
    code = np.zeros(requests[0].shape, dtype=np.int64)
    for part in asked:
        if part.size > 1:
            index = _ranks(part)
            code = _ranks(code * (index.max() + 1) + index)
    of_code = np.empty(code.max() + 1, dtype=np.int64)
    of_code[code.reshape(-1)] = np.arange(code.size)  # any one of the requests that are alike
    distinct = np.stack([part.reshape(-1)[of_code] for part in requests])
    blocks = [distinct[:, start : start + _BLOCK] for start in range(0, distinct.shape[1], _BLOCK)]
    with np.errstate(all="ignore"):
        factors = np.concatenate([factor(*block) for block in blocks])
    if not np.isfinite(factors).all():
        at = int(np.argmin(np.isfinite(factors)))
        raise UsageError(
            "no factor can be worked out in double precision.",
            value=f"n = {distinct[0, at]:g}, 1 - share = {distinct[1, at]:g}, "
            f"1 - confidence = {distinct[2, at]:g}",
            hint="Ask for a share or confidence less close to 1.",
        )
    return plain(factors[code])


def _ranks(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return the rank of each value among the distinct ones; whole numbers close together need no sorting."""
    if values.dtype.kind == "i":
        least = values.min()
        span = int(values.max() - least) + 1
        if span <= max(_TABLE, values.size):
            present = np.zeros(span, dtype=np.int64)
            present[values.reshape(-1) - least] = 1
            return (np.cumsum(present) - 1)[values - least]
    return np.unique(values, return_inverse=True)[1].reshape(values.shape)


def _two_sided(n: Array, outside: Array, doubt: Array) -> Array:
    reach = _content_radius(normal_upper(doubt / 4.0)[:, None] / np.sqrt(n)[:, None], outside)[:, 0]
    # more than enough: too little is held only if the mean is off by more, or the SD falls below, its bound
    start = reach / least_spread(n, doubt / 2.0)
    z, weight = normal_nodes(np.zeros_like(n), reach_of(doubt))
    radius = _content_radius(z / np.sqrt(n)[:, None], outside)
    return solve_factor(radius, 2.0 * weight, n, doubt, start)


def _one_sided(n: Array, outside: Array, doubt: Array) -> Array:
    offset = np.sqrt(n) * normal_upper(outside)
    # the factor is negative where even the mean is beyond the quantile more surely than asked
    mirrored = special.ndtr(offset) < doubt
    factors = np.zeros_like(n)
    for flip in (False, True):
        chosen = (mirrored == flip) & (special.ndtr(offset) != doubt)
        if chosen.any():
            doubtful = 1.0 - doubt[chosen] if flip else doubt[chosen]
            distance = -offset[chosen] if flip else offset[chosen]
            found = one_limit_factor(n[chosen], distance, doubtful)
            factors[chosen] = -found if flip else found
    return factors


def _content_radius(x: Array, outside: Array) -> Array:
    """Solve Q(r + x) + Q(r − x) = outside for r, Q the upper normal tail; `x` has a row per `outside`.

    Newton on the logarithm, from above: exact at x = 0, and too large elsewhere.
    """
    target = outside[:, None]
    r = x + normal_upper(target / 2.0)
    for _ in range(NEWTON_STEPS):
        held_out = special.ndtr(-(r + x)) + special.ndtr(x - r)
        density = (np.exp(-0.5 * (r + x) ** 2) + np.exp(-0.5 * (r - x) ** 2)) / np.sqrt(2.0 * np.pi)
        step = np.log(held_out / target) * held_out / density
        r = r + step
        if (np.abs(step) <= 4e-16 * r).all():
            break
    return r
