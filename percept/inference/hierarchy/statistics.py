"""Sufficient statistics of a matching study: what the density reads instead of trials."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Subjects who share one vector of trial counts, and so one covariance of cell means."""

    environments: Indices  # (E,) Environments these subjects were measured in
    trials: Array  # (E,) Trials per cell
    members: Indices  # (N,) The subjects
    mean: Array  # (P, E) Mean over the subjects of their cell means
    rows: Array  # (P, K, E)

    @property
    def subjects(self) -> int:
        """Number of subjects N."""
        return int(self.members.size)


@dataclasses.dataclass(frozen=True, eq=False)
class Statistics:
    """Sufficient statistics of the hierarchical model."""

    parameters: tuple[str, ...]  # "k", "b" or both
    environments: tuple[str, ...]  # Labels
    subjects: tuple[str, ...]  # Labels
    x: Array  # (P, J) log10 of each reference over the geometric mean of the references
    patterns: tuple[Pattern, ...]  # Distinct patterns of trial counts
    trial_df: Array  # (J,) Degrees of freedom of the pooled scatter between trials
    trial_rows: Array  # (P, P, J) Rows whose sum of outer products is that scatter
    constant: float  # Part of the log density that no scale enters (powers of the counts)
    sd: Array  # (P, J) Between-subject SD of the cell means, zero where there is none
    df: Array  # (P, J) Its degrees of freedom
    cell_means: Array  # (N, P, J) Cell means per subject, NaN where a subject has none

    @property
    def repeats(self) -> bool:
        """Whether any cell holds more than one trial."""
        return bool(np.any(self.trial_df > 0))

    @property
    def summary(self) -> bool:
        """Whether these are published means and SDs, without subjects."""
        return not self.subjects


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
    """Reduce trials to sufficient statistics."""
    count_subjects, count_environments = len(subjects), len(environments)
    cell = subject * count_environments + environment
    cells = count_subjects * count_environments
    counts = np.bincount(cell, minlength=cells)
    sums = np.stack([np.bincount(cell, weights=column, minlength=cells) for column in response.T])
    with np.errstate(invalid="ignore"):
        means = sums / counts
    # A second pass over the deviations: the first mean's rounding does not reach the scatter.
    deviation = response.T - means[:, cell]
    rest = np.stack([np.bincount(cell, weights=row, minlength=cells) for row in deviation])
    means = means + np.where(counts > 0, rest / np.maximum(counts, 1), np.nan)
    deviation = response.T - means[:, cell]
    counts = counts.reshape(count_subjects, count_environments)
    cell_means = means.reshape(len(parameters), count_subjects, count_environments).transpose(
        1, 0, 2
    )
    trial_rows = np.zeros((len(parameters), len(parameters), count_environments))
    for j in range(count_environments):
        inside = deviation[:, environment == j].T
        factor = _triangle(inside)
        trial_rows[:, : factor.shape[0], j] = factor.T
    return _of_cells(counts, cell_means, trial_rows, x, (parameters, environments, subjects))


def from_cells(
    count: NDArray[np.intp],
    mean: Array,
    scatter: Array,
    x: Array,
    *,
    parameters: tuple[str, ...],
    environments: tuple[str, ...],
    subjects: tuple[str, ...],
) -> Statistics:
    """Take trials that were reduced to cells already."""
    rows = np.zeros_like(scatter)
    rows[0, 0] = np.sqrt(scatter[0, 0])
    if len(parameters) == 2:
        rows[1, 0] = np.divide(
            scatter[0, 1], rows[0, 0], out=np.zeros_like(rows[0, 0]), where=rows[0, 0] > 0
        )
        rows[1, 1] = np.sqrt(np.maximum(scatter[1, 1] - rows[1, 0] ** 2, 0.0))
    return _of_cells(count, mean, rows, x, (parameters, environments, subjects))


def _of_cells(
    counts: NDArray[np.intp],
    cell_means: Array,
    trial_rows: Array,
    x: Array,
    labels: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]],
) -> Statistics:
    subjects = labels[2]
    if len(subjects) < 2:
        raise RefusalError(
            f"one subject ({', '.join(subjects)}) says nothing of the spread between subjects.",
            hint="Add the sessions of at least one more subject.",
        )
    patterns = tuple(_patterns(counts, cell_means))
    sd, df = _between(cell_means)
    size = cell_means.shape[1]
    constant = -0.5 * size * float(np.log(counts[counts > 0]).sum())
    constant -= 0.5 * size * sum(p.environments.size * math.log(p.subjects) for p in patterns)
    return Statistics(
        *labels,
        x=np.asarray(x, dtype=float),
        patterns=patterns,
        trial_df=np.maximum(counts - 1, 0).sum(axis=0).astype(float),
        trial_rows=trial_rows,
        constant=constant,
        sd=sd,
        df=df,
        cell_means=cell_means,
    )


def from_summary(
    mean: Array, sd: Array, n: Array, x: Array, *, parameter: str, environments: tuple[str, ...]
) -> Statistics:
    """Take published means and SDs of one parameter as sufficient statistics."""
    patterns = []
    for j, count in enumerate(n):
        members = np.arange(int(count))
        rows = np.reshape(np.sqrt(count - 1.0) * sd[j], (1, 1, 1))
        patterns.append(
            Pattern(np.array([j]), np.ones(1), members, np.reshape(mean[j], (1, 1)), rows)
        )
    return Statistics(
        parameters=(parameter,),
        environments=environments,
        subjects=(),
        x=np.reshape(x, (1, -1)),
        patterns=tuple(patterns),
        trial_df=np.zeros(len(environments)),
        trial_rows=np.zeros((1, 1, len(environments))),
        constant=-0.5 * float(np.log(n).sum()),
        sd=np.reshape(sd, (1, -1)),
        df=np.reshape(n, (1, -1)) - 1.0,
        cell_means=np.empty((0, 1, len(environments))),
    )


def _patterns(counts: NDArray[np.intp], cell_means: Array) -> list[Pattern]:
    distinct, member_of = np.unique(counts, axis=0, return_inverse=True)
    patterns = []
    for index, pattern in enumerate(distinct):
        present = np.flatnonzero(pattern)
        members = np.flatnonzero(member_of.ravel() == index)
        values = cell_means[members][:, :, present]
        mean = values.mean(axis=0)
        mean = mean + (values - mean).mean(axis=0)
        flat = (values - mean).reshape(members.size, -1)
        rows = _contrasts(flat) if members.size <= flat.shape[1] else _triangle(flat)
        rows = rows.reshape(rows.shape[0], *mean.shape).transpose(1, 0, 2)
        patterns.append(
            Pattern(
                present, pattern[present].astype(float), members, mean, np.ascontiguousarray(rows)
            )
        )
    return patterns


def _triangle(rows: Array) -> Array:
    """Upper triangular R with R'R = rows'rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _contrasts(flat: Array) -> Array:
    """Helmert contrasts: N - 1 rows with the scatter of N rows about their mean."""
    n = flat.shape[0]
    upper = np.arange(1, n)[:, None]
    column = np.arange(n)[None, :]
    helmert = np.where(column < upper, 1.0, np.where(column == upper, -upper, 0.0))
    return (helmert / np.sqrt(upper * (upper + 1.0))) @ flat


def _between(cell_means: Array) -> tuple[Array, Array]:
    present = np.isfinite(cell_means)
    n = present.sum(axis=0)
    mean = np.where(present, cell_means, 0.0).sum(axis=0) / np.maximum(n, 1)
    # Once more about that mean: equal values must have an SD of exactly zero.
    mean = mean + np.where(present, cell_means - mean, 0.0).sum(axis=0) / np.maximum(n, 1)
    squares = np.where(present, (cell_means - mean) ** 2, 0.0).sum(axis=0)
    return np.sqrt(squares / np.maximum(n - 1, 1)), np.maximum(n - 1.0, 0.0)
