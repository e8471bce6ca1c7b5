"""Covariates of trials or subjects: what they add to the sufficient statistics of a study.

Covariates x and responses y of the subjects of one pattern have cell means. Their scatter about the
pattern's mean enters by a triangle: with [x y] the centred means of all subjects,

    [x y] = Q R,  so that  [x y]'[x y] = R'R

and the rows of R hold all that the density needs of any number of subjects.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Pattern, Statistics
from percept.inference.hierarchy.trial_scatter import TrialScatter

__all__ = ["Covariates", "with_covariates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """What M covariates say between subjects. Within cells, `TrialScatter` holds them."""

    names: tuple[str, ...]
    mean: Array  # (M, C, G) Means over a pattern's subjects, zero where there is no cell
    between: tuple[Array, ...]  # (n, M, E) Rows of each pattern that go with those of responses


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
        Those of the responses alone.
    scatter : TrialScatter
        Scatter of covariates and responses within cells, subjects pooled.

    Returns
    -------
    Statistics
        Rows of scatter between subjects go with those of the covariates. The scatter between
        trials leaves out what the covariates explain within cells.
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
        covariate_rows, joined = _joined(pattern, of_covariates, of_responses)
        between.append(covariate_rows)
        patterns.append(joined)
    # As many covariates as degrees of freedom explain all scatter: what is left is rounding.
    informed = scatter.df > len(names)
    trial_rows = np.zeros_like(statistics.trial_rows)
    trial_rows[..., scatter.cell[informed]] = scatter.rows[..., informed]
    reduced = dataclasses.replace(statistics, patterns=tuple(patterns), trial_rows=trial_rows)
    return reduced, Covariates(names, mean, tuple(between))


def _cell_means(
    covariates: Array, subject: Indices, cell: Indices, shape: tuple[int, int]
) -> Array:
    """Means of covariates (trials, M) by subject and cell, (N, M, C); zero without trials."""
    subjects, cells = shape
    number = subject * cells + cell
    trials = np.bincount(number, minlength=subjects * cells)
    means = []
    for values in covariates.T:
        sums = np.bincount(number, weights=values, minlength=len(trials))
        of_cells = sums / np.maximum(trials, 1)
        means.append(of_cells.reshape(subjects, cells))
    return np.stack(means, axis=1)


def _joined(pattern: Pattern, covariates: Array, responses: Array) -> tuple[Array, Pattern]:
    """Rows of covariates (n, M, E), and a pattern whose rows of responses go with them."""
    count = covariates.shape[1]
    joint = np.concatenate([covariates, responses], axis=1)
    centred = joint - joint.mean(axis=0)
    triangle = np.asarray(np.linalg.qr(centred.reshape(len(joint), -1), mode="r"))
    rows = triangle.reshape(-1, *joint.shape[1:])
    response_rows = np.ascontiguousarray(rows[:, count:].transpose(1, 0, 2))
    return rows[:, :count], dataclasses.replace(pattern, rows=response_rows)
