"""What the data say of the log SDs of one level, roughly, for coordinates to follow.

For a quantity and a cell the rough likelihood is N(log sigma; mean, 1/weight). A scatter sd² of df
degrees of freedom has the mean sigma² + noise, with noise the variance that trials give to cell
means. About some log sigma its log likelihood is normal, with

    share = sigma² / (sigma² + noise)             the part of the scatter's mean that is sigma²
    excess = sd² / (sigma² + noise) - 1           the scatter over its mean, less one
    weight = 2 df share²
    mean = log sigma + excess / (2 share)

It is taken at the mode that all cells have together under a typical prior: where noise explains
most of a cell's scatter, the mode of the cell by itself is chance.

Samples of pairs with the correlation rho have log SDs with a correlation of rho², here called tie,
with rho taken two standard errors nearer zero. So the rough log SDs of the second quantity are,
given those of the first,

    mean_2 + tie √(weight_1 / weight_2) (log sigma_1 - mean_1)

with the weight weight_2 / (1 - tie²). Near a correlation of one the ratio of the two SDs is known
far better than either. All of it shapes coordinates alone and does not enter the posterior. Arrays
have the shape (P, C): P quantities by C cells.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics

__all__ = ["RoughLikelihood", "likelihood_between", "likelihood_of_trials", "tie_trial"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: SD of log sigma about its trend in the typical prior: half the prior's scale of omega. It decides
#: how far cells inform one another where noise hides sigma, and nothing else.
_TYPICAL_OMEGA = 0.5
#: Newton steps towards the mode, once per model. Steps of one unit reach SDs e^30 from the prior's
#: mean, and the last ten converge.
_NEWTON_STEPS = 40
#: Longest Newton step of log sigma: far from the mode the curvature is wrong.
_LONGEST_STEP = 1.0
#: Least weight of a cell that coordinates follow. The prior has a weight of about one: a cell of a
#: tenth moves and narrows log sigma by less than coordinates are worth.
_LEAST_FOLLOWED = 0.1
#: Least share by which is divided. Cells with so small a share have no weight.
_LEAST_SHARE = 1e-300
#: Largest correlation of k and b, since atanh(1) is infinite. SDs whose ratio is known to a
#: fiftieth of their own error, √(1 - 0.9999⁴), leave nothing to gain beyond.
_LARGEST_CORRELATION = 0.9999
#: Standard errors by which the correlation is drawn towards zero: two quantities whose correlation
#: is chance, at the usual 95 %, then have separate coordinates.
_STANDARD_ERRORS = 2.0


@dataclasses.dataclass(frozen=True, eq=False)
class RoughLikelihood:
    """Rough likelihood of the log SDs of P quantities (one or two) in C cells."""

    mean: Array  # (P, C) Of each quantity by itself
    weight: Array  # (P, C) Of the second given the first; zero where the data say nothing
    slope: Array  # (C,) Of the second quantity on the first

    @classmethod
    def tied(
        cls,
        mean: Array,
        weight: Array,
        tie: float,
    ) -> RoughLikelihood:
        """From means and weights (P, C) of each quantity by itself, and their correlation."""
        both = (weight > 0).all(axis=0)
        conditional = weight.copy()
        conditional[1:] /= np.where(both, 1.0 - tie * tie, 1.0)
        ratio = weight[0] / np.where(both, weight[-1], 1.0)
        slope = np.where(both, tie * np.sqrt(ratio), 0.0)
        return cls(mean, conditional, slope)

    def shift_of_second(self, log_sigma: Array, shift: Array | float = 0.0) -> Array:
        """Return what log SDs (C, W) of the first quantity add to the rough means of the second.

        The rough means of the first are themselves moved by a shift (C, W).
        """
        mean = self.mean[0][:, None]
        slope = self.slope[:, None]
        departure = log_sigma - mean - shift
        return np.asarray(slope * departure)


def likelihood_between(
    statistics: Statistics,
    loadings: Array,
    centre: float,
    single_sd: float,
    *,
    subject_effect: bool,
) -> RoughLikelihood:
    """Rough likelihood of the SDs between subjects, by the arguments of `_rough_between`."""
    rough = _rough_between(statistics, loadings, centre, single_sd, subject_effect=subject_effect)
    tie = tie_between(statistics, subject_effect=subject_effect)
    return RoughLikelihood.tied(rough.mean, rough.weight, tie)


def likelihood_of_trials(statistics: Statistics) -> RoughLikelihood:
    """Rough likelihood of the SDs between trials."""
    rough = rough_trial(statistics)
    return RoughLikelihood.tied(rough.mean, rough.weight, tie_trial(statistics))


class RoughSpreads(NamedTuple):
    """Rough likelihood of log SDs, each quantity by itself."""

    mean: Array  # (P, J) Zero where the weight is
    weight: Array  # (P, J) Inverse variance; zero where the data say next to nothing


class _Expansion(NamedTuple):
    """The likelihood of log sigma about some value, (P, J) each."""

    share: Array
    excess: Array
    weight: Array


def _rough_between(
    statistics: Statistics,
    loadings: Array,
    centre: float,
    single_sd: float,
    *,
    subject_effect: bool,
) -> RoughSpreads:
    """Return a rough likelihood of the log SDs between subjects, at the cells' common mode.

    The loadings (P, K, C) are columns of log sigma times the prior SDs of their coefficients;
    `single_sd` is the prior SD of log sigma where there is a single cell.
    """
    scatter = cell_scatter(statistics, subject_effect=subject_effect)
    cells = scatter.sd.shape[1]
    omega = _TYPICAL_OMEGA if cells > 1 else single_sd
    identity = np.eye(cells)
    trend_covariance = np.swapaxes(loadings, 1, 2) @ loadings
    precision = np.linalg.inv(trend_covariance + omega**2 * identity)  # (P, J, J)
    log_sigma = np.full(scatter.sd.shape, centre)
    for _ in range(_NEWTON_STEPS):
        expansion = _expansion(scatter, log_sigma)
        departure = (log_sigma - centre)[..., None]
        prior_score = precision @ departure
        score = scatter.df * expansion.share * expansion.excess - prior_score[..., 0]
        curvature = precision + expansion.weight[..., None] * identity
        step = np.linalg.solve(curvature, score[..., None])[..., 0]
        log_sigma = log_sigma + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    # From the mode under the prior to the mean of the likelihood alone.
    step_of_data = 0.5 * expansion.excess / np.maximum(expansion.share, _LEAST_SHARE)
    followed = expansion.weight > _LEAST_FOLLOWED
    return RoughSpreads(
        mean=np.where(followed, log_sigma + step_of_data, 0.0),
        weight=np.where(followed, expansion.weight, 0.0),
    )


def _expansion(scatter: CellScatter, log_sigma: Array) -> _Expansion:
    """Expand the likelihood about log SDs. A scatter of zero is no evidence of a small SD."""
    informed = scatter.sd > 0
    inverse_variance = np.exp(-2.0 * log_sigma)
    share = 1.0 / (1.0 + scatter.noise * inverse_variance)
    ratio = scatter.sd * scatter.sd * share * inverse_variance
    return _Expansion(
        share=share,
        excess=np.where(informed, ratio - 1.0, 0.0),
        weight=np.where(informed, 2.0 * scatter.df * share * share, 0.0),
    )


def rough_trial(statistics: Statistics) -> RoughSpreads:
    """Return a rough likelihood of the log SDs between trials: their scatter has no noise."""
    squares = (statistics.trial_rows**2).sum(axis=1)
    df = np.broadcast_to(statistics.trial_df, squares.shape)
    sd = np.sqrt(squares / np.maximum(df, 1))
    return RoughSpreads(
        mean=np.log(np.where(sd > 0, sd, 1.0)),
        weight=np.where(sd > 0, 2.0 * df, 0.0),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class CellScatter:
    """Scatter of subjects' means in each cell: sd² has the mean sigma² + noise."""

    sd: Array  # (P, J) SD of the means, zero where there is none
    df: Array  # (P, J) Its degrees of freedom
    noise: Array  # (P, J) Variance that the scatter of trials gives to a mean; zero without repeats


def cell_scatter(
    statistics: Statistics,
    *,
    subject_effect: bool,
) -> CellScatter:
    """Scatter between subjects, without their means over cells where these have a variance."""
    noise = _noise_of_trials(statistics)
    sd = statistics.sd
    df = statistics.df
    if subject_effect:
        # Scatter of subjects' means over cells says nothing of sigma.
        sd_within, df_within = _within_subjects(statistics.cell_means)
        has_scatter = sd_within > 0
        smaller = has_scatter & (sd_within < sd)
        sd = np.where(smaller, sd_within, sd)
        df = np.where(smaller, df_within, df)
    return CellScatter(sd, df, noise)


def centred(
    values: Array,
    present: Flags,
    axis: int,
) -> Array:
    """Values less their mean along an axis, zero where not present."""
    known = np.where(present, values, 0.0)
    total = known.sum(axis=axis, keepdims=True)
    count = present.sum(axis=axis, keepdims=True)
    mean = total / np.maximum(count, 1)
    departures = values - mean
    return np.where(present, departures, 0.0)


def _within_subjects(cell_means: Array) -> tuple[Array, Array]:
    """SD and degrees of freedom of cell means (N, P, J) about the means of cells and subjects."""
    complete = np.isfinite(cell_means).all(axis=1)  # (N, J)
    cells = complete.sum(axis=1)
    several = cells > 1
    values = cell_means[several]
    present = np.isfinite(values)
    about_cells = centred(values, present, 0)
    residuals = centred(about_cells, present, 2)
    subjects_of_cell = present.sum(axis=0)
    cells_of_subject = present.sum(axis=2, keepdims=True)
    # Each subject's mean takes one degree of freedom, in equal parts from the subject's cells, and
    # each cell's mean takes one from its subjects.
    lost_by_subject = 1.0 / np.maximum(cells_of_subject, 1)
    lost_by_cell = 1.0 / np.maximum(subjects_of_cell, 1)
    kept = np.where(present, 1.0 - lost_by_subject, 0.0)
    df = kept.sum(axis=0)
    df *= 1.0 - lost_by_cell
    squares = np.square(residuals).sum(axis=0)
    nothing = np.zeros_like(df)
    variance = np.divide(squares, df, out=nothing, where=df > 0)
    return np.sqrt(variance), df


def _noise_of_trials(statistics: Statistics) -> Array:
    """Variance that trials give to a cell's mean, averaged over the subjects of the cell."""
    df = statistics.trial_df
    squares = np.square(statistics.trial_rows).sum(axis=1)
    all_squares = squares.sum(axis=1, keepdims=True)
    # An environment without repeats takes the variance that the others have together.
    pooled = all_squares / max(df.sum(), 1.0)
    alone = squares / np.maximum(df, 1.0)
    variance = np.where(df > 0, alone, pooled)
    subjects = np.zeros(df.size)
    inverse_trials = np.zeros(df.size)
    for pattern in statistics.patterns:
        subjects[pattern.environments] += pattern.subjects
        inverse_trials[pattern.environments] += pattern.subjects / pattern.trials
    return variance * inverse_trials / subjects


def tie_between(statistics: Statistics, *, subject_effect: bool) -> float:
    """Tie of the SDs between subjects, by departures of subjects' cell means.

    Subjects' means over their cells are taken away where subjects have an effect of their own.
    """
    means = statistics.cell_means
    finite = np.isfinite(means)
    complete = np.asarray(finite.all(axis=1, keepdims=True))
    departures = means
    if subject_effect:
        departures = centred(departures, complete, 2)
    departures = centred(departures, complete, 0)
    # Each environment weighs by its degrees of freedom, whatever its spread.
    squares = np.square(departures).sum(axis=0)
    subjects = complete.sum(axis=0)
    variance = squares / np.maximum(subjects - 1.0, 1.0)
    sd = np.sqrt(variance)
    df = statistics.df.min(axis=0)
    by_quantity = np.moveaxis(departures, 1, 0)
    return _tie(by_quantity, sd[:, None], df.sum())


def tie_trial(statistics: Statistics) -> float:
    """Tie of the SDs between trials, by the rows of their scatter."""
    rows = statistics.trial_rows
    df = statistics.trial_df
    squares = np.square(rows).sum(axis=1, keepdims=True)
    variance = squares / np.maximum(df, 1.0)
    sd = np.sqrt(variance)
    return _tie(rows, sd, df.sum())


def _tie(
    departures: Array,
    sd: Array,
    df: float,
) -> float:
    """Tie of departures (P, ...), in units of their SD, with so many degrees of freedom.

    A single quantity has no correlation: its tie is zero.
    """
    if len(departures) < 2:
        return 0.0
    divisor = np.where(sd > 0, sd, 1.0)
    standardised = departures / divisor
    first = standardised[0].ravel()
    second = standardised[1].ravel()
    product = (first @ first) * (second @ second)
    # The Fisher transform atanh(rho) has the standard error 1/√(df - 3).
    if df <= 3.0 or product == 0.0:
        return 0.0
    correlation = abs(first @ second) / math.sqrt(product)
    transform = math.atanh(min(correlation, _LARGEST_CORRELATION))
    standard_error = 1.0 / math.sqrt(df - 3.0)
    nearer_zero = transform - _STANDARD_ERRORS * standard_error
    rho = math.tanh(max(nearer_zero, 0.0))
    return rho * rho
