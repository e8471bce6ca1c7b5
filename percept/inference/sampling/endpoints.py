"""Endpoints as roots of smooth mixtures: a posterior is normal given each draw. And what a run estimates.

The mean of normal CDFs over draws is far less noisy than an order statistic of draws: every draw
informs every endpoint.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of Q quantities."""

    names: tuple[str, ...]  # One name per estimate
    value: Array  # (Q,) Estimates
    scale: Array  # (Q,)


class Estimands(Protocol):
    """Reported quantities of a target."""

    def components(self, points: Array) -> Array:
        """Quantities kept per draw: points (W, d) to an array (W, C)."""

    def estimates(self, components: Array) -> Iterable[tuple[Estimates, Array]]:
        """Estimates from the components (S, C) of S kept draws, and their influence functions, in parts.

        These, of shape (S, Q), are the first-order pull of each draw on each estimate: their mean
        over draws is zero, and its standard error is the estimate's. Memory holds one part at a
        time.
        """


class Means:
    """Posterior means of functions of the coordinates, their scale being the posterior SD."""

    def __init__(self, names: tuple[str, ...], function: Callable[[Array], Array]) -> None:
        self._names = names
        self._function = function

    def components(self, points: Array) -> Array:
        """Values of the functions, shape (W, C)."""
        return np.asarray(self._function(points))

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Means, with deviations as influence."""
        mean = components.mean(axis=0)
        yield Estimates(self._names, mean, components.std(axis=0)), components - mean


_SQRT_2PI = math.sqrt(2.0 * math.pi)
#: Roots over more draws than `_MANY` start from the root over one draw in `_SPARSE`.
_MANY, _SPARSE = 4096, 8
#: What `root` is asked for: of few draws; of many, with smooth slopes and with the noisy ones of a
#: share; of a start. Errors are then far below the limits' Monte Carlo error.
_EXACT, _EXACT_OF_MANY, _EXACT_OF_SHARE, _EXACT_OF_START = 1e-16, 4e-6, 1e-8, 1e-3
#: Draws worked on at a time: what is made on the way stays in the processor's cache.
_BLOCK = 1024
#: Draws, or share of the draws where that is less, that must take part in a slope for it to be
#: believed.
_FEW, _FEW_SHARE = 100.0, 0.02


def mixture_quantile(mean: Array, sd: Array, tail: float, *, upper: bool) -> tuple[Array, Array]:
    """Quantile of equal-weight normal mixtures, and the pull of each component on it."""
    sign = 1.0 if upper else -1.0
    exact = _EXACT_OF_MANY if len(mean) > _MANY else _EXACT
    x, beyond, held, density = _quantile(_rows(mean) * sign, _rows(sd), tail, exact)
    beyond -= held[:, None]
    beyond *= (sign / density)[:, None]
    return sign * x, beyond.T


def _rows(draws: Array) -> Array:
    """Quantities as rows, (Q, S): loops over all draws of one are the fast ones."""
    return np.ascontiguousarray(draws.T)


def _sparse(draws: Array) -> Array:
    """Keep some of the draws of quantities (Q, S)."""
    return np.ascontiguousarray(draws[:, ::_SPARSE])


def _quantile(
    mean: Array, sd: Array, tail: float, exact: float
) -> tuple[Array, Array, Array, Array]:
    """Upper quantile, and near it each component's probability beyond, its mean, and the mean density."""
    z = -special.ndtri(tail)
    if mean.shape[1] > _MANY:
        some, sd_of_some = _sparse(mean), _sparse(sd)
        x = _quantile(some, sd_of_some, tail, _EXACT_OF_START)[0]
        spread = np.sqrt(some.var(axis=1) + (sd_of_some**2).mean(axis=1))
    else:
        spread = np.sqrt(mean.var(axis=1) + (sd * sd).mean(axis=1))
        x = mean.mean(axis=1) + z * spread
    # Arrays of all draws are written in place: making new ones takes as long as the arithmetic.
    beyond = z * sd
    beyond += mean
    # The mixture's quantile lies between the nearest and the farthest of its components'.
    low, high = beyond.min(axis=1), beyond.max(axis=1)
    held, density = np.empty_like(x), np.empty_like(x)

    def short_of_tail(x: Array) -> tuple[Array, Array]:
        held[:], density[:] = _beyond(x, mean, sd, out=beyond)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(tail / held), density / held

    x = root(short_of_tail, np.clip(x, low, high), low, high, spread, exact)
    return x, beyond, held, density


def _beyond(x: Array, mean: Array, sd: Array, *, out: Array) -> tuple[Array, Array]:
    """Probability beyond x of components (Q, S), into `out`; its mean, and the mean density at x."""
    held, density = np.zeros((2, len(x)))
    for start in range(0, mean.shape[1], _BLOCK):
        part = slice(start, start + _BLOCK)
        standard = mean[:, part] - x[:, None]
        standard /= sd[:, part]
        special.ndtr(standard, out=out[:, part])
        held += out[:, part].sum(axis=1)
        standard *= standard
        standard *= -0.5
        np.exp(standard, out=standard)
        standard /= sd[:, part]
        density += standard.sum(axis=1)
    return held / mean.shape[1], density / (_SQRT_2PI * mean.shape[1])


class _Reach:
    """d(h) with Phi(h + d) + Phi(h - d) - 1 = share for unit spread, 0 where there is none.

    Tabulated once per share: d is smooth in sqrt(h - h0), h0 its zero, and cubic Hermite pieces
    with the exact derivative d'(h) = (phi(h-d) + phi(h+d))/(phi(h-d) - phi(h+d)) leave an error of
    1e-13.
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
        # Coefficients of the pieces, from the constant on, a row for each.
        self._pieces = np.stack(
            [
                d[:-1], rates[:-1],
                3.0 * change - 2.0 * rates[:-1] - rates[1:], rates[:-1] + rates[1:] - 2.0 * change,
            ],
            axis=1,
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
        gap = h - self.zero
        np.maximum(gap, 0.0, out=gap)
        place = np.sqrt(gap)
        place *= 1.0 / self._STEP
        t = np.minimum(place, len(self._pieces) - 1.0)
        index = t.astype(np.intp)
        t -= index
        c0, c1, c2, c3 = np.moveaxis(np.take(self._pieces, index, axis=0, mode="clip"), -1, 0)
        # The cubic and its derivative: c0 + t (c1 + t (c2 + t c3)) and c1 + t (2 c2 + 3 t c3).
        c3 *= t
        slope = (1.5 * c3 + c2) * (2.0 * t) + c1
        d = ((c3 + c2) * t + c1) * t + c0
        with np.errstate(divide="ignore", invalid="ignore"):
            slope /= place * (2.0 * self._STEP**2)
        slope[gap == 0] = 0.0
        far = place >= len(self._pieces) - 1.0
        if far.any():
            d[far] = h[far] + special.ndtri(1.0 - self._share)
            slope[far] = 1.0
        return d, slope


@functools.cache
def _reach(share: float) -> _Reach:
    return _Reach(share)


def share_content(
    half_width: Array, centre: Array, mean: Array, sd: Array, spread: Array, share: float
) -> tuple[Array, Array, Array]:
    """Probability, per draw, that centre ± half_width holds the share of the population."""
    d, slope = _reach(share)(half_width / spread)
    d *= spread
    off = centre - mean
    up, down = off + d, off - d
    precision = 1.0 / sd
    up *= precision
    down *= precision
    probability = special.ndtr(up)
    probability -= special.ndtr(down)
    precision *= 1.0 / _SQRT_2PI
    for t in (up, down):
        t *= t
        t *= -0.5
        np.exp(t, out=t)
        t *= precision
    slope *= up + down
    up -= down
    return probability, slope, up


def _rate_of_draws(half_width: Array, confidence: float) -> Array:
    """Density of half-widths (Q, S) at their quantile, by a difference of quantiles.

    Where the mean is known far better than the spread a draw's probability is a step, and at a
    given half-width the steps' slopes may all underflow, or one of them be all there is.
    """
    step = 0.5 * min(confidence, 1.0 - confidence)
    low, high = np.quantile(half_width, [confidence - step, confidence + step], axis=1)
    return np.divide(2.0 * step, high - low, out=np.zeros_like(high), where=high > low)


def share_half_width(
    mean: Array, sd: Array, spread: Array, *, share: float, confidence: float
) -> tuple[Array, Array, Array]:
    """Half-width h such that centre ± h holds a share of the population with given probability."""
    exact = _EXACT_OF_SHARE if len(mean) > _MANY else _EXACT
    mean, sd, spread = _rows(mean), _rows(sd), _rows(spread)
    centre = mean.mean(axis=1)
    h, content = _half_width(centre, mean, sd, spread, share, confidence, exact)
    draws = mean.shape[1]
    rate = content.rate
    few = rate**2 * draws <= min(_FEW, _FEW_SHARE * draws) * content.square_rate
    if few.any():
        rate = np.where(few, _rate_of_draws(_least(spread, share), confidence), rate)
    # Both ends move with the centre, and apart with the half-width.
    influence = np.empty((2, *mean.shape))
    off = np.subtract(mean, centre[:, None], out=influence[0])
    pull = content.probability
    pull -= content.held[:, None]
    pull += np.multiply(content.tilt[:, None], off, out=influence[1])
    pull *= (-1.0 / rate)[:, None]
    np.add(off, pull, out=influence[1])
    off -= pull
    return centre, h, influence.reshape(-1, draws).T


def _least(spread: Array, share: float) -> Array:
    """Half-widths that hold the share about the population's own mean."""
    return np.asarray(-special.ndtri(0.5 * (1.0 - share)) * spread)


@dataclasses.dataclass(eq=False)
class _Content:
    """What S draws hold at the half-widths tried last."""

    probability: Array  # (Q, S) Of holding the share
    held: Array  # (Q,)
    rate: Array  # (Q,)
    square_rate: Array  # (Q,)
    tilt: Array  # (Q,)


def _half_width(
    centre: Array,
    mean: Array,
    sd: Array,
    spread: Array,
    share: float,
    confidence: float,
    exact: float,
) -> tuple[Array, _Content]:
    """Half-widths about given centres, and what draws (Q, S) hold near them."""
    least = _least(spread, share)
    low = least.min(axis=1)
    high = least + np.abs(mean - centre[:, None])
    high -= special.ndtri(1e-3 * (1 - confidence)) * sd
    if mean.shape[1] > _MANY:
        h, _ = _half_width(
            centre, _sparse(mean), _sparse(sd), _sparse(spread), share, confidence, _EXACT_OF_START
        )
    else:
        h = np.quantile(least, confidence, axis=1)
    aim = special.ndtri(confidence)
    nothing = np.zeros_like(h)
    content = _Content(np.empty(mean.shape), nothing, nothing, nothing, nothing)

    def short_of_confidence(log_h: Array) -> tuple[Array, Array]:
        # Half-widths are about lognormal: in log h the normal score of the probability is about
        # straight.
        h = np.exp(log_h)
        sums = np.zeros((4, len(h)))
        for start in range(0, mean.shape[1], _BLOCK):
            part = np.s_[:, start : start + _BLOCK]
            probability, slope, tilt = share_content(
                h[:, None], centre[:, None], mean[part], sd[part], spread[part], share
            )
            content.probability[part] = probability
            for total, each in zip(sums, (probability, slope, slope * slope, tilt), strict=True):
                total += each.sum(axis=1)
        content.held, content.rate, content.square_rate, content.tilt = sums / mean.shape[1]
        score = special.ndtri(content.held)
        with np.errstate(over="ignore", invalid="ignore"):
            return score - aim, content.rate * h * _SQRT_2PI * np.exp(0.5 * score * score)

    log_low, log_high = np.log(low), np.log(high.max(axis=1))
    found = root(short_of_confidence, np.log(h), log_low, log_high, np.ones_like(h), exact)
    return np.exp(found), content


_ITERATIONS = 60


def root(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
    scale: Array,
    exact: float,
) -> Array:
    """Find the roots of Q increasing functions side by side.

    Newton's method, from the second step on by the cubic through the last two places and slopes,
    taken the other way round: x as a function of the value. Its error is of the order of the
    product of the squares of the last two steps. A step that leaves the bracket is replaced by its
    middle.
    """
    x, before = start, None
    last = np.ones(x.shape)
    for _ in range(_ITERATIONS):
        value, slope = function(x)
        low = np.where(value < 0, x, low)
        high = np.where(value < 0, high, x)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            newton = x - value / slope
            cubic = newton if before is None else _cubic(*before, x, value, slope)
        fast, safe = ((place >= low) & (place <= high) for place in (cubic, newton))
        after = np.where(fast, cubic, np.where(safe, newton, 0.5 * (low + high)))
        moved = np.abs(after - x) / scale
        # Of steps that are not the cubic's nothing is known but their own length.
        if np.all(moved * np.where(fast, np.minimum(last, 1.0), 1.0) <= exact):
            return after
        before, last, x = (x, value, slope), moved, after
    return x


def _cubic(
    x0: Array, value0: Array, slope0: Array, x1: Array, value1: Array, slope1: Array
) -> Array:
    """Place of the value zero on the cubic x(value) through two places; NaN where that is far off."""
    rise = value1 - value0
    t = -value0 / rise
    back = 1.0 - t
    place = x1 + back * (
        back * (1.0 + 2.0 * t) * (x0 - x1) + rise * t * (back / slope0 - t / slope1)
    )
    return np.where(np.abs(value1) < 0.5 * np.abs(value0), place, np.nan)
