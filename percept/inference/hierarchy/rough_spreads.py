"""Rough likelihoods of log SDs, and the correlation of two quantities' rough log SDs.

Each is normal, N(log sigma; mean, 1/weight), for each cell. Coordinates follow it, as `spreads` and
`log_linear` say. It does not enter the posterior.

A scatter sd² with df degrees of freedom has the mean sigma² + noise, where noise is the variance
that trials give to cell means. With share = sigma² / (sigma² + noise), the log likelihood has

    weight = 2 df share²
    mean = log sigma + excess / (2 share),  excess = sd²/(sigma² + noise) - 1

at the mode of log sigma under a typical prior.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Statistics

__all__ = [
    "rough_between",
    "rough_trial",
    "tie_between",
    "tie_trial",
]

Array = NDArray[np.float64]
#: Least share of a cell's scatter by which is divided.
_TINY = 1e-300
#: Largest correlation of k and b that coordinates follow.
_MOST_TIED = 0.9999
#: SD of log sigma about its trend, under which the mode is sought.
_TYPICAL_OMEGA = 0.5
#: Newton steps towards the mode.
_ROUGH_STEPS = 40
#: Longest Newton step of log sigma: far from the mode the curvature is wrong.
_LONGEST_STEP = 1.0
#: Cells that say less than this of log sigma, against a prior's 1, are left to the prior.
_LEAST_WEIGHT = 0.1
#: Standard errors by which a correlation is drawn towards zero.
_CAUTION = 2.0


def rough_between(
    statistics: Statistics, loadings: Array, centre: float, own_sd: float, *, subject_effect: bool
) -> tuple[Array, Array]:
    """Return a normal likelihood of log SDs between subjects, taken at the cells' common mode.

    Where noise explains most of a cell's scatter, the mode of the cell by itself is chance.

    Parameters
    ----------
    statistics : Statistics
        Scatter between subjects and between trials.
    loadings : ndarray
        Columns of log sigma's trend, times the prior SDs of their coefficients, (P, K, J).
    centre : float
        Prior mean of log sigma.
    own_sd : float
        Prior SD of log sigma where there is a single cell.
    subject_effect : bool
        Whether subjects' means over cells have a variance of their own.

    Returns
    -------
    mean, weight : ndarray
        Shape (P, J) each; zero where the data say next to nothing.
    """
    sd = statistics.sd
    df = statistics.df
    noise = _trial_variance(statistics)
    if subject_effect:
        sd_within, df_within = _within_subjects(statistics.cell_means)
        # Scatter of subjects' means over cells says nothing of sigma.
        smaller = (sd_within > 0) & (sd_within < sd)
        sd = np.where(smaller, sd_within, sd)
        df = np.where(smaller, df_within, df)
    informed = sd > 0
    identity = np.eye(sd.shape[1])
    prior_sd = _TYPICAL_OMEGA if sd.shape[1] > 1 else own_sd
    trend_covariance = np.swapaxes(loadings, 1, 2) @ loadings
    precision = np.linalg.inv(trend_covariance + prior_sd**2 * identity)
    log_sigma = np.full(sd.shape, centre)
    for _ in range(_ROUGH_STEPS):
        inverse_variance = np.exp(-2.0 * log_sigma)
        # The part of the scatter's mean that is sigma².
        share = 1.0 / (1.0 + noise * inverse_variance)
        weight = np.where(informed, 2.0 * df * share * share, 0.0)
        excess = np.where(informed, sd * sd * share * inverse_variance - 1.0, 0.0)
        departure = (log_sigma - centre)[..., None]
        prior_score = precision @ departure
        score = df * share * excess - prior_score[..., 0]
        curvature = precision + weight[..., None] * identity
        step = np.linalg.solve(curvature, score[..., None])[..., 0]
        log_sigma = log_sigma + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    # From the mode under the prior to the mean of the likelihood alone.
    step_of_data = np.where(share > 0, 0.5 * excess / np.maximum(share, _TINY), 0.0)
    heavy = weight > _LEAST_WEIGHT
    mean = np.where(heavy, log_sigma + step_of_data, 0.0)
    return mean, np.where(heavy, weight, 0.0)


def rough_trial(statistics: Statistics) -> tuple[Array, Array]:
    """Return a normal likelihood of the log SD between trials, mean and weight (P, J)."""
    squares = (statistics.trial_rows**2).sum(axis=1)
    df = np.broadcast_to(statistics.trial_df, squares.shape)
    sd = np.sqrt(squares / np.maximum(df, 1))
    mean = np.log(np.where(sd > 0, sd, 1.0))
    weight = np.where(sd > 0, 2.0 * df, 0.0)
    return mean, weight


def tie_between(statistics: Statistics, *, subject_effect: bool) -> float:
    """Correlation of the rough log SDs of k and b, by departures of subjects' cell means."""
    means = statistics.cell_means
    complete = np.asarray(np.isfinite(means).all(axis=1, keepdims=True))
    departures = _centred(means, complete, 2) if subject_effect else means
    departures = _centred(departures, complete, 0)
    # Each environment weighs by its degrees of freedom, whatever its spread.
    squares = np.square(departures).sum(axis=0)
    sd = np.sqrt(squares / np.maximum(complete.sum(axis=0) - 1.0, 1.0))
    df = statistics.df.min(axis=0).sum()
    return _tie(np.moveaxis(departures, 1, 0), sd[:, None], float(df))


def tie_trial(statistics: Statistics) -> float:
    """Correlation of the rough log SDs of k and b between trials."""
    rows = statistics.trial_rows
    df = statistics.trial_df
    squares = np.square(rows).sum(axis=1, keepdims=True)
    sd = np.sqrt(squares / np.maximum(df, 1.0))
    return _tie(rows, sd, float(df.sum()))


def _tie(departures: Array, sd: Array, df: float) -> float:
    """Squared correlation of k and b, two standard errors of its Fisher transform nearer zero.

    Log SDs of samples of pairs with correlation rho are correlated by rho². Departures (P, ...) are
    taken in units of their SD. A single quantity has no correlation: the tie is zero.
    """
    if len(departures) < 2:
        return 0.0
    standardised = departures / np.where(sd > 0, sd, 1.0)
    first, second = standardised.reshape(2, -1)
    product_of_lengths = math.sqrt(float(first @ first) * float(second @ second))
    # The standard error of the Fisher transform is 1/√(df - 3).
    if df <= 3.0 or product_of_lengths == 0.0:
        return 0.0
    correlation = abs(float(first @ second)) / product_of_lengths
    transform = math.atanh(min(correlation, _MOST_TIED))
    nearer_zero = transform - _CAUTION / math.sqrt(df - 3.0)
    return math.tanh(max(nearer_zero, 0.0)) ** 2


def _trial_variance(statistics: Statistics) -> Array:
    """Variance that trials' scatter gives to a cell's means, (P, J); zero without repeats."""
    df = statistics.trial_df
    squares = (statistics.trial_rows**2).sum(axis=1)
    # An environment without repeats takes the variance that the others have together.
    pooled = squares.sum(axis=1, keepdims=True) / max(df.sum(), 1.0)
    variance = np.where(df > 0, squares / np.maximum(df, 1.0), pooled)
    subjects = np.zeros(df.size)
    shares = np.zeros(df.size)
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
    about_cells = _centred(values, present, 0)
    residuals = _centred(about_cells, present, 2)
    subjects = present.sum(axis=0)
    cells_of_subject = present.sum(axis=2, keepdims=True)
    # Each subject's mean takes one degree of freedom, in equal parts from the subject's cells, and
    # each cell's mean takes one from its subjects.
    kept_by_subject = 1.0 - 1.0 / np.maximum(cells_of_subject, 1)
    kept = np.where(present, kept_by_subject, 0.0).sum(axis=0)
    df = np.maximum(kept * (1.0 - 1.0 / np.maximum(subjects, 1)), 0.0)
    squares = (residuals**2).sum(axis=0)
    sd = np.sqrt(squares / np.maximum(df, _TINY))
    return sd * (df > 0), df
