"""Statistics in which every subject is a pattern: trial SDs of their own, and covariates.

Arrays have N subjects, P quantities, C cells, T groups of trials, and M covariates.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import (
    Covariates,
    Statistics,
    counts_of,
    group_means,
    patterns_of,
    trial_scatter,
    triangles_of,
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
    _, subject, cell = trials
    counts, _, _ = counts_of(subject, cell, len(statistics.environments))
    patterns = patterns_of(counts, statistics.cell_means, np.arange(len(counts)))
    apart = dataclasses.replace(statistics, patterns=patterns)
    if own_trial_sds:
        apart = dataclasses.replace(apart, scatter=trial_scatter(*trials))
    if values is None:
        return apart
    return _with_covariates(apart, trials, covariates, values)


def _with_covariates(
    statistics: Statistics,
    trials: tuple[Array, Indices, Indices],
    names: tuple[str, ...],
    values: Array,
) -> Statistics:
    """Join covariates (trials, M) to statistics in which every subject is a pattern."""
    response, subject, cell = trials
    cells = len(statistics.environments)
    _, first, group = counts_of(subject, cell, cells)
    varies = _varies(values, subject)
    values = np.where(varies, values - group_means(values, subject)[subject], values)
    means = np.zeros((len(names), len(statistics.subjects), cells))
    means[:, subject[first], cell[first]] = group_means(values, group).T
    # Of these covariates trials depart from the mean of their cell.
    varies_in_cell = _varies(values, group)
    varying = int(varies_in_cell.sum())
    numbers = np.hstack([values[:, varies_in_cell], response])
    departures = numbers - group_means(numbers, group)[group]
    triangles = triangles_of(departures, group, len(first))
    rows = triangles[:, :varying].reshape(-1, departures.shape[1])
    informed = rows.any(axis=1)
    row_values = np.zeros((len(names), len(rows)))
    row_values[varies_in_cell] = rows[:, :varying].T
    of_covariates = Covariates(
        names=names,
        within=tuple(name for name, is_within in zip(names, varies, strict=True) if is_within),
        mean=means,
        row_subject=np.repeat(subject[first], varying)[informed],
        row_cell=np.repeat(cell[first], varying)[informed],
        row_values=row_values[:, informed],
        row_responses=rows[informed, varying:].T,
    )
    unexplained = triangles[:, varying:, varying:]
    quantities = response.shape[1]
    scatter = statistics.scatter
    if scatter.subject is None:
        by_cell = np.repeat(cell[first], quantities)
        unexplained = triangles_of(unexplained.reshape(-1, quantities), by_cell, cells)
        group = cell
    of_responses = departures[:, varying:]
    about_slopes = _about_own_slopes(departures[:, :varying], of_responses, subject, cell)
    by_quantity = np.square(about_slopes).T
    squares = [np.bincount(group, weights=column) for column in by_quantity]
    # As many slopes as degrees of freedom leave rounding alone.
    is_informed = statistics.trial_df[scatter.cell] > varying
    scatter = dataclasses.replace(
        scatter,
        rows=unexplained.transpose(2, 1, 0),
        squares=np.where(is_informed, squares, 0.0),
    )
    return dataclasses.replace(statistics, scatter=scatter, covariates=of_covariates)


def _about_own_slopes(
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
            of_subject = responses[is_subject]
            columns = values[is_subject]
            slopes, *_ = np.linalg.lstsq(columns, of_subject, rcond=None)
            unexplained[is_subject] = of_subject - columns @ slopes
    return unexplained


def _varies(values: Array, group: Indices) -> NDArray[np.bool_]:
    """Whether a column of values (trials, M) varies within a group of trials, (M,)."""
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    of_first = values[first][number]
    return np.asarray((values != of_first).any(axis=0))
