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

All of it shapes coordinates alone and does not enter the posterior. Arrays have the shape (P, C):
P quantities by C cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]

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
#: Least degrees of freedom, of all subjects in a cell, that are more than rounding.
_LEAST_DF = 1e-9
#: Least share by which is divided. Cells with so small a share have no weight.
_LEAST_SHARE = 1e-300


class RoughLikelihood(NamedTuple):
    """Rough likelihood of the log SDs of P quantities in C cells."""

    mean: Array  # (P, C) Zero where the weight is
    weight: Array  # (P, C) Inverse variance; zero where the data say next to nothing


class _Expansion(NamedTuple):
    """The likelihood of log sigma about some value, (P, C) each."""

    share: Array
    excess: Array
    weight: Array


def likelihood_between(
    statistics: Statistics,
    loadings: Array,
    centre: float,
    single_sd: float,
    *,
    subject_columns: Array,
) -> RoughLikelihood:
    """Rough likelihood of the log SDs between subjects, at the cells' common mode.

    Parameters
    ----------
    statistics : Statistics
        Of the responses.
    loadings : ndarray
        Columns of log sigma times the prior SDs of their coefficients, (P, K, C).
    centre : float
        Prior mean of log sigma.
    single_sd : float
        Prior SD of log sigma where there is a single cell.
    subject_columns : ndarray
        Columns of which each subject has a coefficient, (q, P, C).
    """
    scatter = _cell_scatter(statistics, subject_columns=subject_columns)
    cells = scatter.sd.shape[1]
    omega = _TYPICAL_OMEGA if cells > 1 else single_sd
    identity = np.eye(cells)
    column_covariance = np.swapaxes(loadings, 1, 2) @ loadings
    precision = np.linalg.inv(column_covariance + omega**2 * identity)  # (P, C, C)
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
    return RoughLikelihood(
        mean=np.where(followed, log_sigma + step_of_data, 0.0),
        weight=np.where(followed, expansion.weight, 0.0),
    )


def _expansion(scatter: _CellScatter, log_sigma: Array) -> _Expansion:
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


def likelihood_of_trials(statistics: Statistics) -> RoughLikelihood:
    """Rough likelihood of the log SDs between trials: their scatter has no noise."""
    squares = (statistics.trial_rows**2).sum(axis=1)
    df = statistics.trial_df
    sd = np.sqrt(squares / np.maximum(df, 1))
    return RoughLikelihood(
        mean=np.log(np.where(sd > 0, sd, 1.0)),
        weight=np.where(sd > 0, 2.0 * df, 0.0),
    )


class _CellScatter(NamedTuple):
    """Scatter of subjects' means in each cell: sd² has the mean sigma² + noise."""

    sd: Array  # (P, C) SD of the means, zero where there is none
    df: Array  # (P, C) Its degrees of freedom
    noise: Array  # (P, C) Variance that the scatter of trials gives to a mean; zero without repeats


def _cell_scatter(
    statistics: Statistics,
    *,
    subject_columns: Array,
) -> _CellScatter:
    """Scatter between subjects, less what their own coefficients of columns explain."""
    noise = _noise_of_trials(statistics)
    sd = statistics.sd
    df = statistics.df
    if len(subject_columns):
        # Scatter of these coefficients says nothing of sigma.
        sd_within, df_within = _within_subjects(statistics, subject_columns)
        has_scatter = sd_within > 0
        smaller = has_scatter & (sd_within < sd)
        sd = np.where(smaller, sd_within, sd)
        df = np.where(smaller, df_within, df)
    return _CellScatter(sd, df, noise)


def _within_subjects(statistics: Statistics, subject_columns: Array) -> tuple[Array, Array]:
    """SD of subjects' cell means about the cells and about subjects' lines, and its df.

    Each subject has a coefficient of every column (q, P, C). Fitting it takes degrees of freedom
    from the cells on which the fit leans. The mean of a cell takes one from its subjects.
    """
    cell_means = statistics.cell_means
    about_cells = cell_means - np.nanmean(cell_means, axis=0)
    squares = np.zeros(cell_means.shape[1:])
    df = np.zeros_like(squares)
    subjects = np.zeros(len(squares.T))
    for pattern in statistics.patterns:
        cells = pattern.environments
        subjects[cells] += pattern.subjects
        for p, values in enumerate(about_cells[pattern.members][:, :, cells].swapaxes(0, 1)):
            columns = subject_columns[:, p, cells]
            fitted = np.linalg.pinv(columns) @ columns
            residuals = values - values @ fitted
            squares[p, cells] += np.square(residuals).sum(axis=0)
            df[p, cells] += pattern.subjects * (1.0 - np.diag(fitted))
    df *= 1.0 - 1.0 / subjects
    # A subject with as many columns as cells has no scatter left, but for rounding.
    df[df < _LEAST_DF] = 0.0
    zeros = np.zeros_like(df)
    variance = np.divide(squares, df, out=zeros, where=df > 0)
    return np.sqrt(variance), df


def _noise_of_trials(statistics: Statistics) -> Array:
    """Variance that trials give to a cell's mean, averaged over the subjects of the cell."""
    df = statistics.trial_df
    squares = np.square(statistics.trial_rows).sum(axis=1)
    all_squares = squares.sum(axis=1, keepdims=True)
    # An environment without repeats takes the variance that the others have together.
    pooled = all_squares / max(df.sum(), 1.0)
    by_cell = squares / np.maximum(df, 1.0)
    variance = np.where(df > 0, by_cell, pooled)
    subjects = np.zeros(df.size)
    inverse_trials = np.zeros(df.size)
    for pattern in statistics.patterns:
        subjects[pattern.environments] += pattern.subjects
        inverse_trials[pattern.environments] += pattern.subjects / pattern.trials
    return variance * inverse_trials / subjects
