"""Sufficient statistics of a matching study: what the density reads instead of trials.

Subjects who share one vector of trial counts are a pattern. Where subjects have trial SDs of their
own, or covariates, each is a pattern (`trials`). Arrays have N subjects, P quantities, J cells, E
cells in a pattern, T groups of trials, and M covariates.
"""

from __future__ import annotations

import dataclasses
import math

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

    def group_of(self, subject: Indices, cell: Indices) -> Indices:
        """Group of the trials of subjects in cells."""
        if self.subject is None:
            return cell
        groups = np.zeros((self.subject.max() + 1, self.cell.max() + 1), dtype=np.intp)
        groups[self.subject, self.cell] = np.arange(len(self.cell))
        return groups[subject, cell]


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
    trial_df: Array  # (J,) Degrees of freedom of the pooled scatter between trials
    trial_rows: Array  # (P, P, J) Rows whose outer products sum to it, less subjects' own slopes
    scatter: TrialScatter  # Between trials, as the density reads it
    sd: Array  # (P, J) Between-subject SD of the cell means, zero where there is none
    df: Array  # (P, J) Its degrees of freedom
    cell_means: Array  # (N, P, J) Cell means per subject, NaN where a subject has none
    covariates: Covariates | None = None

    @property
    def repeats(self) -> bool:
        """Whether any cell holds more than one trial."""
        return bool(np.any(self.trial_df > 0))

    @property
    def summary(self) -> bool:
        """Whether these are published means and SDs, without subjects."""
        return not self.subjects

    @property
    def constant(self) -> float:
        """Part of the log density that no scale enters: powers of 2 pi and of the counts."""
        logs = 0.0
        for pattern in self.patterns:
            # Means of r trials and of N subjects have densities with r^(P/2) and N^(P/2) in front.
            of_subject = _LOG_2PI * pattern.trials.sum() + np.log(pattern.trials).sum()
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
            trial_rows=np.zeros_like(self.trial_rows),
        )


def from_trials(
    response: Array,
    subject: Indices,
    environment: Indices,
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
    subject, environment : ndarray of int
        Number of the subject and of the environment of each trial, shape (trials,).
    x : ndarray
        Decades of each reference above their geometric mean, shape (P, J).
    parameters, environments, subjects : tuple of str
        Labels.

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
    shape = (len(subjects), len(environments))
    cell = subject * len(environments) + environment
    counts = np.bincount(cell, minlength=math.prod(shape)).reshape(shape)
    means = group_means(response, cell, math.prod(shape))
    deviation = response - means[cell]
    triangles = [triangle(deviation[environment == j]).T for j in range(len(environments))]
    cell_means = np.ascontiguousarray(means.reshape(*shape, -1).swapaxes(1, 2))
    sd, df = _sd_between(cell_means)
    scatter = _pooled_scatter(
        np.stack(triangles, axis=2), np.maximum(counts - 1.0, 0.0).sum(axis=0)
    )
    return Statistics(
        parameters=parameters,
        environments=environments,
        subjects=subjects,
        x=np.asarray(x, dtype=float),
        patterns=tuple(_patterns(counts, cell_means)),
        trial_df=scatter.df,
        trial_rows=scatter.rows,
        scatter=scatter,
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
    scatter = _pooled_scatter(np.zeros((1, 1, cells)), np.zeros(cells))
    return Statistics(
        parameters=(parameter,),
        environments=environments,
        subjects=(),
        x=np.reshape(x, (1, -1)),
        patterns=tuple(patterns),
        trial_df=scatter.df,
        trial_rows=scatter.rows,
        scatter=scatter,
        sd=np.reshape(sd, (1, -1)),
        df=np.reshape(n, (1, -1)) - 1.0,
        cell_means=np.empty((0, 1, cells)),
    )


def group_means(
    values: Array,
    group: Indices,
    groups: int,
) -> Array:
    """Means of values (trials, k) by the group of each trial, (groups, k); NaN of no trials."""
    counts = np.bincount(group, minlength=groups)
    means = np.zeros((groups, values.shape[1]))
    # A second pass over the deviations: the first mean's rounding does not reach the scatter.
    for _ in range(2):
        about_means = values - means[group]
        sums = [np.bincount(group, weights=column, minlength=groups) for column in about_means.T]
        means += np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]
    means[counts == 0] = np.nan
    return means


def triangle(rows: Array) -> Array:
    """Square upper triangle R with R'R = rows'rows, for rows (n, K)."""
    size = rows.shape[1]
    factor = np.linalg.qr(rows, mode="r")
    return np.pad(factor, ((0, size - len(factor)), (0, 0)))


def _pooled_scatter(rows: Array, df: Array) -> TrialScatter:
    """Scatter between trials of the cells, subjects pooled."""
    return TrialScatter(
        cell=np.arange(len(df)),
        subject=None,
        df=df,
        rows=rows,
        squares=np.square(rows).sum(axis=1),
    )


def _patterns(counts: NDArray[np.intp], cell_means: Array) -> list[Pattern]:
    """Group subjects by their trial counts (N, J)."""
    distinct, member_of = np.unique(counts, axis=0, return_inverse=True)
    patterns = []
    for index, trials in enumerate(distinct):
        present = np.flatnonzero(trials)
        members = np.flatnonzero(member_of.ravel() == index)
        values = cell_means[members][:, :, present]
        mean = values.mean(axis=0)
        mean = mean + (values - mean).mean(axis=0)
        flat = (values - mean).reshape(members.size, -1)
        fewer_rows = members.size <= flat.shape[1]
        # Helmert contrasts: N - 1 rows with the scatter of N rows about their mean.
        rows = linalg.helmert(len(flat)) @ flat if fewer_rows else triangle(flat)
        by_parameter = rows.reshape(len(rows), *mean.shape).transpose(1, 0, 2)
        pattern = Pattern(
            environments=present,
            trials=trials[present].astype(float),
            members=members,
            mean=mean,
            rows=np.ascontiguousarray(by_parameter),
        )
        patterns.append(pattern)
    return patterns


def _sd_between(cell_means: Array) -> tuple[Array, Array]:
    """SD between subjects of the cell means (N, P, J), and its degrees of freedom, each (P, J)."""
    present = np.isfinite(cell_means)
    n = present.sum(axis=0)
    divisor = np.maximum(n, 1)
    mean = np.where(present, cell_means, 0.0).sum(axis=0) / divisor
    # Once more about that mean: equal values must have an SD of exactly zero.
    about_mean = np.where(present, cell_means - mean, 0.0)
    mean = mean + about_mean.sum(axis=0) / divisor
    squares = np.where(present, (cell_means - mean) ** 2, 0.0).sum(axis=0)
    sd = np.sqrt(squares / np.maximum(n - 1, 1))
    return sd, np.maximum(n - 1.0, 0.0)
