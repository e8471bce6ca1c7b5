"""Statistics in which every subject is a pattern: trial SDs of their own, and covariates.

Arrays have N subjects, P quantities, C cells, T groups of trials, and M covariates.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import (
    Covariates,
    Pattern,
    Statistics,
    TrialScatter,
    group_means,
    triangle,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def by_subject(
    statistics: Statistics,
    trials: tuple[Array, Indices, Indices],
    *,
    own_trial_sds: bool,
    covariates: tuple[str, ...] = (),
    values: Array | None = None,
) -> Statistics:
    """Make every subject a pattern, for trial SDs of their own or for covariates.

    Parameters
    ----------
    statistics : Statistics
        Of the same trials.
    trials : tuple of ndarray
        Responses (trials, P), and the subject and the cell of each trial, (trials,).
    own_trial_sds : bool
        Whether each subject has trial SDs of its own.
    covariates : tuple of str
        Names of the covariates.
    values : ndarray, optional
        Covariates of every trial, centred, shape (trials, M). Those that vary within subjects are
        centred within them: slopes of their own then leave the subjects' effects alone.

    Returns
    -------
    Statistics
        Its scatter between trials is less what the covariates explain.
    """
    by_pattern = dataclasses.replace(statistics, patterns=tuple(_patterns_by_subject(statistics)))
    if own_trial_sds:
        by_pattern = dataclasses.replace(by_pattern, scatter=trial_scatter(*trials))
    if values is None:
        return by_pattern
    return _with_covariates(by_pattern, trials, covariates, values)


def trial_scatter(
    response: Array,
    subject: Indices,
    cell: Indices,
) -> TrialScatter:
    """Reduce trials to their scatter in the cells of every subject.

    Parameters
    ----------
    response : ndarray
        One row per trial, on the response scale, shape (trials, P).
    subject, cell : ndarray of int
        Number of the subject and of the cell of each trial, shape (trials,).

    Returns
    -------
    TrialScatter
    """
    group = subject * (cell.max() + 1) + cell
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    triangles = _triangles(_departures(response, group), number, len(first))
    return TrialScatter(
        cell=cell[first],
        subject=subject[first],
        df=np.bincount(number).astype(float) - 1.0,
        rows=np.ascontiguousarray(triangles.transpose(2, 1, 0)),
        squares=np.square(triangles).sum(axis=1).T,
    )


def _patterns_by_subject(statistics: Statistics) -> list[Pattern]:
    """Give every subject a pattern of its own."""
    patterns = []
    for pattern in statistics.patterns:
        for member in pattern.members:
            mean = statistics.cell_means[member][:, pattern.environments]
            no_rows = np.zeros((len(mean), 0, pattern.environments.size))
            of_member = dataclasses.replace(
                pattern, members=np.array([member]), mean=mean, rows=no_rows
            )
            patterns.append(of_member)
    return patterns


def _with_covariates(
    statistics: Statistics,
    trials: tuple[Array, Indices, Indices],
    names: tuple[str, ...],
    values: Array,
) -> Statistics:
    """Join covariates (trials, M) to statistics in which every subject is a pattern."""
    response, subject, cell = trials
    cells = len(statistics.environments)
    group = subject * cells + cell
    varies = _varies(values, subject)
    means_of_subjects = group_means(values, subject, len(statistics.subjects))
    values = np.where(varies, values - means_of_subjects[subject], values)
    means = np.zeros((len(names), len(statistics.subjects), cells))
    means[:, subject, cell] = group_means(values, group, group.max() + 1)[group].T
    # Of these covariates trials depart from the mean of their cell.
    varies_in_cell = _varies(values, group)
    varying = int(varies_in_cell.sum())
    departures = _departures(np.hstack([values[:, varies_in_cell], response]), group)
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    triangles = _triangles(departures, number, len(first))
    rows = triangles[:, :varying].reshape(-1, departures.shape[1])
    informed = rows.any(axis=1)
    row_values = np.zeros((len(names), len(rows)))
    row_values[varies_in_cell] = rows[:, :varying].T
    covariates = Covariates(
        names=names,
        within=tuple(name for name, is_within in zip(names, varies, strict=True) if is_within),
        mean=means,
        row_subject=np.repeat(subject[first], varying)[informed],
        row_cell=np.repeat(cell[first], varying)[informed],
        row_values=row_values[:, informed],
        row_responses=rows[informed, varying:].T,
    )
    unexplained = triangles[:, varying:, varying:]
    if statistics.scatter.subject is None:
        quantities = response.shape[1]
        unexplained = _triangles(
            unexplained.reshape(-1, quantities), np.repeat(cell[first], quantities), cells
        )
    scatter = dataclasses.replace(statistics.scatter, rows=unexplained.transpose(2, 1, 0))
    about_slopes = _without_own_slopes(
        departures[:, :varying], departures[:, varying:], subject, cell
    )
    trial_rows = _triangles(about_slopes, cell, cells).transpose(2, 1, 0)
    # As many slopes as degrees of freedom leave rounding alone.
    trial_rows[..., statistics.trial_df <= varying] = 0.0
    return dataclasses.replace(
        statistics, scatter=scatter, trial_rows=trial_rows, covariates=covariates
    )


def _without_own_slopes(
    values: Array,
    responses: Array,
    subject: Indices,
    cell: Indices,
) -> Array:
    """Departures of responses (trials, P) less what slopes of each subject explain of them."""
    unexplained = np.zeros_like(responses)
    for i in np.unique(subject):
        is_subject = subject == i
        df = is_subject.sum() - len(np.unique(cell[is_subject]))
        # As many covariates as degrees of freedom explain all scatter: the rest is rounding.
        if df > values.shape[1]:
            slopes, *_ = np.linalg.lstsq(values[is_subject], responses[is_subject], rcond=None)
            unexplained[is_subject] = responses[is_subject] - values[is_subject] @ slopes
    return unexplained


def _varies(values: Array, group: Indices) -> NDArray[np.bool_]:
    """Whether a column of values (trials, M) varies within a group of trials, (M,)."""
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    return np.asarray((values != values[first][number]).any(axis=0))


def _departures(values: Array, group: Indices) -> Array:
    """Values (trials, columns) less the mean of each trial's group."""
    return values - group_means(values, group, group.max() + 1)[group]


def _triangles(
    rows: Array,
    group: Indices,
    groups: int,
) -> Array:
    """Triangles (groups, K, K) of the rows (n, K) of each group."""
    return np.stack([triangle(rows[group == number]) for number in range(groups)])
