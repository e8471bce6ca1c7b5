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

from percept.errors import RefusalError

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
    squares: Array  # (P, T) Sums of squares of the responses about their means


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
    group: Indices  # (N, J) Group of the scatter that a subject's trials in a cell belong to
    trial_df: Array  # (J,) Degrees of freedom between trials, subjects pooled
    trial_squares: Array  # (P, J) Sums of squares between trials, less subjects' own slopes
    sd: Array  # (P, J) Between-subject SD of the cell means, zero where there is none
    df: Array  # (P, J) Its degrees of freedom
    cell_means: Array  # (N, P, J) Cell means per subject, NaN where a subject has none
    covariates: Covariates | None = None

    @property
    def repeats(self) -> bool:
        """Whether any cell holds more than one trial."""
        return bool(np.any(self.trial_df > 0))

    @cached_property
    def constant(self) -> float:
        """Part of the log density that no scale enters: powers of 2 pi and of the counts."""
        logs = 0.0
        for pattern in self.patterns:
            # Means of r trials and of N subjects have densities with r^(P/2) and N^(P/2) in front.
            of_subject = _LOG_2PI * pattern.trials.sum()
            of_subject += np.log(pattern.trials).sum()
            logs += pattern.subjects * of_subject
            logs += pattern.environments.size * math.log(pattern.subjects)
        return -0.5 * len(self.parameters) * logs

    def without_scatter(self) -> Statistics:
        """Statistics of the same design before anything is observed."""
        scatter = dataclasses.replace(
            self.scatter,
            rows=np.zeros_like(self.scatter.rows),
            squares=np.zeros_like(self.scatter.squares),
        )
        return dataclasses.replace(
            self,
            scatter=scatter,
            sd=np.zeros_like(self.sd),
            trial_squares=np.zeros_like(self.trial_squares),
        )


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
        Labels; `environments` are those of the cells.

    Returns
    -------
    Statistics

    Raises
    ------
    RefusalError
        Fewer than two subjects.
    """
    if len(subjects) < 2:
        raise RefusalError(
            f"one subject ({', '.join(subjects)}) shows no spread between subjects.",
            hint="Add the sessions of at least one more subject.",
        )
    counts, first, group = counts_of(subject, cell, len(environments))
    means = group_means(response, group)
    by_cell = np.full((*counts.shape, len(parameters)), np.nan)
    by_cell[subject[first], cell[first]] = means
    cell_means = np.ascontiguousarray(by_cell.swapaxes(1, 2))
    sd, df = _sd_between(cell_means)
    _, pattern = np.unique(counts, axis=0, return_inverse=True)
    triangles = triangles_of(response - means[group], cell, len(environments))
    repeats = np.maximum(counts - 1.0, 0.0)
    scatter = _pooled_scatter(triangles, repeats.sum(axis=0))
    return Statistics(
        parameters=parameters,
        environments=environments,
        subjects=subjects,
        x=np.asarray(x, dtype=float),
        patterns=patterns_of(counts, cell_means, pattern.ravel()),
        scatter=scatter,
        group=np.tile(scatter.cell, (len(subjects), 1)),
        trial_df=scatter.df,
        trial_squares=scatter.squares,
        sd=sd,
        df=df,
        cell_means=cell_means,
    )


def from_summary(
    mean: Array,
    sd: Array,
    n: Array,
    x: Array,
    *,
    parameter: str,
    environments: tuple[str, ...],
) -> Statistics:
    """Take published means and SDs of one parameter, each (J,), as sufficient statistics.

    Subjects are not known across environments: each environment is a pattern of its own.
    """
    patterns = []
    for j, count in enumerate(n):
        root_scatter = np.sqrt(count - 1.0) * sd[j]
        pattern = Pattern(
            environments=np.array([j]),
            trials=np.ones(1),
            members=np.arange(int(count)),
            mean=np.reshape(mean[j], (1, 1)),
            rows=np.reshape(root_scatter, (1, 1, 1)),
        )
        patterns.append(pattern)
    cells = len(environments)
    no_rows = np.zeros((cells, 1, 1))
    scatter = _pooled_scatter(no_rows, np.zeros(cells))
    return Statistics(
        parameters=(parameter,),
        environments=environments,
        subjects=(),
        x=np.reshape(x, (1, -1)),
        patterns=tuple(patterns),
        scatter=scatter,
        group=np.empty((0, cells), dtype=np.intp),
        trial_df=scatter.df,
        trial_squares=scatter.squares,
        sd=np.reshape(sd, (1, -1)),
        df=np.reshape(n, (1, -1)) - 1.0,
        cell_means=np.empty((0, 1, cells)),
    )


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
    _, first, group = counts_of(subject, cell, cell.max() + 1)
    departures = response - group_means(response, group)[group]
    rows = triangles_of(departures, group, len(first))
    df = np.bincount(group).astype(float) - 1.0
    scatter = _pooled_scatter(rows, df)
    return dataclasses.replace(scatter, cell=cell[first], subject=subject[first])


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


def _pooled_scatter(triangles: Array, df: Array) -> TrialScatter:
    """Scatter between trials of the cells, subjects pooled, from triangles (T, P, P)."""
    return TrialScatter(
        cell=np.arange(len(df)),
        subject=None,
        df=df,
        rows=np.ascontiguousarray(triangles.transpose(2, 1, 0)),
        squares=np.square(triangles).sum(axis=1).T,
    )


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


def _sd_between(cell_means: Array) -> tuple[Array, Array]:
    """SD between subjects of the cell means (N, P, J), and its degrees of freedom, each (P, J)."""
    present = np.isfinite(cell_means)
    n = present.sum(axis=0)
    divisor = np.maximum(n, 1)
    mean = np.where(present, cell_means, 0.0).sum(axis=0) / divisor
    # Once more about that mean: equal values must have an SD of exactly zero.
    about_mean = np.where(present, cell_means - mean, 0.0)
    mean = mean + about_mean.sum(axis=0) / divisor
    about_mean = np.where(present, cell_means - mean, 0.0)
    squares = np.square(about_mean).sum(axis=0)
    sd = np.sqrt(squares / np.maximum(n - 1, 1))
    return sd, np.maximum(n - 1.0, 0.0)
