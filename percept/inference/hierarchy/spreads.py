"""Coordinates that follow the data, for the SDs of one level: between subjects, or trials.

A rough likelihood, normal in log sigma, places each cell's coordinate and sets its unit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Statistics

__all__ = [
    "SpreadMap",
    "TiedSpreads",
    "rough_between",
    "rough_trial",
    "tie_between",
    "tie_trial",
]

Array = NDArray[np.float64]
_TINY = 1e-300
#: Largest correlation of k and b that coordinates follow.
_MOST_TIED = 0.9999
#: Of log sigma about its trend, where the rough likelihood is taken, and Newton steps towards that
#: place.
_TYPICAL_OMEGA, _ROUGH_STEPS = 0.5, 40
#: Cells that say less than this of log sigma, against a prior's 1, are left to the prior.
_LEAST_WEIGHT = 0.1
#: log sigma (P, J, W), multiples of the trend's prior SDs (P, 2, W) and log density (W,); one map
#: has no P.
Spreads = tuple[Array, Array, Array]


class SpreadMap:
    """Map coordinates to the spreads of one parameter at one level, their trend integrated out.

    log sigma = m + U h + omega e with h (multiples of the trend's prior SDs) and e standard normal.
    With a rough likelihood N(log sigma; l, diag(1/w)), log sigma given omega is normal with some
    covariance C, and u is C^(-1/2) times the distance from its mean: neither a centred nor a
    non-centred form is good for all data. The trend follows its exact law given log sigma and
    omega, of which the data say nothing more.
    """

    def __init__(
        self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array
    ) -> None:
        cells = loadings.shape[1]
        self._centre = centre
        # Padded, so that a single cell has two singular values too.
        self._turn, size, basis = np.linalg.svd(
            np.pad(loadings, ((0, 0), (0, 1))), full_matrices=False
        )
        # U' = turn diag(size) basis: the two multiples turn(...) are independent given log sigma.
        self._size = size[:, None]
        self._basis = np.where(self._size > 0, basis[:, :cells], 0.0)
        self._loading = self._size * self._basis
        first, second = self._loading
        self._products = np.stack([first * first, first * second, second * second])
        self._apart = (rough_mean - centre)[:, None]
        self._weight = rough_weight[:, None]

    def __call__(self, u: Array, omega: Array, trend: Array, shift: Array | float = 0.0) -> Spreads:
        """Map u (J, W), omega (W,) and trend (2, W), the rough means moved by a shift (J, W)."""
        apart = self._apart + shift
        square = omega * omega
        swell = 1.0 + self._weight * square
        root = np.sqrt(swell)
        held = self._weight / swell
        h, root_det = self._whitened_trend(u / root, held, swell, omega, apart)
        middle = self._loading.T @ h
        # log sigma = m + middle + omega pull: nothing is divided by an omega that may be tiny.
        pull = held * omega * (apart - middle) + u / root
        along = self._basis @ pull
        off = pull - self._basis.T @ along
        variance = square + self._size * self._size
        shared = self._size * h + omega * along
        share = shared / variance
        squares = np.einsum("jw,jw->w", off, off) + np.einsum("rw,rw->w", shared, share)
        logs = np.log(swell).sum(axis=0) + np.log(variance).sum(axis=0)
        given = self._size * share + omega / np.sqrt(variance) * (self._turn.T @ trend)
        log_density = np.log(root_det) - 0.5 * (squares + logs)
        return self._centre + middle + omega * pull, self._turn @ given, log_density

    def _whitened_trend(
        self, u: Array, held: Array, swell: Array, omega: Array, apart: Array
    ) -> tuple[Array, Array]:
        """Multiples of the loadings in log sigma, (2, W), and the root of det(omega² I + B), (W,).

        Given the trend the cells are independent, with variances omega²/q, q = 1 + w omega². With
        LL' the precision of the trend's multiples given the rough likelihood and G = q^(-1/2) U
        L'^(-1), the covariance is C = omega² q^(-1/2) (I + GG'/omega²) q^(-1/2), and its root needs
        that of the 2 x 2 matrix omega² I + B, B = G'G, alone.
        """
        n11, n12, n22 = self._products @ held
        l11 = np.sqrt(1.0 + n11)
        l21 = n12 / l11
        # 1 + n22 - l21², without the difference of large numbers that the last two may be.
        l22 = np.sqrt((1.0 + n11 + n22 + np.maximum(n11 * n22 - n12 * n12, 0.0)) / (1.0 + n11))
        c11, c12, c22 = self._products @ (1.0 / swell)
        tilt = l21 / l11
        b11 = c11 / (l11 * l11)
        b12 = (c12 - tilt * c11) / (l11 * l22)
        b22 = np.maximum(c22 - 2.0 * tilt * c12 + tilt * tilt * c11, 0.0) / (l22 * l22)
        d11, d22 = omega * omega + b11, omega * omega + b22
        root_det = np.sqrt(d11 * d22 - b12 * b12)
        over = 1.0 / np.sqrt(d11 + d22 + 2.0 * root_det)
        r11, r12, r22 = omega + (d11 + root_det) * over, b12 * over, omega + (d22 + root_det) * over
        det = r11 * r22 - r12 * r12
        first, second = self._solve(self._loading @ u, l11, l21, l22)
        y1, y2 = (r22 * first - r12 * second) / det, (r11 * second - r12 * first) / det
        g1, g2 = self._solve(self._loading @ (held * apart), l11, l21, l22)
        h2 = (y2 + g2) / l22
        return np.stack([(y1 + g1 - l21 * h2) / l11, h2]), root_det

    @staticmethod
    def _solve(right: Array, l11: Array, l21: Array, l22: Array) -> tuple[Array, Array]:
        """L^(-1) times vectors (2, W)."""
        first = right[0] / l11
        return first, (right[1] - l21 * first) / l22


class TiedSpreads:
    """Spreads of one level of one parameter or two, the second's given the first's.

    The rough likelihood of log sigma of b is N(l + slope (log sigma of k - its l), (1 - tie²)/w).
    Near a correlation of one the ratio of the two is known far better than either.
    """

    def __init__(
        self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array, tie: float
    ) -> None:
        known = (rough_weight > 0).all(axis=0)
        self.weight = rough_weight.copy()
        self.weight[1:] /= np.where(known, 1.0 - tie * tie, 1.0)
        self._maps = [
            SpreadMap(centre, *of) for of in zip(loadings, rough_mean, self.weight, strict=True)
        ]
        ratio = rough_weight[0] / np.where(known, rough_weight[-1], 1.0)
        self._slope = np.where(known, tie * np.sqrt(ratio), 0.0)[:, None]
        self._mean = rough_mean[0][:, None]

    def __call__(self, u: Array, omega: Array, trend: Array) -> Spreads:
        """Map coordinates (P, J, W), given omega (P, W) and the trend (P, 2, W), to spreads."""
        found = [self._maps[0](u[0], omega[0], trend[0])]
        for second in self._maps[1:]:
            shift = self._slope * (found[0][0] - self._mean)
            found.append(second(u[1], omega[1], trend[1], shift))
        log_sigma, multiples, log_density = zip(*found, strict=True)
        return np.stack(log_sigma), np.stack(multiples), np.sum(log_density, axis=0)


def rough_between(
    statistics: Statistics, loadings: Array, centre: float, own_sd: float, *, subject_effect: bool
) -> tuple[Array, Array]:
    """Return a normal likelihood of log sigma, mean and weight (P, J), at the cells' common mode.

    A scatter sd² with df degrees of freedom has the mean sigma² + noise. Where noise explains most
    of it, the mode of a cell by itself is chance.
    """
    sd, df, noise = statistics.sd, statistics.df, _trial_variance(statistics)
    if subject_effect:
        apart, apart_df = _within_subjects(statistics.cell_means)
        # Scatter that is the subjects' own says nothing of sigma.
        less = (apart > 0) & (apart < sd)
        sd, df = np.where(less, apart, sd), np.where(less, apart_df, df)
    known, unit = sd > 0, np.eye(sd.shape[1])
    spread = _TYPICAL_OMEGA if sd.shape[1] > 1 else own_sd
    precision = np.linalg.inv(np.swapaxes(loadings, 1, 2) @ loadings + spread**2 * unit)
    log_sigma = np.full(sd.shape, centre)
    for _ in range(_ROUGH_STEPS):
        left = 1.0 / (1.0 + noise * np.exp(-2.0 * log_sigma))
        weight = np.where(known, 2.0 * df * left * left, 0.0)
        short = np.where(known, sd * sd * left * np.exp(-2.0 * log_sigma) - 1.0, 0.0)
        score = df * left * short - (precision @ (log_sigma - centre)[..., None])[..., 0]
        step = np.linalg.solve(precision + weight[..., None] * unit, score[..., None])[..., 0]
        log_sigma = log_sigma + np.clip(step, -1.0, 1.0)
    half = np.where(left > 0, 0.5 * short / np.maximum(left, _TINY), 0.0)
    informed = weight > _LEAST_WEIGHT
    return np.where(informed, log_sigma + half, 0.0), np.where(informed, weight, 0.0)


def rough_trial(statistics: Statistics) -> tuple[Array, Array]:
    """Return a normal likelihood of the log SD between trials, mean and weight (P, J)."""
    squares = (statistics.trial_rows**2).sum(axis=1)
    df = np.broadcast_to(statistics.trial_df, squares.shape)
    scatter = np.sqrt(squares / np.maximum(df, 1))
    return np.log(np.where(scatter > 0, scatter, 1.0)), np.where(scatter > 0, 2.0 * df, 0.0)


def tie_between(statistics: Statistics, *, subject_effect: bool) -> float:
    """Correlation of the rough log SDs of k and b, by departures of subjects' cell means."""
    means = statistics.cell_means
    pairs = np.asarray(np.isfinite(means).all(axis=1, keepdims=True))
    off = _centred(means, pairs, 2) if subject_effect else means
    off = _centred(off, pairs, 0)
    # Each environment weighs by its degrees of freedom, whatever its spread.
    size = np.sqrt(np.square(off).sum(axis=0) / np.maximum(pairs.sum(axis=0) - 1.0, 1.0))
    return _tie(np.moveaxis(off, 1, 0), size[:, None], float(statistics.df.min(axis=0).sum()))


def tie_trial(statistics: Statistics) -> float:
    """Correlation of the rough log SDs of k and b between trials."""
    rows, df = statistics.trial_rows, statistics.trial_df
    size = np.sqrt(np.square(rows).sum(axis=1, keepdims=True) / np.maximum(df, 1.0))
    return _tie(rows, size, float(df.sum()))


def _tie(off: Array, size: Array, df: float) -> float:
    """Squared correlation of k and b, two standard errors of its Fisher transform nearer zero.

    Log SDs of samples of pairs with correlation rho are correlated by rho². Departures are in units
    of their size; of one parameter there is none.
    """
    if len(off) < 2:
        return 0.0
    k, b = (off / np.where(size > 0, size, 1.0)).reshape(2, -1)
    together = math.sqrt(float(k @ k) * float(b @ b))
    if df <= 3.0 or together == 0.0:
        return 0.0
    score = math.atanh(min(abs(float(k @ b)) / together, _MOST_TIED)) - 2.0 / math.sqrt(df - 3.0)
    return math.tanh(max(score, 0.0)) ** 2


def _trial_variance(statistics: Statistics) -> Array:
    """Variance that trials' scatter gives to a cell's means, (P, J); zero without repeats."""
    df = statistics.trial_df
    squares = (statistics.trial_rows**2).sum(axis=1)
    # An environment without repeats takes the variance that the others have together.
    pooled = squares.sum(axis=1, keepdims=True) / max(df.sum(), 1.0)
    variance = np.where(df > 0, squares / np.maximum(df, 1.0), pooled)
    subjects, shares = np.zeros((2, df.size))
    for pattern in statistics.patterns:
        subjects[pattern.environments] += pattern.subjects
        shares[pattern.environments] += pattern.subjects / pattern.trials
    return np.sqrt(variance * shares / subjects) ** 2


def _centred(values: Array, present: NDArray[np.bool_], axis: int) -> Array:
    """Values less their mean along an axis, zero where not present."""
    count = np.maximum(present.sum(axis=axis, keepdims=True), 1)
    mean = np.where(present, values, 0.0).sum(axis=axis, keepdims=True) / count
    return np.where(present, values - mean, 0.0)


def _within_subjects(cell_means: Array) -> tuple[Array, Array]:
    """SD per cell without subjects' means, (P, J), and degrees of freedom, of (N, P, J)."""
    several = np.isfinite(cell_means).all(axis=1).sum(axis=1) > 1
    values = cell_means[several]
    present = np.isfinite(values)
    rest = _centred(_centred(values, present, 0), present, 2)
    count, seen = present.sum(axis=0), present.sum(axis=2, keepdims=True)
    kept = np.where(present, 1.0 - 1.0 / np.maximum(seen, 1), 0.0).sum(axis=0)
    # Of the count - 1 degrees of freedom the subjects' means take their share.
    df = np.maximum(kept * (1.0 - 1.0 / np.maximum(count, 1)), 0.0)
    return np.sqrt((rest**2).sum(axis=0) / np.maximum(df, _TINY)) * (df > 0), df
