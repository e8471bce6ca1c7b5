"""A fitted change of coordinates that makes a sample look standard normal.

Three layers lead from standard coordinates z over y to the target's x:

    drivers, one after another    y_i = m_i(f) + exp(s_i(f)) z_i
    all others, together          y_j = m_j(f) + exp(s_j(f)) (L z)_j
    each coordinate by itself     x_i = S_i(y_i)

A driver is one of the few coordinates whose value widens others or bends their mean. The features f
are 1 and, of every driver d that comes before, y_d and y_d² - 1. Means m and log scales s are
linear in f, and s leaves the squares out. L is a lower factor of the others' covariance, and S_i an
increasing spline. The log Jacobian is the sum of all s, of log diag(L) and of log S_i'.

The map assumes nothing of the target but a sample, and any such map is exact: a poor fit costs
steps of the sampler, not accuracy. Walkers live at z, so that only this direction is ever needed.

A fit goes the other way. The sample's normal scores stand for y. `_find_drivers` chooses drivers by
third moments, `_regress` fits m and s, and `_factor` fits L. All three keep only what stands out of
chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Most drivers: they are mapped one after another, all others at once, which is faster.
_MOST_DRIVERS = 6
#: Standard errors that a bend or a widening must have to be believed. Chance passes one in 3,000
#: pairs of coordinates, and one in 16,000 coefficients.
_SIGNIFICANT = 4.0
#: Standard errors within which a correlation may count as none. Chance leaves six once in 500
#: million pairs: no sample needs a higher level.
_NOISE_LEVELS = np.arange(2.0, 6.5, 0.5)
#: Largest fraction of the correlations kept that may be chance: most are real then.
_MOST_BY_CHANCE = 0.5
#: Relative difference below which two effects are equal but for rounding.
_EQUAL = 1e-9
#: Steps of the fit of log scales: Newton's method has settled by then.
_LOG_SCALE_STEPS = 5
#: Most that a coefficient of a log scale changes in one step: a sample in a few clumps would send
#: the first step far.
_LONGEST_STEP = 0.5
#: Correlations that have no factor are multiplied by this until they have one: each was shrunk by
#: itself, and together they may fit no joint law.
_SHRINKAGE = 0.9
#: SDs beyond which a driver's effect stays what it is: few draws lie there to fit it by.
_CLIP = 3.0
#: Last knot, in SDs: quantiles beyond it are single draws.
_REACH = 3.0
#: Knots per SD, a power of two: finding the piece rounds nothing.
_PER_UNIT = 2
_KNOTS = np.arange(-_REACH * _PER_UNIT, _REACH * _PER_UNIT + 1) / _PER_UNIT
#: Outside the knots the map goes on with this multiple of the last piece's rise, and bends away by
#: _BEND times that rise: few draws lie there, and a map too wide costs little.
_WIDER = 1.5
_BEND = 1.0
#: Knots that straight lines follow, in SDs: their quantiles err least.
_MIDDLE = 1.5
#: Mean square of departures from the line, in standard errors, that is believed in full.
_SETTLED = 4.0
#: Least rise of a piece, as a fraction of the sample's range: tied quantiles would make it flat.
_LEAST_RISE = 1e-6
#: Least rise where all values are one: a rise of zero has no logarithm.
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic pieces between evenly spaced knots, one function per coordinate.

    It takes the normal quantiles at its knots to the quantiles of a sample.
    """

    coefficients: Array  # (d, pieces, 4) Of 1, t, t², t³ on every piece, t in [0, 1]

    @classmethod
    def fit(cls, points: Array, effective: float) -> Self:
        """Fit to a sample (N, d) that is worth a number of independent draws."""
        quantiles = np.quantile(points, special.ndtr(_KNOTS), axis=0)
        values = _settled(quantiles, effective).T
        span = np.ptp(values, axis=1, keepdims=True)
        least_rise = _LEAST_RISE * span + _TINY
        rise = np.maximum(np.diff(values, axis=1), least_rise)
        first = rise[:, :1]
        last = rise[:, -1:]
        nothing = np.zeros_like(first)
        climbed = np.cumsum(rise, axis=1)
        knots = values[:, :1] + np.hstack([nothing, climbed])
        # Harmonic means of neighbouring rises keep the pieces monotone (Fritsch and Butland 1984).
        before = rise[:, :-1]
        after = rise[:, 1:]
        inner = 2.0 * before * after / (before + after)
        left = np.hstack([first, inner])
        right = np.hstack([inner, last])
        # The piece below the knots ends at the first of them with the slope _WIDER * first.
        below = (
            knots[:, :1] - (_WIDER + _BEND) * first,
            (_WIDER + 2.0 * _BEND) * first,
            -_BEND * first,
            nothing,
        )
        between = (
            knots[:, :-1],
            left,
            3.0 * rise - 2.0 * left - right,
            left + right - 2.0 * rise,
        )
        above = (
            knots[:, -1:],
            _WIDER * last,
            _BEND * last,
            nothing,
        )
        pieces = [np.stack(part, axis=2) for part in (below, between, above)]
        return cls(np.hstack(pieces))

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Values at y (d, N), and the log of the product of the derivatives, shape (N,)."""
        size, pieces, _ = self.coefficients.shape
        t = y * _PER_UNIT
        t += _REACH * _PER_UNIT + 1.0
        piece = np.clip(t, 0.0, pieces - 1.0)
        index = piece.astype(np.intp)
        t -= index
        index += pieces * np.arange(size)[:, None]
        table = self.coefficients.reshape(-1, 4)
        taken = np.take(table, index, axis=0, mode="clip")
        c0, c1, c2, c3 = np.moveaxis(taken, -1, 0)
        # c0 + t (c1 + t (c2 + t c3)) and its derivative c1 + t (2 c2 + 3 t c3), in place.
        c3 *= t
        slope = (c2 + 1.5 * c3) * (2.0 * t) + c1
        value = ((c2 + c3) * t + c1) * t + c0
        log_slopes = np.log(slope).sum(axis=0)
        return value, log_slopes + size * np.log(_PER_UNIT)


@dataclass(frozen=True, eq=False)
class Transport:
    """Map from standard coordinates to a target's, with K drivers of d coordinates.

    Means and log scales are linear in 2 K + 1 features: one, and each driver with its square.
    """

    drivers: Indices  # (K,) In the order in which they follow one another
    others: Indices  # (d - K,)
    mean: Array  # (d, 2 K + 1) Coefficients of each coordinate's mean on the features
    log_scale: Array  # (d, 2 K + 1) Coefficients of the log of its spread
    factor: Array  # (d - K, d - K) Lower factor of the covariance of the others' remainders
    spline: Spline  # Layer of the single coordinates

    @classmethod
    def fit(cls, points: Array) -> Self:
        """Fit to a sample (N, d), N well above d, whose quarters are independent of one another."""
        size = points.shape[1]
        y = _normal_scores(points)
        effective = _effective_draws(y)
        drivers = _find_drivers(y, effective)
        others = np.setdiff1d(np.arange(size), drivers)
        features = _features(y[:, drivers])
        mean = np.zeros((size, features.shape[1]))
        log_scale = np.zeros_like(mean)
        for k, i in enumerate(drivers):
            before = 2 * k + 1  # Features of the drivers before this one
            mean[i, :before], log_scale[i, :before], _ = _regress(
                features[:, :before], y[:, [i]], effective
            )
        mean[others], log_scale[others], remainder = _regress(features, y[:, others], effective)
        factor = _factor(remainder, effective)
        spline = Spline.fit(points, effective)
        return cls(drivers, others, mean, log_scale, factor, spline)

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        z = np.ascontiguousarray(z.T)
        y = np.empty_like(z)
        log_jacobian = np.full(z.shape[1], np.log(np.diag(self.factor)).sum())
        features = np.ones((self.mean.shape[1], z.shape[1]))
        for k, i in enumerate(self.drivers):
            before = 2 * k + 1  # Features of the drivers before this one
            coefficients = np.stack([self.mean[i, :before], self.log_scale[i, :before]])
            mean, log_scale = coefficients @ features[:before]
            log_jacobian += log_scale
            y[i] = np.exp(log_scale) * z[i] + mean
            driver = np.clip(y[i], -_CLIP, _CLIP)
            features[before] = driver
            features[before + 1] = driver**2 - 1.0
        coefficients = np.concatenate([self.mean[self.others], self.log_scale[self.others]])
        means, log_scales = np.split(coefficients @ features, 2)
        y[self.others] = np.exp(log_scales) * (self.factor @ z[self.others]) + means
        x, log_slope = self.spline(y)
        return x.T, log_jacobian + log_scales.sum(axis=0) + log_slope


def _normal_scores(points: Array) -> Array:
    """Replace the values of every column (N, d) by normal scores of their ranks."""
    draws = len(points)
    scores = special.ndtri((np.arange(draws) + 0.5) / draws)
    y = np.empty_like(points)
    order = np.argsort(points, axis=0)
    np.put_along_axis(y, order, scores[:, None], axis=0)
    return y


def _features(drivers: Array) -> Array:
    """Return 1, then each driver and its square less one, (N, 2 K + 1), from drivers (N, K)."""
    draws = len(drivers)
    clipped = np.clip(drivers, -_CLIP, _CLIP)
    pairs = np.stack([clipped, clipped**2 - 1.0], axis=2)
    ones = np.ones((draws, 1))
    return np.hstack([ones, pairs.reshape(draws, -1)])


def _effective_draws(y: Array) -> float:
    """Effective draws of normal scores (N, d), by how much their quarters differ.

    Their means and products of pairs have variance 4/N in a quarter of N independent draws. The
    draws count as the N at which this is the variance between the quarters.
    """
    pairs = np.triu_indices(y.shape[1], 1)
    moments = []
    for quarter in np.array_split(y, 4):
        means = quarter.mean(axis=0)
        products = quarter.T @ quarter / len(quarter)
        moments.append(np.concatenate([means, products[pairs]]))
    variance = np.var(moments, axis=0, ddof=1).mean()
    return float(min(len(y), 4.0 / variance))


def _find_drivers(y: Array, effective: float) -> Indices:
    """Choose the coordinates that bend or widen others, strongest first.

    Let m_ij = E[y_i (y_j² - 1)]. These third moments are zero for a joint normal law, whatever its
    correlations: normal scores are symmetric. Where y_j bends y_i, whose mean then follows y_j²,
    m_ij is not zero. Where y_j widens y_i, whose variance then follows y_j, m_ji is not zero. The
    effect of the pair is m_ij² + m_ji². The driver is the one with more effect over all pairs.
    """
    y = np.clip(y, -_CLIP, _CLIP)
    moment = y.T @ (y * y - 1.0) / len(y)
    effect = moment**2 + moment.T**2
    # If y_i and y_j are independent, y_i (y_j² - 1) has variance 1 · 2, and m_ij 2/N.
    chance = effect * effective < 2.0 * _SIGNIFICANT**2
    effect[chance] = 0.0
    np.fill_diagonal(effect, 0.0)
    chosen: list[int] = []
    for _ in range(_MOST_DRIVERS):
        total = effect.sum(axis=0)
        # Ties are broken by index: rounding must not choose.
        largest = total >= (1.0 - _EQUAL) * total.max()
        best = int(np.argmax(largest))
        if not effect[:, best].any():
            break
        chosen.append(best)
        effect[:, best] = 0.0
        effect[best, :] = 0.0
    return np.array(chosen, dtype=np.intp)


def _regress(features: Array, y: Array, effective: float) -> tuple[Array, Array, Array]:
    """Regress columns y (N, C) on features (N, F), F odd.

    Returns the coefficients of their means and of their log spreads, (C, F), zero where they are
    not significant; and what is left of the columns in spreads, (N, C).
    """
    # Standard errors that count, of draws that depend on one another.
    significant = _SIGNIFICANT * np.sqrt(len(y) / effective)
    gram = features.T @ features
    right = features.T @ y
    coefficients = np.linalg.solve(gram, right)
    residual_sd = (y - features @ coefficients).std(axis=0)
    unit_variance = np.diag(np.linalg.inv(gram))
    error = residual_sd * np.sqrt(unit_variance)[:, None]
    kept = np.abs(coefficients) > significant * error
    kept[0] = True
    mean = _solve_kept(gram, right, kept)
    residual = y - features @ mean
    # Log spreads follow the drivers and not their squares.
    linear = np.r_[0, 1 : features.shape[1] : 2]
    drivers = np.ascontiguousarray(features[:, linear])
    log_scale = np.zeros_like(mean)
    log_scale[linear] = _fit_log_scale(drivers, residual, significant)
    remainder = residual * np.exp(-drivers @ log_scale[linear])
    return mean.T, log_scale.T, remainder


def _fit_log_scale(drivers: Array, residual: Array, significant: float) -> Array:
    """Fit the coefficients c of log spreads of columns (N, C) on drivers: 1, and K more (N, K + 1).

    Driver x widens column e, of unit spread, if |sum of x (e² - 1)| exceeds its noise. That has the
    variance N E[x²] Var(e²) if x and e are independent. Other coefficients are zero.

    A residual e at drivers x is normal with log spread x·c: its log density is -x·c - q/2 with
    q = e² exp(-2 x·c). The gradient in c is the sum of x (q - 1). The expected information is twice
    the sum of x xᵀ, as E[q] = 1. Scoring is Newton's method with that expectation in place of the
    Hessian: each step is information⁻¹ gradient.
    """
    sd = residual.std(axis=0)
    square = (residual / sd) ** 2
    driver_square = (drivers**2).mean(axis=0)[:, None]
    noise = np.sqrt(len(drivers) * square.var(axis=0) * driver_square)
    kept = np.abs(drivers.T @ (square - 1.0)) > significant * noise
    kept[0] = True
    coefficients = np.zeros(kept.shape)
    coefficients[0] = np.log(sd)
    information = 2.0 * drivers.T @ drivers
    for _ in range(_LOG_SCALE_STEPS):
        square = (residual * np.exp(-drivers @ coefficients)) ** 2
        step = _solve_kept(information, drivers.T @ (square - 1.0), kept)
        coefficients += np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    return coefficients


def _solve_kept(gram: Array, right: Array, keep: NDArray[np.bool_]) -> Array:
    """Solve each column of right (F, C) for its kept unknowns (F, C); the others are zero."""
    solved = np.zeros_like(right)
    for column, kept in enumerate(keep.T):
        matrix = gram[np.ix_(kept, kept)]
        solved[kept, column] = np.linalg.solve(matrix, right[kept, column])
    return solved


def _factor(remainder: Array, effective: float) -> Array:
    """Lower factor of the covariance of remainders (N, C), its correlations shrunk towards zero.

    A sample of few independent draws has as many chance correlations as pairs, and together they
    would make a worse map than none. A correlation r with standard error 1/sqrt(N) lies |r| sqrt(N)
    errors from zero. It becomes r max(1 - t²/(N r²), 0), with t the noise level: zero within t
    errors, and nearly r far beyond.
    """
    covariance = remainder.T @ remainder / len(remainder)
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    # The floor is zero for all purposes but the division below.
    square = effective * np.maximum(correlation**2, 1e-300)
    noise = _noise_level(square[np.triu_indices(len(square), 1)])
    correlation *= np.maximum(1.0 - noise**2 / square, 0.0)
    while True:
        np.fill_diagonal(correlation, 1.0)
        try:
            factor = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError:
            correlation *= _SHRINKAGE
            continue
        return np.asarray(sd[:, None] * factor)


def _noise_level(squares: Array) -> float:
    """Level in standard errors below which squared correlations, in squared errors, count as none.

    Chance leaves 2 Phi(-t) P of P pairs beyond a level t. The lowest level is chosen at which these
    are at most `_MOST_BY_CHANCE` of the pairs that do lie beyond; failing that, the last one.
    """
    beyond = squares[:, None] > _NOISE_LEVELS**2
    by_chance = 2.0 * special.ndtr(-_NOISE_LEVELS) * len(squares)
    real = by_chance <= _MOST_BY_CHANCE * beyond.sum(axis=0)
    real[-1] = True
    return float(_NOISE_LEVELS[np.argmax(real)])


def _settled(values: Array, effective: float) -> Array:
    """Draw quantiles (K, d) at the knots towards straight lines, as far as chance explains them.

    The extreme quantiles of a few hundred draws err by half an SD, and many coordinates err
    together.
    """
    middle = np.abs(_KNOTS) <= _MIDDLE
    knots = _KNOTS[middle]
    inner = values[middle]
    sd = knots @ inner / (knots @ knots)
    line = inner.mean(axis=0) + sd * _KNOTS[:, None]
    tail = special.ndtr(_KNOTS)
    density = np.exp(-0.5 * _KNOTS**2)
    density /= np.sqrt(2.0 * np.pi)
    variance = tail * (1.0 - tail) / effective
    error = np.sqrt(variance) / density
    departure = values - line
    with np.errstate(divide="ignore", invalid="ignore"):
        standard = departure / (sd * error[:, None])
        square = np.square(standard).mean(axis=0)
        share = (square - 1.0) / (_SETTLED - 1.0)
        share = np.clip(share, 0.0, 1.0)
    # A coordinate without scatter keeps its quantiles.
    share = np.nan_to_num(share, nan=1.0)
    return np.asarray(line + share * departure)
