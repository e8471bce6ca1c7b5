"""A fitted change of coordinates that makes a sample look standard normal.

Three layers, from standard coordinates z to the target's x. The drivers, the few coordinates whose
value widens others or bends their mean, follow one another by y_i = m_i(y_<i) + exp(s_i(y_<i)) z_i.
All others follow the drivers in the same way, with correlated remainders. A monotone spline then
takes every y to its x. Nothing is assumed of the target but a sample, and only this direction is
ever needed: walkers live at z.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError

Array = NDArray[np.float64]


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


def described(names: list[str], point: Array) -> str:
    """Write out the four coordinates farthest from zero, in order."""
    extreme = np.argsort(-np.abs(point))[:4]
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in sorted(extreme.tolist()))


_REACH = 3.0
_KNOTS = np.linspace(-_REACH, _REACH, 13)
_WIDER, _BEND = 1.5, 1.0
#: Knots that straight lines follow, and the mean square of departures, in standard errors, to be
#: believed.
_MIDDLE, _SETTLED = 1.5, 4.0


@dataclasses.dataclass(frozen=True, eq=False)
class Spline:
    """Monotone cubic pieces between evenly spaced knots, one function per coordinate; straight outside."""

    coefficients: Array  # (d, pieces, 4) Of 1, t, t², t³ on every piece, t in [0, 1]

    @classmethod
    def fit(cls, points: Array, effective: float) -> Self:
        """Take standard normal quantiles to the quantiles of a sample (N, d), as far as not chance."""
        values = _settled(np.quantile(points, special.ndtr(_KNOTS), axis=0), effective).T
        # Tied quantiles would make the map flat.
        rise = np.maximum(
            np.diff(values, axis=1), 1e-6 * np.ptp(values, axis=1, keepdims=True) + 1e-300
        )
        knots = values[:, :1] + np.concatenate(
            [np.zeros_like(rise[:, :1]), np.cumsum(rise, axis=1)], 1
        )
        # Harmonic means of neighbouring slopes keep the pieces monotone (Fritsch and Butland 1984).
        inner = 2.0 * rise[:, :-1] * rise[:, 1:] / (rise[:, :-1] + rise[:, 1:])
        left = np.concatenate([rise[:, :1], inner], axis=1)
        right = np.concatenate([inner, rise[:, -1:]], axis=1)
        # Outside, distances grow by slope and square: a sample says little there, and too wide
        # costs little.
        first, last = rise[:, :1], rise[:, -1:]
        none = np.zeros_like(first)
        reach = _WIDER + _BEND
        return cls(
            np.stack(
                [
                    np.concatenate([knots[:, :1] - reach * first, knots], axis=1),
                    np.concatenate([(reach + _BEND) * first, left, _WIDER * last], axis=1),
                    np.concatenate(
                        [-_BEND * first, 3.0 * rise - 2.0 * left - right, _BEND * last], axis=1
                    ),
                    np.concatenate([none, left + right - 2.0 * rise, none], axis=1),
                ],
                axis=2,
            )
        )

    def __call__(self, y: Array) -> tuple[Array, Array]:
        """Values at y (d, N), and the log of the product of the derivatives, shape (N,)."""
        size, pieces, _ = self.coefficients.shape
        per_unit = (pieces - 2) / (2.0 * _REACH)
        t = y * per_unit
        t += _REACH * per_unit + 1.0
        index = np.clip(t, 0.0, pieces - 1.0).astype(np.intp)
        t -= index
        index += pieces * np.arange(size)[:, None]
        c = np.take(self.coefficients.reshape(-1, 4), index, axis=0, mode="clip")
        c0, c1, c2, c3 = (c[..., power] for power in range(4))
        # The cubic and its derivative, in place: c0 + t (c1 + t (c2 + t c3)) and c1 + t (2 c2 + 3 t
        # c3).
        c3 *= t
        slope = (c2 + 1.5 * c3) * (2.0 * t) + c1
        value = ((c2 + c3) * t + c1) * t + c0
        return value, np.log(slope).sum(axis=0) + size * np.log(per_unit)


def _settled(values: Array, effective: float) -> Array:
    """Draw quantiles (K, d) at the knots towards straight lines, as far as they differ by chance alone.

    The extreme quantiles of a few hundred draws err by half a unit, and many coordinates err
    together.
    """
    middle = np.abs(_KNOTS) <= _MIDDLE
    knots = _KNOTS[middle]
    unit = knots @ values[middle] / (knots @ knots)
    line = values[middle].mean(axis=0) + unit * _KNOTS[:, None]
    tail = special.ndtr(_KNOTS)
    density = np.exp(-0.5 * _KNOTS**2) / np.sqrt(2.0 * np.pi)
    error = np.sqrt(tail * (1.0 - tail) / effective) / density
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.square((values - line) / (unit * error[:, None])).mean(axis=0)
        share = np.nan_to_num(np.clip((square - 1.0) / (_SETTLED - 1.0), 0.0, 1.0), nan=1.0)
    return np.asarray(line + share * (values - line))


_DRIVERS = 6  # most drivers
_SIGNIFICANT = 4.0  # standard errors a bend or a widening must have to be believed
#: Standard errors within which a correlation may count as none, and the most of the rest that are
#: chance.
_NOISE, _BY_CHANCE = np.arange(2.0, 6.5, 0.5), 0.5
_ALIKE = 1e-9  # effects that differ by no more are the same
_SHORT = 0.5  # most a coefficient of a log scale changes in one step of its fit
_COLUMNS = 32  # points are mapped in multiples of, so that none depends on how many there are
_PASS = 1024  # points mapped at a time: what is made on the way stays in the processor's cache
_CLIP = 3.0  # SDs beyond which a driver's effect stays what it is


@dataclasses.dataclass(frozen=True, eq=False)
class Transport:
    """Map from standard coordinates to a target's."""

    drivers: NDArray[np.intp]
    others: NDArray[np.intp]
    mean: Array  # (d, 2 K + 1)
    log_scale: Array  # (d, 2 K + 1) Coefficients of the log of each coordinate's spread on the same
    factor: Array  # (d - K, d - K) Lower factor of the covariance of the others' remainders
    spline: Spline  # Layer of the single coordinates

    @classmethod
    def fit(cls, points: Array) -> Self:
        """Fit to a sample of shape (N, d), N well above d, whose quarters are independent of one another."""
        count, size = points.shape
        y = np.empty_like(points)
        scores = special.ndtri((np.arange(count) + 0.5) / count)
        np.put_along_axis(y, np.argsort(points, axis=0), scores[:, None], axis=0)
        effective = _effective(y)
        drivers = _drivers(y, effective)
        others = np.setdiff1d(np.arange(size), drivers)
        features = _features(y[:, drivers])
        mean, log_scale = np.zeros((2, size, features.shape[1]))
        for k, i in enumerate(drivers):
            known = 2 * k + 1
            mean[i, :known], log_scale[i, :known] = (
                found[0] for found in _regress(features[:, :known], y[:, [i]], effective)[:2]
            )
        mean[others], log_scale[others], remainder = _regress(features, y[:, others], effective)
        return cls(
            drivers,
            others,
            mean,
            log_scale,
            _factor(remainder, effective),
            Spline.fit(points, effective),
        )

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        if len(z) > _PASS:
            passes = [self(z[start : start + _PASS]) for start in range(0, len(z), _PASS)]
            points, log_jacobians = zip(*passes, strict=True)
            return np.concatenate(points), np.concatenate(log_jacobians)
        count = len(z)
        # Whole multiples: products of matrices sum what is left over in another order.
        padded = np.zeros((z.shape[1], count + -count % _COLUMNS))
        padded[:, :count] = z.T
        z = padded
        y = np.empty_like(z)
        features = np.ones((self.mean.shape[1], z.shape[1]))
        log_jacobian = np.full(z.shape[1], np.log(np.diag(self.factor)).sum())
        for k, i in enumerate(self.drivers):
            known = 2 * k + 1
            m, s = np.stack([self.mean[i, :known], self.log_scale[i, :known]]) @ features[:known]
            log_jacobian += s
            np.exp(s, out=s)
            s *= z[i]
            np.add(s, m, out=y[i])
            driving = np.minimum(np.maximum(y[i], -_CLIP), _CLIP, out=features[known])
            np.multiply(driving, driving, out=features[known + 1])
            features[known + 1] -= 1.0
        others = np.concatenate([self.mean[self.others], self.log_scale[self.others]])
        m, s = np.split(others @ features, 2)
        log_jacobian += s.sum(axis=0)
        np.exp(s, out=s)
        s *= self.factor @ z[self.others]
        s += m
        y[self.others] = s
        x, log_slope = self.spline(y)
        return x[:, :count].T, (log_jacobian + log_slope)[:count]


def _features(driving: Array) -> Array:
    """Return 1, then each driver and its square less one: shape (N, 2 K + 1) from drivers (N, K)."""
    driving = np.clip(driving, -_CLIP, _CLIP)
    pairs = np.stack([driving, driving**2 - 1.0], axis=2).reshape(len(driving), -1)
    return np.concatenate([np.ones((len(driving), 1)), pairs], axis=1)


def _effective(y: Array) -> float:
    """Estimate the independent draws that normal scores (N, d) are worth, by what their quarters differ."""
    quarters = np.array_split(y, 4)
    pairs = np.triu_indices(y.shape[1], 1)
    moments = [
        np.concatenate([part.mean(axis=0), (part.T @ part / len(part))[pairs]]) for part in quarters
    ]
    # Each of these moments would have variance 1/N, about zero or so, in N independent draws.
    return float(min(len(y), 4.0 / np.var(moments, axis=0, ddof=1).mean()))


def _factor(remainder: Array, effective: float) -> Array:
    """Lower factor of the covariance of remainders (N, C), correlations within their noise left out.

    A sample of few independent draws has as many chance correlations as pairs, and together they
    would make a worse map than none.
    """
    covariance = remainder.T @ remainder / len(remainder)
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    square = effective * np.maximum(correlation**2, 1e-300)
    # Of many pairs a twentieth lie beyond two standard errors by chance.
    pairs = square[np.triu_indices(len(square), 1)]
    found = (pairs[:, None] > _NOISE**2).sum(axis=0)
    rare = 2.0 * special.ndtr(-_NOISE) * len(pairs) <= _BY_CHANCE * found
    noise = _NOISE[int(np.argmax(rare)) if rare.any() else -1]
    correlation *= np.maximum(1.0 - noise**2 / square, 0.0)
    while True:
        try:
            np.fill_diagonal(correlation, 1.0)
            return np.asarray(sd[:, None] * np.linalg.cholesky(correlation))
        except np.linalg.LinAlgError:
            correlation *= 0.9


def _drivers(y: Array, effective: float) -> NDArray[np.intp]:
    """Order coordinates by how much they bend or widen others, strongest first."""
    count, size = y.shape
    y = np.clip(y, -_CLIP, _CLIP)
    square = y * y - 1.0
    correlation = y.T @ y / count
    # Entry (i, j): third moments of y_i, less what its correlation with y_j explains, and y_j.
    odd = (y * square).mean(axis=0)
    bend = y.T @ square / count - correlation * odd
    widen = square.T @ y / count - correlation**2 * odd
    effect = bend**2 + widen**2
    effect[(effect * effective < 2.0 * _SIGNIFICANT**2) | np.eye(size, dtype=bool)] = 0.0
    chosen: list[int] = []
    for _ in range(_DRIVERS):
        # Of a pair that widen each other alike the first: rounding must not choose.
        total = effect.sum(axis=0)
        best = int(np.argmax(total >= (1.0 - _ALIKE) * total.max()))
        if not effect[:, best].any():
            break
        chosen.append(best)
        effect[:, best] = effect[best, :] = 0.0
    return np.array(chosen, dtype=np.intp)


def _regress(features: Array, y: Array, effective: float) -> tuple[Array, Array, Array]:
    """Regress the mean and log spread of columns y (N, C) on features (N, F), F odd.

    Returns coefficients of the means and of the log spreads, (C, F), those that are significant,
    and the remainders (N, C).
    """
    count, size = features.shape
    linear = np.r_[0, 1:size:2]
    gram, right = features.T @ features, features.T @ y
    mean = np.linalg.solve(gram, right)
    error = (y - features @ mean).std(axis=0) * np.sqrt(np.diag(np.linalg.inv(gram)))[:, None]
    fewer = np.sqrt(count / effective)
    keep = np.abs(mean) > _SIGNIFICANT * fewer * error
    keep[0] = True
    mean = _solve_kept(gram, right, keep)
    residual = y - features @ mean
    log_scale = np.zeros_like(mean)
    log_scale[0] = np.log(residual.std(axis=0))
    square = (residual * np.exp(-log_scale[0])) ** 2
    driving = np.ascontiguousarray(features[:, linear])
    noise = np.sqrt(count * square.var(axis=0) * (driving**2).mean(axis=0)[:, None])
    widens = np.abs(driving.T @ (square - 1.0)) > _SIGNIFICANT * fewer * noise
    widens[0] = True
    some = np.flatnonzero(widens.sum(axis=0) > 1)
    if some.size:
        kept, own, moving = widens[:, some], residual[:, some], np.zeros((len(linear), some.size))
        moving[0] = log_scale[0, some]
        information = 2.0 * gram[np.ix_(linear, linear)]
        for _ in range(5):
            square = (own * np.exp(-driving @ moving)) ** 2
            # Short steps: a sample in a few clumps sends the first of them far.
            step = _solve_kept(information, driving.T @ (square - 1.0), kept)
            moving += np.clip(step, -_SHORT, _SHORT)
        log_scale[np.ix_(linear, some)] = moving
        residual[:, some] = own * np.exp(-driving @ moving)
    plain = np.setdiff1d(np.arange(y.shape[1]), some)
    residual[:, plain] *= np.exp(-log_scale[0, plain])
    return mean.T, log_scale.T, residual


def _solve_kept(gram: Array, right: Array, keep: NDArray[np.bool_]) -> Array:
    """Solve each column of right (F, C) for its kept unknowns (F, C); the others are zero."""
    solved = np.zeros_like(right)
    for column, kept in enumerate(keep.T):
        solved[kept, column] = np.linalg.solve(gram[np.ix_(kept, kept)], right[kept, column])
    return solved


@dataclasses.dataclass(frozen=True, eq=False)
class Affine:
    """Linear map from standard coordinates."""

    centre: Array  # (d,) Where zero goes
    factor: Array  # (d, d) Lower factor of the covariance

    @classmethod
    def normal(cls, centre: Array, covariance: Array) -> Self:
        """Map standard coordinates to a given centre (d,) and covariance (d, d)."""
        # A ridge lets a thin sample be factored.
        ridge = 1e-10 * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        return cls(centre, np.linalg.cholesky(covariance + ridge))

    @classmethod
    def fit(cls, points: Array, weights: Array) -> Self:
        """Fit to points (N, d) with weights (N,) that sum to one."""
        centre = weights @ points
        deviation = points - centre
        return cls.normal(centre, (weights[:, None] * deviation).T @ deviation)

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Map points (N, d) and return them with log abs det of the Jacobian, shape (N,)."""
        log_determinant = np.log(np.diag(self.factor)).sum()
        return self.centre + z @ self.factor.T, np.full(len(z), log_determinant)


class Transported:
    """A target in the coordinates of a transport, whose values are never NaN."""

    def __init__(self, target: Target, transport: Affine | Transport) -> None:
        self._target = target
        self.transport = transport

    @property
    def names(self) -> list[str]:
        """Names of the target's coordinates."""
        return self._target.names

    def map(self, z: Array) -> Array:
        """Take points to the target's coordinates."""
        return self.transport(z)[0]

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d) of the transport's coordinates, shape (W,)."""
        x, log_jacobian = self.transport(points)
        values = self._target(x)
        bad = np.isnan(values)
        if bad.any():
            where = described(self.names, x[int(np.argmax(bad))])
            raise RefusalError(f"the log density is NaN at {where}.")
        return values + log_jacobian
