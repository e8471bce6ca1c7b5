"""Endpoints of a posterior that is normal given each draw: roots of a smooth mixture.

The mean of normal CDFs over draws is far less noisy than an order statistic of draws: every draw
informs every endpoint.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

__all__ = ["mixture_quantile", "share_content", "share_half_width"]

Array = NDArray[np.float64]
_SQRT_2PI = math.sqrt(2.0 * math.pi)
_ITERATIONS = 60
#: Newton's error is squared by the next step: after one so short the root is exact.
_LAST_STEP = 1e-8
#: Roots over more draws than `_MANY` start from the root over one draw in `_SPARSE`.
_MANY, _SPARSE = 4096, 8
#: Draws whose contents are worked out at a time: what is made on the way stays in the processor's cache.
_BLOCK = 1024
#: Draws, or share of the draws where that is less, that must take part in a slope for it to be believed.
_FEW, _FEW_SHARE = 100.0, 0.02


def mixture_quantile(mean: Array, sd: Array, tail: float, *, upper: bool) -> tuple[Array, Array]:
    """Quantile of equal-weight normal mixtures, and the pull of each component on it.

    Parameters
    ----------
    mean, sd : ndarray, shape (S, Q)
        Components of Q mixtures.
    tail : float
        Probability beyond the quantile, in (0, 1/2].
    upper : bool
        Whether it lies in the upper tail.

    Returns
    -------
    quantile : ndarray, shape (Q,)
        Quantiles, by safeguarded Newton steps on the tail probability's logarithm.
    influence : ndarray, shape (S, Q)
        -(Phi_s(q) - mean Phi(q)) / mean phi(q), to eight digits.
    """
    sign = 1.0 if upper else -1.0
    z = -special.ndtri(tail)
    towards = sign * mean
    precision = 1.0 / sd
    spread = np.sqrt(np.var(mean, axis=0) + np.mean(sd * sd, axis=0))
    # The mixture's quantile lies between the nearest and the farthest of its components'.
    reach = towards + z * sd
    low, high = reach.min(axis=0), reach.max(axis=0)
    if len(mean) > _MANY:
        x = sign * mixture_quantile(mean[::_SPARSE], sd[::_SPARSE], tail, upper=upper)[0]
    else:
        x = towards.mean(axis=0) + z * spread
    x = np.clip(x, low, high)
    # Arrays of all draws are written in place: making new ones takes as long as the arithmetic.
    standard, beyond = reach, np.empty_like(reach)
    for _ in range(_ITERATIONS):
        np.subtract(towards, x, out=standard)
        standard *= precision
        special.ndtr(standard, out=beyond)
        held, density = beyond.mean(axis=0), _mean_density(standard, precision)
        low = np.where(held > tail, x, low)
        high = np.where(held > tail, high, x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            newton = x + held / density * np.log(held / tail)
        inside = (newton >= low) & (newton <= high)
        after = np.where(inside, newton, 0.5 * (low + high))
        done = np.abs(after - x) <= _LAST_STEP * spread
        x = after
        if done.all():
            break
    beyond -= held
    beyond *= sign / density
    return sign * x, beyond


def _mean_density(standard: Array, precision: Array) -> Array:
    """Mean of normal densities at standardised places, which are overwritten."""
    standard *= standard
    standard *= -0.5
    np.exp(standard, out=standard)
    standard *= precision
    return np.asarray(standard.mean(axis=0) / _SQRT_2PI)


class _Reach:
    """d(h) with Phi(h + d) + Phi(h - d) - 1 = share for unit spread, 0 where there is none.

    Tabulated once per share: d is smooth in sqrt(h - h0), h0 its zero, and cubic Hermite pieces with
    the exact derivative d'(h) = (phi(h-d) + phi(h+d))/(phi(h-d) - phi(h+d)) leave an error of 1e-13.
    """

    _STEP = 2.0**-9

    def __init__(self, share: float) -> None:
        self.zero = -float(special.ndtri(0.5 * (1.0 - share)))
        self._share = share
        # From h0 + 9 on, Phi(h + d) is one in double precision and d = h - z_share.
        self._roots = np.arange(0.0, 3.0 + self._STEP, self._STEP)
        gap = self._roots[1:] ** 2
        d = np.concatenate([[0.0], self._solve(self.zero + gap)])
        up, down = self._densities(self.zero + gap, d[1:])
        rate = 2.0 * self._roots[1:] * (up + down) / (up - down)
        # Near h0: d² = 2 (h - h0)/h0, so d = sqrt(2/h0) root.
        rates = np.concatenate([[math.sqrt(2.0 / self.zero)], rate])
        rates *= self._STEP
        change = d[1:] - d[:-1]
        # Coefficients of the pieces, from the constant on.
        self._pieces = (
            d[:-1], rates[:-1],
            3.0 * change - 2.0 * rates[:-1] - rates[1:], rates[:-1] + rates[1:] - 2.0 * change,
        )  # fmt: skip

    def _densities(self, h: Array, d: Array) -> tuple[Array, Array]:
        return np.exp(-0.5 * (h - d) ** 2), np.exp(-0.5 * (h + d) ** 2)

    def _solve(self, h: Array) -> Array:
        gap = h - self.zero
        d = np.minimum(np.sqrt(gap * gap + 2.0 * gap / self.zero), h)
        for _ in range(40):
            error = (1.0 - self._share) - special.ndtr(d - h) - special.ndtr(-d - h)
            up, down = self._densities(h, d)
            d = np.clip(d + error * _SQRT_2PI / (up - down), 0.25 * d, 2.0 * d)
        return d

    def __call__(self, h: Array) -> tuple[Array, Array]:
        """Return d and its derivative in h."""
        gap = np.maximum(h - self.zero, 0.0)
        root = np.sqrt(gap)
        place = np.minimum(root, 3.0 - self._STEP) / self._STEP
        index = place.astype(np.intp)
        t = place - index
        value, rate, a, b = (coefficient[index] for coefficient in self._pieces)
        d = value + t * (rate + t * (a + t * b))
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (rate + t * (2.0 * a + 3.0 * t * b)) / (2.0 * root * self._STEP)
        far = root >= 3.0 - self._STEP
        d = np.where(far, h + special.ndtri(1.0 - self._share), d)
        return d, np.where(gap == 0, 0.0, np.where(far, 1.0, slope))


@functools.cache
def _reach(share: float) -> _Reach:
    return _Reach(share)


def share_content(
    half_width: Array, centre: Array, mean: Array, sd: Array, spread: Array, share: float
) -> tuple[Array, Array, Array]:
    """Probability, per draw, that centre ± half_width holds the share of the population.

    Parameters
    ----------
    half_width, centre : ndarray, shape (Q,)
        The intervals.
    mean, sd : ndarray, shape (S, Q)
        Conditional mean and SD of the population's mean.
    spread : ndarray, shape (S, Q)
        SD of the population.
    share : float
        Share P.

    Returns
    -------
    probability, by_half_width, by_centre : ndarray, shape (S, Q)
        The probability and its derivatives in half-width and centre.
    """
    d, slope = _reach(share)(half_width / spread)
    up, down = (centre + d * spread - mean) / sd, (centre - d * spread - mean) / sd
    probability = special.ndtr(up) - special.ndtr(down)
    phi_up, phi_down = (np.exp(-0.5 * t * t) / (_SQRT_2PI * sd) for t in (up, down))
    return probability, (phi_up + phi_down) * slope, phi_up - phi_down


def _rate_of_draws(half_width: Array, confidence: float) -> Array:
    """Density of half-widths (S, Q) at their quantile, by a difference of quantiles.

    Where the mean is known far better than the spread a draw's probability is a step, and at a given
    half-width the steps' slopes may all underflow, or one of them be all there is.
    """
    step = 0.5 * min(confidence, 1.0 - confidence)
    low, high = np.quantile(half_width, [confidence - step, confidence + step], axis=0)
    return np.divide(2.0 * step, high - low, out=np.zeros_like(high), where=high > low)


def share_half_width(
    mean: Array, sd: Array, spread: Array, *, share: float, confidence: float
) -> tuple[Array, Array, Array]:
    """Half-width h such that centre ± h holds a share of the population with given probability.

    Parameters
    ----------
    mean, sd, spread : ndarray, shape (S, Q)
        Conditional mean and SD of the population's mean, and the population's SD.
    share, confidence : float
        Share P and probability gamma.

    Returns
    -------
    centre, half_width : ndarray, shape (Q,)
        Posterior mean and h, the gamma-quantile of the half-width that P needs.
    influence : ndarray, shape (S, 2Q)
        Pull of each draw on centre - h and on centre + h.
    """
    centre = mean.mean(axis=0)
    least = -special.ndtri(0.5 * (1.0 - share)) * spread
    low = least.min(axis=0)
    high = np.max(
        least + np.abs(mean - centre) - special.ndtri(1e-3 * (1 - confidence)) * sd,
        axis=0,
    )
    if len(mean) > _MANY:
        few = (mean[::_SPARSE], sd[::_SPARSE], spread[::_SPARSE])
        h = share_half_width(*few, share=share, confidence=confidence)[1]
    else:
        h = np.quantile(least, confidence, axis=0)
    aim = special.ndtri(confidence)
    probability, slope, tilt = np.empty((3, *mean.shape))
    for _ in range(_ITERATIONS):
        for start in range(0, len(mean), _BLOCK):
            part = slice(start, start + _BLOCK)
            probability[part], slope[part], tilt[part] = share_content(
                h, centre, mean[part], sd[part], spread[part], share
            )
        held, rate = probability.mean(axis=0), slope.mean(axis=0)
        low = np.where(held < confidence, h, low)
        high = np.where(held < confidence, high, h)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # Half-widths are about lognormal: in log h the normal score of the probability is about straight.
            score = special.ndtri(held)
            newton = h * np.exp((aim - score) * np.exp(-0.5 * score * score) / (_SQRT_2PI * rate * h))
        inside = (newton >= low) & (newton <= high)
        after = np.where(inside, newton, 0.5 * (low + high))
        done = np.abs(after - h) <= _LAST_STEP * h
        h = after
        if done.all():
            break
    off = mean - centre
    rate = slope.mean(axis=0)
    enough = min(_FEW, _FEW_SHARE * len(mean))
    few = slope.sum(axis=0) ** 2 <= enough * (slope**2).sum(axis=0)
    if few.any():
        rate = np.where(few, _rate_of_draws(least, confidence), rate)
    pull = -(probability - probability.mean(axis=0) + tilt.mean(axis=0) * off) / rate
    return centre, h, np.concatenate([off - pull, off + pull], axis=1)
