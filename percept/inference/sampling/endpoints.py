"""Limits of posterior intervals as roots of smooth mixtures.

Given draw s of the scales, a cell's mean is N(m_s, v_s²), and so is the next user's value with
larger v_s. The posterior is the mixture of these normals over S draws, so a limit solves

    mean over s of Phi((m_s - x) / v_s) = tail                       `mixture_limits`

A share interval c ± h is to hold a share P of the population, with a stated confidence. Given a
draw the population is normal with SD w_s about a mean that is N(m_s, v_s²). The interval holds P if
that mean lies within a distance d of c, which depends on h / w_s alone (`_Reach`). So h solves

    mean over s of Phi((c + d - m_s) / v_s) - Phi((c - d - m_s) / v_s) = confidence
                                                                      `share_half_width`

Every draw informs every limit, so that a limit is far less noisy than an order statistic of draws.
The influence of a draw is the derivative of the limit in the draw's weight: by the implicit
function theorem its own residual in the equation over the equation's slope. Monte Carlo errors are
worked out from the influences.

Every step of a search goes over all draws (Q quantities by S draws). What it computes is therefore
computed in blocks of draws and written in place.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.searches import root

Array = NDArray[np.float64]

_SQRT_2PI = math.sqrt(2.0 * math.pi)
#: Largest product of the last two steps of `root`, whose error is about the product's square. Steps
#: to a mixture's quantile are in its SDs, those to a half-width in its logarithm. The slope of a
#: share of many draws is noisy, so that its error falls no faster than the product: 1e-7 of a
#: half-width is far below the Monte Carlo error.
_STEP_PRODUCT = 1e-7
#: Draws worked on at a time: with some ten quantities their temporaries, 80 kB each, stay in the
#: processor's cache.
_BLOCK = 1024
#: Effective draws that must carry a slope for it to be believed: with these its error is a tenth.
_FEWEST_CARRYING = 100.0
#: Or, where there are fewer than 5,000 draws, this fraction of them.
_FRACTION_CARRYING = 0.02
#: Of the probability that the interval may fail with, the fraction left out beyond the bracket of a
#: share's half-width: at the bracket's end even the worst draw fails a thousand times less often.
_BRACKET_TAIL = 1e-3


def batch_errors(values: NDArray[Any], batch: NDArray[np.intp]) -> Array:
    """Return standard errors of the means of values, from the scatter of batches of draws.

    What is slow to mix errs by more than as many independent draws would. Batches of walkers are
    independent.

    Parameters
    ----------
    values : ndarray, shape (S, Q)
        Q values of each of S draws.
    batch : ndarray of int, shape (S,)
        Number of each draw's batch, from 0.

    Returns
    -------
    ndarray, shape (Q,)
    """
    sizes = np.bincount(batch)
    means = [np.bincount(batch, column) / sizes for column in values.T]
    return np.asarray(np.std(means, axis=1, ddof=1) / math.sqrt(len(sizes)))


def mixture_limits(
    mean: Array,
    sd: Array,
    tail: float,
    weights: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Lower and upper limits of normal mixtures, and the pull of each component on them.

    Parameters
    ----------
    mean, sd : ndarray
        Components, shape (S, Q): S draws of Q quantities, in any unit.
    tail : float
        Probability beyond each limit.
    weights : ndarray, optional
        Of the draws, shape (S,), with a sum of one; equal where not given.

    Returns
    -------
    lower, upper : ndarray
        Shape (Q,), in the same unit.
    influence : ndarray
        Shape (S, 2 Q): derivative of all lower limits, then of all upper ones, in the weight of a
        draw.
    """
    if weights is None:
        weights = np.full(len(mean), 1.0 / len(mean))
    limits = []
    influences = []
    # The lower limit is the upper one of what is mirrored.
    for sign in (-1.0, 1.0):
        mixture = _Mixture(_as_rows(mean) * sign, _as_rows(sd), weights)
        limits.append(sign * mixture.upper_quantile(tail))
        residual = mixture.beyond - mixture.mean_beyond[:, None]
        influence = residual * (sign / mixture.density)[:, None]
        influences.append(influence.T)
    lower, upper = limits
    return lower, upper, np.hstack(influences)


def _as_rows(draws: Array) -> Array:
    """Quantities as rows, (Q, S): loops over all draws of one are the fast ones."""
    return np.ascontiguousarray(draws.T)


@dataclass(eq=False)
class _Mixture:
    """Mixtures of normal laws, and their probabilities at the last x evaluated.

    `root` returns a point one step past the last x, and influences are taken at that x. The step is
    about or below the square root of the step product, 0.0003 SDs. Influences only give Monte Carlo
    errors, which so change by less than 1 %, far below their own uncertainty.
    """

    mean: Array  # (Q, S)
    sd: Array  # (Q, S)
    weights: Array  # (S,)

    def __post_init__(self) -> None:
        self.beyond = np.empty_like(self.mean)  # (Q, S) Each component's probability beyond x
        self.mean_beyond = np.empty(len(self.mean))  # (Q,) The mixture's probability beyond x
        self.density = np.empty(len(self.mean))  # (Q,) The mixture's density at x

    def upper_quantile(self, tail: float) -> Array:
        """Find x (Q,) with the stated probability beyond it."""
        z = -special.ndtri(tail)
        centre = self.mean @ self.weights
        deviation = self.mean - centre[:, None]
        spread = np.sqrt((deviation**2 + self.sd**2) @ self.weights)
        # The mixture's quantile lies between the nearest and the farthest of its components'.
        component_quantiles = self.sd * z
        component_quantiles += self.mean
        low = component_quantiles.min(axis=1)
        high = component_quantiles.max(axis=1)
        start = np.clip(centre + z * spread, low, high)
        shortfall = functools.partial(self._log_shortfall, tail=tail)
        return root(shortfall, start, low, high, spread, _STEP_PRODUCT)

    def _log_shortfall(self, x: Array, *, tail: float) -> tuple[Array, Array]:
        """Log of the wanted tail over the one beyond x (Q,), and its slope.

        The logarithm of a normal tail is closer to a straight line than the tail.
        """
        self._evaluate(x)
        with np.errstate(divide="ignore", invalid="ignore"):
            shortfall = np.log(tail / self.mean_beyond)
            slope = self.density / self.mean_beyond
        return shortfall, slope

    def _evaluate(self, x: Array) -> None:
        """Work out the probabilities beyond x (Q,), and the density there, block by block."""
        draws = self.mean.shape[1]
        self.mean_beyond[:] = 0.0
        self.density[:] = 0.0
        for start in range(0, draws, _BLOCK):
            block = np.s_[:, start : start + _BLOCK]
            sd = self.sd[block]
            standard = self.mean[block] - x[:, None]
            standard /= sd
            beyond = special.ndtr(standard, out=self.beyond[block])
            weights = self.weights[start : start + _BLOCK]
            self.mean_beyond += beyond @ weights
            density = _normal_density(standard)
            density /= sd
            self.density += density @ weights
        self.density /= _SQRT_2PI


def _normal_density(standard: Array) -> Array:
    """Turn standardised values into their normal density times sqrt(2 pi), in place."""
    standard *= standard
    standard *= -0.5
    return np.exp(standard, out=standard)


class _Reach:
    """Distance d that a population's mean may lie off while ±h about zero holds a share of it.

    For unit spread d solves Phi(h + d) + Phi(h - d) - 1 = share: h² is the quantile of a noncentral
    chi-square with d² as its noncentrality. Below h0, which holds the share at d = 0, there is no
    such distance. As d is smooth in sqrt(h - h0), it is tabulated there.
    """

    #: Step of the table in sqrt(h - h0). With 512 pieces per unit the error is below 1e-12; a power
    #: of two, so that finding the piece rounds nothing.
    _STEP = 2.0**-9
    #: Last sqrt(h - h0) of the table: beyond it the far tail is nothing next to the near one, and d
    #: is linear in h.
    _LAST_SQRT = 3.0

    def __init__(self, share: float) -> None:
        self.least = -float(special.ndtri(0.5 * (1.0 - share)))  # h0
        self._one_tail = special.ndtri(1.0 - share)
        knots = np.arange(0.0, self._LAST_SQRT + self._STEP, self._STEP)  # of sqrt(h - h0)
        h = self.least + knots[1:] ** 2
        d = np.sqrt(special.chndtrinc(h**2, 1.0, share))
        # Differentiate the equation of d above: both densities carry h, and d with opposite signs.
        near = _normal_density(h - d)
        far = _normal_density(h + d)
        by_h = (near + far) / (near - far)
        by_sqrt = 2.0 * knots[1:] * by_h
        first = math.sqrt(2.0 / self.least)  # near h0: d² = 2 (h - h0)/h0
        values = np.r_[0.0, d]
        slopes = np.r_[first, by_sqrt] * self._STEP
        rise = np.diff(values)
        bend = slopes[1:] - rise
        sag = rise - slopes[:-1]
        # (pieces, 4) c3 to c0, of t in [0, 1]. SciPy's splines take a twentieth of a fit to import.
        self._pieces = np.stack([bend - sag, 2.0 * sag - bend, slopes[:-1], values[:-1]], axis=1)

    def __call__(self, h: Array) -> tuple[Array, Array]:
        """Return d and its derivative in h, zero where there is none."""
        excess = np.maximum(h - self.least, 0.0)
        sqrt_excess = np.sqrt(excess)
        # Knots are evenly spaced, so that no piece is searched for.
        position = sqrt_excess / self._STEP
        last = len(self._pieces) - 1.0
        piece = np.minimum(position, last).astype(np.intp)
        # No piece is out of range: "clip" spares the check for that.
        coefficients = np.take(self._pieces, piece, axis=0, mode="clip")
        c3, c2, c1, c0 = np.moveaxis(coefficients, -1, 0)
        t = position - piece
        # d = c3 t³ + c2 t² + c1 t + c0, whose slope in t is 3 c3 t² + 2 c2 t + c1.
        c3_t = c3 * t
        slope = (1.5 * c3_t + c2) * (2.0 * t) + c1
        d = ((c3_t + c2) * t + c1) * t + c0
        # The slope in h: a unit of t is a step of sqrt(h - h0).
        with np.errstate(divide="ignore", invalid="ignore"):
            slope /= (2.0 * self._STEP) * sqrt_excess
        slope[sqrt_excess == 0.0] = 0.0
        beyond = sqrt_excess > self._LAST_SQRT
        if beyond.any():
            d[beyond] = h[beyond] + self._one_tail
            slope[beyond] = 1.0
        return d, slope


_reach = functools.cache(_Reach)


def share_content(
    half_width: Array,
    centre: Array,
    mean: Array,
    sd: Array,
    spread: Array,
    share: float,
) -> tuple[Array, Array, Array]:
    """Probability, per draw, that centre ± half_width holds the share of the population.

    Given a draw the population is normal with SD `spread` about a mean that is N(mean, sd²).
    Returned are also the derivatives in the half-width and in the centre, all (Q, S).
    """
    d, by_half_width = _reach(share)(half_width / spread)
    distance = d * spread
    offset = centre - mean
    precision = 1.0 / sd
    # The interval holds the share if the population's mean lies within `distance` of its centre.
    upper = (offset + distance) * precision
    lower = (offset - distance) * precision
    probability = special.ndtr(upper) - special.ndtr(lower)
    peak_density = precision * (1.0 / _SQRT_2PI)
    upper_density = _normal_density(upper) * peak_density
    lower_density = _normal_density(lower) * peak_density
    by_half_width *= upper_density + lower_density
    return probability, by_half_width, upper_density - lower_density


def share_half_width(
    mean: Array,
    sd: Array,
    spread: Array,
    *,
    share: float,
    confidence: float,
) -> tuple[Array, Array, Array]:
    """Half-width h such that centre ± h holds a share of the population with given probability.

    Parameters
    ----------
    mean, sd : ndarray
        Law of the population's mean given each draw, shape (S, Q).
    spread : ndarray
        SD of the population about its mean given each draw, shape (S, Q).
    share : float
        Share of the population.
    confidence : float
        Probability of holding it.

    Returns
    -------
    centre, half_width : ndarray
        Shape (Q,), in the unit of `mean`.
    influence : ndarray
        Shape (S, 2 Q): of all lower limits, then of all upper ones.
    """
    mean = _as_rows(mean)
    spread = _as_rows(spread)
    centre = mean.mean(axis=1)
    draws = mean.shape[1]
    content = _MeanContent(share, centre, mean, _as_rows(sd), spread)
    half_width = content.half_width(confidence)
    mean_probability, slope, square_slope, by_centre = content.means
    # (sum of slopes)² over the sum of their squares counts the draws that carry the slope.
    enough = min(_FEWEST_CARRYING, _FRACTION_CARRYING * draws)
    uncertain = slope**2 * draws <= enough * square_slope
    if uncertain.any():
        least = _reach(share).least * spread
        differenced = _density_of_half_widths(least, confidence)
        slope = np.where(uncertain, differenced, slope)
    # A draw that weighs more moves the centre by its own offset. The half-width h then follows, so
    # that the mean probability stays the confidence:
    # (probability - its mean) + by_centre * (influence on centre) + slope * (influence on h) = 0.
    on_centre = mean - centre[:, None]
    residual = content.probability - mean_probability[:, None]
    residual += by_centre[:, None] * on_centre
    on_half_width = residual * (-1.0 / slope)[:, None]
    lower = on_centre - on_half_width
    upper = on_centre + on_half_width
    return centre, half_width, np.concatenate([lower, upper]).T


def _density_of_half_widths(half_width: Array, confidence: float) -> Array:
    """Density of half-widths (Q, S) at their quantile, by a difference of quantiles.

    Where the mean is known far better than the spread, a draw's probability is a step function of
    the half-width, from 0 to 1 at the draw's own. The slopes at a given half-width may then all
    underflow, or a single slope may dominate.
    """
    step = 0.5 * min(confidence, 1.0 - confidence)
    low = np.quantile(half_width, confidence - step, axis=1)
    high = np.quantile(half_width, confidence + step, axis=1)
    nothing = np.zeros_like(high)
    return np.divide(2.0 * step, high - low, out=nothing, where=high > low)


@dataclass(eq=False)
class _MeanContent:
    """Mean over draws of the probability of holding a share, at the last half-widths evaluated."""

    share: float
    centre: Array  # (Q,)
    mean: Array  # (Q, S)
    sd: Array  # (Q, S)
    spread: Array  # (Q, S)

    def __post_init__(self) -> None:
        self.probability = np.empty_like(self.mean)  # (Q, S) Of each draw
        #: (4, Q) Probabilities, slopes in the half-width and their squares, slopes in the centre
        self.means = np.empty((4, len(self.centre)))

    def half_width(self, confidence: float) -> Array:
        """Find the half-widths (Q,) at which the mean probability is the confidence."""
        least = _reach(self.share).least * self.spread
        low = least.min(axis=1)
        offset = self.mean - self.centre[:, None]
        high = least + np.abs(offset)
        score = special.ndtri(_BRACKET_TAIL * (1.0 - confidence))
        high -= score * self.sd
        start = np.quantile(least, confidence, axis=1)
        log_half_width = root(
            functools.partial(self._score_excess, wanted=special.ndtri(confidence)),
            np.log(start),
            np.log(low),
            np.log(high.max(axis=1)),
            np.ones_like(start),
            _STEP_PRODUCT,
        )
        return np.exp(log_half_width)

    def _score_excess(self, log_half_width: Array, *, wanted: float) -> tuple[Array, Array]:
        """Return the normal score of the probability less the wanted one, and its slope.

        Half-widths are about lognormal: in log h the score is about straight.
        """
        half_width = np.exp(log_half_width)
        self._evaluate(half_width)
        mean_probability, mean_slope, *_ = self.means
        score = special.ndtri(mean_probability)
        with np.errstate(over="ignore", invalid="ignore"):
            inverse_density = np.exp(0.5 * score * score)
            slope = mean_slope * half_width * _SQRT_2PI * inverse_density
        return score - wanted, slope

    def _evaluate(self, half_width: Array) -> None:
        """Work out probabilities and derivatives at half-widths (Q,), block by block."""
        draws = self.mean.shape[1]
        centre = self.centre[:, None]
        half_width = half_width[:, None]
        sums = np.zeros_like(self.means)
        for start in range(0, draws, _BLOCK):
            block = np.s_[:, start : start + _BLOCK]
            mean = self.mean[block]
            sd = self.sd[block]
            spread = self.spread[block]
            probability, slope, by_centre = share_content(
                half_width, centre, mean, sd, spread, self.share
            )
            self.probability[block] = probability
            sums[0] += probability.sum(axis=1)
            sums[1] += slope.sum(axis=1)
            slope *= slope
            sums[2] += slope.sum(axis=1)
            sums[3] += by_centre.sum(axis=1)
        self.means = sums / draws
