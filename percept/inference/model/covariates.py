"""Covariates of trials or subjects: what they add to the sufficient statistics of a study.

The subjects of a pattern have cell means of M covariates x and of P responses y. Side by side, less
their means over the n subjects, they form a matrix [x y] with a row for each subject, and its
triangle holds all that the density needs of any number of subjects:

    [x y] = Q R,  so that  [x y]'[x y] = R'R

Shapes: N subjects, C cells, G patterns, E cells in a pattern.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics
from percept.inference.model.trial_scatter import TrialScatter

__all__ = ["Covariates", "with_covariates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """What M covariates say between subjects. Within cells, `TrialScatter` holds them."""

    names: tuple[str, ...]
    mean: Array  # (M, C, G) Means over a pattern's subjects, zero where there is no cell
    between: tuple[Array, ...]  # (rows, M, E) By pattern: x in the rows of R, as `Pattern.rows` y


@dataclasses.dataclass(frozen=True, eq=False)
class _JointScatter:
    """Scatter of one pattern's subjects, as the rows of R."""

    covariate_rows: Array  # (rows, M, E)
    response_rows: Array  # (P, rows, E)


def with_covariates(
    covariates: Array,
    subject: Indices,
    cell: Indices,
    names: tuple[str, ...],
    statistics: Statistics,
    scatter: TrialScatter,
) -> tuple[Statistics, Covariates]:
    """Join covariates to the statistics of the responses.

    Parameters
    ----------
    covariates : ndarray
        Values of every trial, centred, shape (trials, M).
    subject, cell : ndarray
        Number of the subject and of the cell of each trial, shape (trials,).
    names : tuple of str
        Names of the covariates.
    statistics : Statistics
        Statistics of the responses alone.
    scatter : TrialScatter
        Scatter of covariates and responses within cells, subjects pooled.

    Returns
    -------
    Statistics
        Each row of scatter between subjects pairs with the same row of the covariates' scatter.
        The scatter between trials leaves out what the covariates explain within cells.
    Covariates
    """
    subjects = len(statistics.subjects)
    cells = len(statistics.environments)
    covariate_means = _cell_means(covariates, subject, cell, (subjects, cells))
    patterns = []
    between = []
    mean = np.zeros((len(names), cells, len(statistics.patterns)))
    for g, pattern in enumerate(statistics.patterns):
        present = pattern.environments
        of_covariates = covariate_means[pattern.members][:, :, present]  # (n, M, E)
        of_responses = statistics.cell_means[pattern.members][:, :, present]  # (n, P, E)
        mean[:, present, g] = of_covariates.mean(axis=0)
        joint = _joint_scatter(of_covariates, of_responses)
        between.append(joint.covariate_rows)
        patterns.append(dataclasses.replace(pattern, rows=joint.response_rows))
    reduced = dataclasses.replace(
        statistics,
        patterns=tuple(patterns),
        trial_rows=_unexplained_rows(statistics, scatter, len(names)),
    )
    return reduced, Covariates(names, mean, tuple(between))


def _cell_means(
    covariates: Array,
    subject: Indices,
    cell: Indices,
    shape: tuple[int, int],
) -> Array:
    """Means of covariates (trials, M) by subject and cell, (N, M, C); zero without trials."""
    subjects, cells = shape
    subject_cell = subject * cells + cell
    trials = np.bincount(subject_cell, minlength=subjects * cells)
    means = []
    for values in covariates.T:
        sums = np.bincount(subject_cell, weights=values, minlength=len(trials))
        of_cells = sums / np.maximum(trials, 1)
        means.append(of_cells.reshape(subjects, cells))
    return np.stack(means, axis=1)


def _joint_scatter(covariates: Array, responses: Array) -> _JointScatter:
    """Scatter of cell means of covariates (n, M, E) and responses (n, P, E)."""
    count = covariates.shape[1]
    joint = np.concatenate([covariates, responses], axis=1)
    centred = joint - joint.mean(axis=0)
    by_subject = centred.reshape(len(joint), -1)
    triangle = np.asarray(np.linalg.qr(by_subject, mode="r"))
    rows = triangle.reshape(-1, *joint.shape[1:])
    response_rows = rows[:, count:].swapaxes(0, 1)
    return _JointScatter(rows[:, :count], np.ascontiguousarray(response_rows))


def _unexplained_rows(statistics: Statistics, scatter: TrialScatter, covariates: int) -> Array:
    """Scatter between trials that the covariates leave, (P, P, C)."""
    # As many covariates as degrees of freedom explain all scatter: the rest is rounding.
    informed = scatter.df > covariates
    rows = np.zeros_like(statistics.trial_rows)
    rows[..., scatter.cell[informed]] = scatter.rows[..., informed]
    return rows
