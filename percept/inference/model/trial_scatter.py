"""Scatter between trials: pooled over subjects, or of every subject by itself.

A trial is a row of M covariates x and P responses y. Its departure is what it differs by from the
mean of its subject in its cell. The departures of a group of trials form a matrix D, whose triangle
R, D = QR, holds all that a density needs of any number of trials, since R'R = D'D:

    R = [[covariate rows, response rows],        M rows
         [0             , rows          ]]       P rows
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["TrialScatter", "trial_scatter"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class TrialScatter:
    """Scatter between trials in T groups: the cells, or the cells of every subject."""

    cell: Indices  # (T,) Cell of each group
    subject: Indices | None  # (T,) Subject of each group; None where subjects are pooled
    df: Array  # (T,) Degrees of freedom
    rows: Array  # (P, P, T) Rows of responses, less what covariates explain, as [quantity, row]
    covariate_rows: Array  # (M, M, T) Rows of covariates, as [row, covariate]
    response_rows: Array  # (M, P, T) Responses in the rows of covariates, as [row, quantity]

    def squares(self) -> Array:
        """Return the sums of squares of the responses about their means, (P, T)."""
        explained = (self.response_rows**2).sum(axis=0)
        unexplained = (self.rows**2).sum(axis=1)
        return np.asarray(unexplained + explained)


def trial_scatter(
    response: Array,
    subject: Indices,
    cell: Indices,
    covariates: Array,
    *,
    by_subject: bool,
) -> TrialScatter:
    """Reduce trials to their scatter within cells of subjects.

    Parameters
    ----------
    response : ndarray
        One row per trial, on the response scale, shape (trials, P).
    subject, cell : ndarray of int
        Number of the subject and of the cell of each trial, shape (trials,).
    covariates : ndarray
        Values of every trial, shape (trials, M).
    by_subject : bool
        Keep the subjects apart.

    Returns
    -------
    TrialScatter
    """
    count = covariates.shape[1]
    values = np.hstack([covariates, response])
    cells = int(cell.max()) + 1
    subject_cell = subject * cells + cell
    departures = _departures(values, subject_cell)
    group = subject_cell if by_subject else cell
    _, first_trials = np.unique(group, return_index=True)
    # With fewer trials than columns the triangle's last rows are zero.
    size = values.shape[1]
    triangles = np.zeros((len(first_trials), size, size))
    df = np.zeros(len(first_trials))
    for t, first_trial in enumerate(first_trials):
        members = np.flatnonzero(group == group[first_trial])
        triangle = np.linalg.qr(departures[members], mode="r")
        triangles[t, : len(triangle)] = triangle
        # Each subject's cell mean takes one degree of freedom.
        subjects = len(np.unique(subject[members]))
        df[t] = len(members) - subjects
    groups_last = np.moveaxis(triangles, 0, -1)
    rows = groups_last[count:, count:].swapaxes(0, 1)
    return TrialScatter(
        cell=cell[first_trials],
        subject=subject[first_trials] if by_subject else None,
        df=df,
        rows=np.ascontiguousarray(rows),
        covariate_rows=np.ascontiguousarray(groups_last[:count, :count]),
        response_rows=np.ascontiguousarray(groups_last[:count, count:]),
    )


def _departures(values: Array, label: Indices) -> Array:
    """Values (trials, columns) less the mean of the trials with the same label."""
    _, number, counts = np.unique(label, return_inverse=True, return_counts=True)
    trials = counts[:, None]
    means = _sums(values, number, len(counts)) / trials
    # A second pass: rounding of the means must not reach the scatter.
    corrections = _sums(values - means[number], number, len(counts)) / trials
    corrected = means + corrections
    return np.asarray(values - corrected[number])


def _sums(values: Array, number: Indices, count: int) -> Array:
    """Sum the rows with the same number, (count, columns)."""
    sums = np.zeros((count, values.shape[1]))
    np.add.at(sums, number, values)
    return sums
