"""Scatter between trials: pooled over subjects, or of every subject by itself."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["TrialScatter", "trial_scatter"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class TrialScatter:
    """Scatter between trials in T groups: the cells, or the cells of every subject.

    The rows of a group are those of the triangle of its trials, covariates first: their products
    with themselves sum to its scatter.
    """

    cell: Indices  # (T,) Cell of each group
    subject: Indices | None  # (T,) Subject of each group; None where subjects are pooled
    df: Array  # (T,) Degrees of freedom
    rows: Array  # (P, P, T) Rows of responses, less what covariates explain
    covariate_rows: Array  # (M, M, T) Rows of covariates
    response_rows: Array  # (M, P, T) Responses in the rows of covariates

    def squares(self) -> Array:
        """Return the sums of squares of the responses about their means, (P, T)."""
        explained = (self.response_rows**2).sum(axis=0)
        return np.asarray((self.rows**2).sum(axis=1) + explained)


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
    size = response.shape[1]
    count = covariates.shape[1]
    values = np.hstack([covariates, response])
    of_subject = subject * (int(cell.max()) + 1) + cell
    _, number, trials = np.unique(of_subject, return_inverse=True, return_counts=True)
    departures = values - _means(values, number, trials)[number]
    group = of_subject if by_subject else cell
    first = np.unique(group, return_index=True)[1]
    groups = [np.flatnonzero(group == group[trial]) for trial in first]
    triangles = np.zeros((len(groups), count + size, count + size))
    for t, members in enumerate(groups):
        triangle = np.linalg.qr(departures[members], mode="r")
        triangles[t, : len(triangle)] = triangle
    # Each subject's cell mean takes one degree of freedom.
    subjects_of_group = [len(np.unique(subject[members])) for members in groups]
    lengths = np.array([len(members) for members in groups], dtype=float)
    by_group = np.moveaxis(triangles, 0, -1)
    return TrialScatter(
        cell=cell[first],
        subject=subject[first] if by_subject else None,
        df=lengths - np.array(subjects_of_group),
        rows=np.ascontiguousarray(by_group[count:, count:].swapaxes(0, 1)),
        covariate_rows=np.ascontiguousarray(by_group[:count, :count]),
        response_rows=np.ascontiguousarray(by_group[:count, count:]),
    )


def _means(values: Array, number: Indices, trials: NDArray[np.intp]) -> Array:
    """Means of the rows with the same number, in two passes: rounding must not reach scatter."""
    sums = np.zeros((len(trials), values.shape[1]))
    np.add.at(sums, number, values)
    means = sums / trials[:, None]
    remainders = np.zeros_like(sums)
    np.add.at(remainders, number, values - means[number])
    return np.asarray(means + remainders / trials[:, None])
