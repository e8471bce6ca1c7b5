"""Sufficient statistics of a matching study: what the density reads instead of trials.

Subjects who share one vector of trial counts are a pattern. Where subjects have trial SDs of their
own, or covariates, each is a pattern. Arrays have N subjects, P quantities, J cells, E cells in a
pattern, T groups of trials, and M covariates. All cells of all subjects are numbered in one row
where trials are grouped: `group` has the number of each trial.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.inference.model.blocks import Block

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LOG_2PI = math.log(2.0 * math.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Subjects who share one vector of trial counts, and so one covariance of cell means."""

    environments: Indices  # (E,) Cells these subjects were measured in
    trials: Array  # (E,) Trials per cell
    members: Indices  # (N,) The subjects
    mean: Array  # (P, E) Mean over the subjects of their cell means
    rows: Array  # (P, K, E) Rows whose outer products sum to the scatter about that mean

    @property
    def subjects(self) -> int:
        """Number of subjects N."""
        return int(self.members.size)

    @cached_property
    def triangles(self) -> Array:
        """Few rows whose products sum to the scatter in each cell by itself, (P, P, E)."""
        by_cell = [triangle(rows) for rows in self.rows.transpose(2, 1, 0)]
        return np.stack(by_cell).transpose(2, 1, 0)


@dataclasses.dataclass(frozen=True, eq=False)
class TrialScatter:
    """Scatter between trials in T groups: the cells, or the cells of every subject.

    A trial departs from the mean of its subject in its cell. The departures of a group of trials
    form a matrix whose triangle has the same products, and so all that a density needs of them.
    """

    cell: Indices  # (T,) Cell of each group
    subject: Indices | None  # (T,) Subject of each group; None where subjects are pooled
    df: Array  # (T,) Degrees of freedom
    rows: Array  # (P, P, T) Rows of responses, less what covariates explain, as [quantity, row]
    squares: Array  # (P, T) Squares of the responses, less what subjects' own slopes explain

    def minus_twice_log_density(self, trial: Block) -> Array:
        """Squares and log determinants of each group, (T, W), given covariances between trials."""
        every_draw = tuple(self.rows[..., None])
        return trial.distance(every_draw) + self.df[:, None] * trial.log_determinant()


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Variance that a finite resolution of the adjustment adds, on the response scale."""

    between: Array  # (P, C)
    trial: Array  # (P, C)


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """Covariates of the subjects' cell means, and rows of trials that tell of slopes too."""

    names: tuple[str, ...]
    within: tuple[str, ...]  # Those that vary within subjects, who have slopes of their own
    mean: Array  # (M, N, J) Means of each subject's trials, zero where there is no cell
    row_subject: Indices  # (n,) Of n rows of trials about the mean of their cell
    row_cell: Indices  # (n,)
    row_values: Array  # (M, n) Of the covariates
    row_responses: Array  # (P, n)


@dataclasses.dataclass(frozen=True, eq=False)
class Statistics:
    """Sufficient statistics of the hierarchical model."""

    parameters: tuple[str, ...]  # "k", "b" or both
    environments: tuple[str, ...]  # Labels of the cells: environments at each level of factors
    subjects: tuple[str, ...]  # Labels
    x: Array  # (P, J) log10 of each reference over the geometric mean of the references
    patterns: tuple[Pattern, ...]  # Distinct patterns of trial counts
    scatter: TrialScatter  # Between trials
    cell_means: Array  # (N, P, J) Cell means per subject, NaN where a subject has none
    counts: Array  # (N, J) Trials
    covariates: Covariates | None = None

    @property
    def repeats(self) -> bool:
        """Whether any cell holds more than one trial."""
        return bool(np.any(self.scatter.df > 0))

    @property
    def trial_df(self) -> Array:
        """Degrees of freedom between trials, subjects pooled, (J,)."""
        return np.asarray(np.bincount(self.scatter.cell, self.scatter.df), dtype=float)

    @property
    def trial_squares(self) -> Array:
        """Sums of squares between trials, subjects pooled, (P, J)."""
        by_quantity = self.scatter.squares
        return np.stack([np.bincount(self.scatter.cell, squares) for squares in by_quantity])

    @property
    def group(self) -> Indices:
        """Group of the scatter that a subject's trials in a cell belong to, (N, J)."""
        subjects, _, cells = self.cell_means.shape
        group = np.tile(np.arange(cells), (subjects, 1))
        scatter = self.scatter
        if scatter.subject is not None:
            group[scatter.subject, scatter.cell] = np.arange(len(scatter.cell))
        return group

    @property
    def df(self) -> Array:
        """Degrees of freedom of the cell means between subjects, (P, J)."""
        return np.maximum(np.isfinite(self.cell_means).sum(axis=0) - 1.0, 0.0)

    @cached_property
    def sd(self) -> Array:
        """SD of the cell means between subjects, (P, J), zero where there is none."""
        mean = np.nanmean(self.cell_means, axis=0)
        # Once more about that mean: equal values must have an SD of exactly zero.
        mean += np.nanmean(self.cell_means - mean, axis=0)
        squares = np.nansum(np.square(self.cell_means - mean), axis=0)
        return np.sqrt(squares / np.maximum(self.df, 1.0))

    @cached_property
    def constant(self) -> float:
        """Part of the log density that no scale enters: powers of 2 pi and of the counts."""
        logs = 0.0
        for pattern in self.patterns:
            # Means of r trials have a density with r^(P/2) in front. That of N subjects is taken
            # times √N.
            of_subject = _LOG_2PI * pattern.trials.sum()
            of_subject += np.log(pattern.trials).sum()
            logs += pattern.subjects * of_subject
        return -0.5 * len(self.parameters) * logs


def from_trials(
    response: Array,
    subject: Indices,
    cell: Indices,
    x: Array,
    *,
    parameters: tuple[str, ...],
    environments: tuple[str, ...],
    subjects: tuple[str, ...],
) -> Statistics:
    """Reduce trials to sufficient statistics.

    Parameters
    ----------
    response : ndarray
        One row per trial, on the response scale, shape (trials, P).
    subject, cell : ndarray of int
        Number of the subject and of the cell of each trial, shape (trials,).
    x : ndarray
        Decades of each cell's reference above their geometric mean, shape (P, J).
    parameters, environments, subjects : tuple of str
        Labels; `environments` has one for each cell.

    Returns
    -------
    Statistics
    """
    counts, first, group = counts_of(subject, cell, len(environments))
    by_cell = np.full((*counts.shape, len(parameters)), np.nan)
    by_cell[subject[first], cell[first]] = group_means(response, group)
    cell_means = np.ascontiguousarray(by_cell.swapaxes(1, 2))
    _, pattern = np.unique(counts, axis=0, return_inverse=True)
    return Statistics(
        parameters=parameters,
        environments=environments,
        subjects=subjects,
        x=np.asarray(x, dtype=float),
        patterns=patterns_of(counts, cell_means, pattern.ravel()),
        scatter=trial_scatter(response, subject, cell, pooled=True),
        cell_means=cell_means,
        counts=counts,
    )


def from_summary(
    mean: Array,
    sd: Array,
    n: Indices,
    x: Array,
    *,
    parameter: str,
    environments: tuple[str, ...],
) -> Statistics:
    """Take published means, SDs and numbers n of subjects, each (J,), as sufficient statistics.

    Subjects are not known across environments. Each environment has n of its own, without names.
    """
    response = []
    for of_mean, of_sd, count in zip(mean, sd, n, strict=True):
        # Two values about the mean have all the scatter.
        values = np.full(count, of_mean)
        departure = np.sqrt((count - 1.0) / 2.0) * of_sd
        values[0] += departure
        values[1] -= departure
        response.append(values)
    return from_trials(
        np.concatenate(response)[:, None],
        np.arange(n.sum()),
        np.repeat(np.arange(len(n)), n),
        x[None],
        parameters=(parameter,),
        environments=environments,
        subjects=(),
    )


def trial_scatter(
    response: Array,
    subject: Indices,
    cell: Indices,
    *,
    pooled: bool = False,
) -> TrialScatter:
    """Reduce trials to their scatter in the cells of every subject.

    Parameters
    ----------
    response : ndarray
        One row per trial, on the response scale, shape (trials, P).
    subject, cell : ndarray of int
        Number of the subject and of the cell of each trial, shape (trials,).

    pooled : bool
        Whether subjects are pooled: groups are then the cells.

    Returns
    -------
    TrialScatter
    """
    _, first, group = counts_of(subject, cell, cell.max() + 1)
    departures = response - group_means(response, group)[group]
    cell_of_group = cell[first]
    df = np.bincount(group).astype(float) - 1.0
    if pooled:
        group = cell
        df = np.bincount(cell_of_group, df).astype(float)
        cell_of_group = np.arange(len(df))
    triangles = triangles_of(departures, group, len(df))
    return TrialScatter(
        cell=cell_of_group,
        subject=None if pooled else subject[first],
        df=df,
        rows=np.ascontiguousarray(triangles.transpose(2, 1, 0)),
        squares=np.square(triangles).sum(axis=1).T,
    )


def counts_of(
    subject: Indices,
    cell: Indices,
    cells: int,
) -> tuple[Array, Indices, Indices]:
    """Count the trials of N subjects in each cell, (N, cells), and group them by both.

    Returned are also the first trial of each group, and the group of each trial.
    """
    numbers = subject * cells + cell
    _, first, group = np.unique(numbers, return_index=True, return_inverse=True)
    counts = np.zeros((subject.max() + 1, cells))
    counts[subject[first], cell[first]] = np.bincount(group)
    return counts, first, group


def group_means(values: Array, group: Indices) -> Array:
    """Means of values (trials, k) by the group of each trial, (groups, k)."""
    counts = np.bincount(group)
    means = np.zeros((len(counts), values.shape[1]))
    # A second pass over the deviations: the first mean's rounding does not reach the scatter.
    for _ in range(2):
        about_means = values - means[group]
        sums = [np.bincount(group, weights=column) for column in about_means.T]
        by_column = np.reshape(sums, means.T.shape)
        means += by_column.T / counts[:, None]
    return means


def triangle(rows: Array) -> Array:
    """Square upper triangle R with R'R = rows'rows, for rows (n, K)."""
    size = rows.shape[1]
    factor = np.linalg.qr(rows, mode="r")
    return np.pad(factor, ((0, size - len(factor)), (0, 0)))


def triangles_of(
    rows: Array,
    group: Indices,
    groups: int,
) -> Array:
    """Triangles (groups, K, K) of the rows (n, K) of each group."""
    triangles = [triangle(rows[group == number]) for number in range(groups)]
    return np.stack(triangles)


def patterns_of(
    counts: Array,
    cell_means: Array,
    pattern: Indices,
) -> tuple[Pattern, ...]:
    """Collect subjects with equal trial counts (N, J), given the number of each one's pattern."""
    patterns = []
    for number in range(pattern.max() + 1):
        members = np.flatnonzero(pattern == number)
        trials = counts[members[0]]
        present = np.flatnonzero(trials)
        values = cell_means[members][:, :, present]
        mean = values.mean(axis=0)
        mean = mean + (values - mean).mean(axis=0)
        flat = (values - mean).reshape(members.size, -1)
        fewer_rows = members.size <= flat.shape[1]
        # Helmert contrasts: N - 1 rows with the scatter of N rows about their mean.
        rows = linalg.helmert(len(flat)) @ flat if fewer_rows else triangle(flat)
        by_row = rows.reshape(len(rows), *mean.shape)
        by_parameter = by_row.transpose(1, 0, 2)
        one = Pattern(
            environments=present,
            trials=trials[present],
            members=members,
            mean=mean,
            rows=np.ascontiguousarray(by_parameter),
        )
        patterns.append(one)
    return tuple(patterns)
