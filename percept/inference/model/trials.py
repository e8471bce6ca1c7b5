"""Scatter between trials, and what covariates of trials or subjects explain.

A trial's departure is what it differs by from the mean of its subject in its cell. The departures
of a group of trials form a matrix whose triangle R has the same products, so that R holds all that
a density needs of any number of trials. Arrays have N subjects, P quantities, C cells, T groups of
trials, and M covariates.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics, apart_by_subject

__all__ = ["Covariates", "TrialScatter", "trial_scatter", "with_covariates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class TrialScatter:
    """Scatter between trials in T groups: the cells, or the cells of every subject."""

    cell: Indices  # (T,) Cell of each group
    subject: Indices | None  # (T,) Subject of each group; None where subjects are pooled
    df: Array  # (T,) Degrees of freedom
    rows: Array  # (P, P, T) Rows of responses, less what covariates explain, as [quantity, row]
    squares: Array  # (P, T) Sums of squares of the responses about their means


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """Covariates of the subjects' cell means, and rows of trials that tell of slopes too."""

    names: tuple[str, ...]
    within: tuple[str, ...]  # Those that vary within subjects, who have slopes of their own
    mean: Array  # (M, N, C) Means of each subject's trials, zero where there is no cell
    row_subject: Indices  # (n,) Of n rows of trials about the mean of their cell
    row_cell: Indices  # (n,)
    row_values: Array  # (M, n) Of the covariates
    row_responses: Array  # (P, n)


def trial_scatter(
    response: Array,
    subject: Indices,
    cell: Indices,
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
    by_subject : bool
        Keep the subjects apart.

    Returns
    -------
    TrialScatter
    """
    departures = _departures(response, subject, cell)
    group = _subject_cell(subject, cell) if by_subject else cell
    first, triangles = _triangles(departures, group)
    df = np.bincount(np.unique(group, return_inverse=True)[1]).astype(float)
    # Each subject's cell mean takes one degree of freedom.
    pairs = np.unique(np.stack([group, subject]), axis=1)
    df -= np.unique(pairs[0], return_counts=True)[1]
    return TrialScatter(
        cell=cell[first],
        subject=subject[first] if by_subject else None,
        df=df,
        rows=np.ascontiguousarray(triangles.transpose(2, 1, 0)),
        squares=np.square(triangles).sum(axis=1).T,
    )


def with_covariates(
    values: Array,
    names: tuple[str, ...],
    trials: tuple[Array, Indices, Indices],
    statistics: Statistics,
    *,
    by_subject: bool,
) -> tuple[Statistics, TrialScatter, Covariates]:
    """Join covariates to the statistics of the responses.

    Parameters
    ----------
    values : ndarray
        Covariates of every trial, centred, shape (trials, M). Those that vary within subjects are
        centred within them: slopes of their own then leave the subjects' effects alone.
    names : tuple of str
        Names of the covariates.
    trials : tuple of ndarray
        Responses (trials, P), and the subject and the cell of each trial, (trials,).
    statistics : Statistics
        Statistics of the responses alone.
    by_subject : bool
        Whether each subject has trial SDs of its own.

    Returns
    -------
    Statistics
        Each subject is a pattern.
    TrialScatter
        Without what the covariates explain within cells.
    Covariates
    """
    response, subject, cell = trials
    count = len(names)
    within = _varying(values, subject)
    values = values.copy()
    values[:, within] -= _group_means(values, subject)[:, within]
    group = _subject_cell(subject, cell)
    means = np.zeros((count, len(statistics.subjects), len(statistics.environments)))
    means[:, subject, cell] = _group_means(values, group).T
    inside = values[:, _varying(values, group)]
    departures = np.hstack(
        [_departures(inside, subject, cell), _departures(response, subject, cell)]
    )
    first, triangles = _triangles(departures, group)
    known = inside.shape[1]
    unexplained = triangles[:, known:, known:]
    scatter = trial_scatter(response, subject, cell, by_subject=by_subject)
    if not by_subject:
        unexplained = np.stack([_stacked(unexplained[cell[first] == c]) for c in scatter.cell])
    scatter = dataclasses.replace(scatter, rows=unexplained.transpose(2, 1, 0))
    rows = triangles[:, :known].reshape(-1, departures.shape[1])
    informed = rows.any(axis=1)
    row_values = np.zeros((count, len(rows)))
    row_values[_varying(values, group)] = rows[:, :known].T
    left = _without_own_slopes(departures[:, :known], departures[:, known:], subject, cell)
    trial_rows = np.zeros_like(statistics.trial_rows)
    for c in range(len(statistics.environments)):
        if statistics.trial_df[c] > known:
            trial_rows[..., c] = _stacked(left[cell == c]).T
    found = Covariates(
        names=names,
        within=tuple(name for name, varies in zip(names, within, strict=True) if varies),
        mean=means,
        row_subject=np.repeat(subject[first], known)[informed],
        row_cell=np.repeat(cell[first], known)[informed],
        row_values=row_values[:, informed],
        row_responses=rows[informed, known:].T,
    )
    apart = apart_by_subject(statistics)
    return dataclasses.replace(apart, trial_rows=trial_rows), scatter, found


def _without_own_slopes(
    values: Array,
    responses: Array,
    subject: Indices,
    cell: Indices,
) -> Array:
    """Departures of responses (trials, P) less what slopes of each subject explain of them."""
    left = np.zeros_like(responses)
    for i in np.unique(subject):
        own = subject == i
        df = own.sum() - len(np.unique(cell[own]))
        # As many covariates as degrees of freedom explain all scatter: the rest is rounding.
        if df > values.shape[1]:
            slopes, *_ = np.linalg.lstsq(values[own], responses[own], rcond=None)
            left[own] = responses[own] - values[own] @ slopes
    return left


def _subject_cell(subject: Indices, cell: Indices) -> Indices:
    """Return the number of each trial's cell of its subject."""
    cells = int(cell.max()) + 1
    return np.asarray(subject * cells + cell)


def _varying(values: Array, group: Indices) -> NDArray[np.bool_]:
    """Whether a column of values (trials, M) varies within a group of trials, (M,)."""
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    return np.asarray((values != values[first][number]).any(axis=0))


def _group_means(values: Array, group: Indices) -> Array:
    """Mean of each trial's group, (trials, columns)."""
    _, number, counts = np.unique(group, return_inverse=True, return_counts=True)
    means = np.zeros((len(counts), values.shape[1]))
    # A second pass: rounding of the means must not reach the scatter.
    for _ in range(2):
        np.add.at(means, number, (values - means[number]) / counts[number, None])
    return means[number]


def _departures(
    values: Array,
    subject: Indices,
    cell: Indices,
) -> Array:
    """Values (trials, columns) less the mean of the subject in the cell."""
    return np.asarray(values - _group_means(values, _subject_cell(subject, cell)))


def _triangles(departures: Array, group: Indices) -> tuple[Indices, Array]:
    """First trial of each group, (T,), and the triangle of its departures, (T, size, size)."""
    _, first = np.unique(group, return_index=True)
    return first, np.stack([_stacked(departures[group == group[trial]]) for trial in first])


def _stacked(rows: Array) -> Array:
    """Triangle of rows (..., size), with zero rows below where there are fewer rows: square."""
    size = rows.shape[-1]
    triangle = np.zeros((size, size))
    found = np.linalg.qr(rows.reshape(-1, size), mode="r")
    triangle[: len(found)] = found
    return triangle
