"""Rough likelihoods of log SDs: normal, cell by cell, for coordinates to follow.

Each is N(log sigma; mean, 1/weight). It does not enter the posterior. Arrays have the shape (P, J):
P quantities by J cells.

A scatter sd² with df degrees of freedom has the mean sigma² + noise, where noise is the variance
that trials give to cell means. About some log sigma its log likelihood is normal, with

    share = sigma² / (sigma² + noise)             the part of the scatter's mean that is sigma²
    excess = sd² / (sigma² + noise) - 1           the scatter over its mean, less one
    weight = 2 df share²
    mean = log sigma + excess / (2 share)

It is taken at the mode that all cells have together under a typical prior: where noise explains
most of a cell's scatter, the mode of the cell by itself is chance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.cell_scatter import CellScatter, cell_scatter
from percept.inference.model.statistics import Statistics

__all__ = ["RoughSpreads", "rough_between", "rough_trial"]

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
#: Least share by which is divided. Cells with so small a share have no weight.
_LEAST_SHARE = 1e-300


class RoughSpreads(NamedTuple):
    """Rough likelihood of log SDs, each quantity by itself."""

    mean: Array  # (P, J) Zero where the weight is
    weight: Array  # (P, J) Inverse variance; zero where the data say next to nothing


class _Expansion(NamedTuple):
    """The likelihood of log sigma about some value, (P, J) each."""

    share: Array
    excess: Array
    weight: Array


def rough_between(
    statistics: Statistics,
    loadings: Array,
    centre: float,
    single_sd: float,
    *,
    subject_effect: bool,
) -> RoughSpreads:
    """Return a rough likelihood of the log SDs between subjects, at the cells' common mode.

    Parameters
    ----------
    statistics : Statistics
        Scatter between subjects and between trials.
    loadings : ndarray
        Columns of log sigma's trend, times the prior SDs of their coefficients, (P, K, J).
    centre : float
        Prior mean of log sigma.
    single_sd : float
        Prior SD of log sigma where there is a single cell.
    subject_effect : bool
        Whether subjects' means over cells have a variance of their own.
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
