"""Sufficient statistics of a matching study: what the density reads instead of trials.

Subjects who share one vector of trial counts are a pattern. Arrays have N subjects, P quantities, J
cells, and E cells in a pattern.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.errors import RefusalError

__all__ = [
    "Pattern",
    "Statistics",
    "apart_by_subject",
    "from_summary",
    "from_trials",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Subjects who share one vector of trial counts, and so one covariance of cell means."""

    environments: Indices  # (E,) Environments these subjects were measured in
    trials: Array  # (E,) Trials per cell
    members: Indices  # (N,) The subjects
    mean: Array  # (P, E) Mean over the subjects of their cell means
    rows: Array  # (P, K, E) Rows whose outer products sum to the scatter about that mean

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
    size = len(parameters)
    shape = (len(subjects), len(environments))
    cells = len(subjects) * len(environments)
    cell = subject * len(environments) + environment
    counts = np.bincount(cell, minlength=cells)
    with np.errstate(invalid="ignore"):
        means = _sums(response.T, cell, cells) / counts
    # A second pass over the deviations: the first mean's rounding does not reach the scatter.
    rest = _sums(response.T - means[:, cell], cell, cells)
    means = means + np.where(counts > 0, rest / np.maximum(counts, 1), np.nan)
    deviation = response.T - means[:, cell]
    trial_rows = np.zeros((size, size, len(environments)))
    for j in range(len(environments)):
        factor = _triangle(deviation[:, environment == j].T)
        trial_rows[:, : len(factor), j] = factor.T
    cell_means = means.reshape(size, *shape).transpose(1, 0, 2)
    counts = counts.reshape(shape)
    patterns = tuple(_patterns(counts, cell_means))
    sd, df = _between(cell_means)
    # Means of r trials and of N subjects have densities with r^(P/2) and N^(P/2) in front.
    log_trials = float(np.log(counts[counts > 0]).sum())
    log_subjects = sum(p.environments.size * math.log(p.subjects) for p in patterns)
    trial_df = np.maximum(counts - 1, 0).sum(axis=0)
    return Statistics(
        parameters=parameters,
        environments=environments,
        subjects=subjects,
        x=np.asarray(x, dtype=float),
        patterns=patterns,
        trial_df=trial_df.astype(float),
        trial_rows=trial_rows,
        constant=-0.5 * size * log_trials - 0.5 * size * log_subjects,
        sd=sd,
        df=df,
        cell_means=cell_means,
    )


def apart_by_subject(statistics: Statistics) -> Statistics:
    """Give every subject a pattern of its own, for covariances that differ between subjects."""
    size = len(statistics.parameters)
    patterns = []
    log_subjects = 0.0
    for pattern in statistics.patterns:
        log_subjects += pattern.environments.size * math.log(pattern.subjects)
        for member in pattern.members:
            mean = statistics.cell_means[member][:, pattern.environments]
            lone = dataclasses.replace(
                pattern,
                members=np.array([member]),
                mean=mean,
                rows=np.zeros((size, 0, pattern.environments.size)),
            )
            patterns.append(lone)
    # The constant no longer has the powers of the patterns' numbers of subjects.
    constant = statistics.constant + 0.5 * size * log_subjects
    return dataclasses.replace(statistics, patterns=tuple(patterns), constant=constant)


def _sums(rows: Array, cell: Indices, cells: int) -> Array:
    """Sum rows (P, trials) over the trials of each cell: (P, cells)."""
    return np.stack([np.bincount(cell, weights=row, minlength=cells) for row in rows])


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
    size = len(environments)
    return Statistics(
        parameters=(parameter,),
        environments=environments,
        subjects=(),
        x=np.reshape(x, (1, -1)),
        patterns=tuple(patterns),
        trial_df=np.zeros(size),
        trial_rows=np.zeros((1, 1, size)),
        constant=-0.5 * float(np.log(n).sum()),
        sd=np.reshape(sd, (1, -1)),
        df=np.reshape(n, (1, -1)) - 1.0,
        cell_means=np.empty((0, 1, size)),
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
        few = members.size <= flat.shape[1]
        rows = _contrasts(flat) if few else _triangle(flat)
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


def _triangle(rows: Array) -> Array:
    """Upper triangular R with R'R = rows'rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _contrasts(flat: Array) -> Array:
    """Helmert contrasts: N - 1 rows with the scatter of N rows about their mean."""
    return np.asarray(linalg.helmert(len(flat)) @ flat)


def _between(cell_means: Array) -> tuple[Array, Array]:
    """SD between subjects of the cell means (N, P, J), and its degrees of freedom, each (P, J)."""
    present = np.isfinite(cell_means)
    n = present.sum(axis=0)
    divisor = np.maximum(n, 1)
    mean = np.where(present, cell_means, 0.0).sum(axis=0) / divisor
    # Once more about that mean: equal values must have an SD of exactly zero.
    rest = np.where(present, cell_means - mean, 0.0)
    mean = mean + rest.sum(axis=0) / divisor
    squares = np.where(present, (cell_means - mean) ** 2, 0.0).sum(axis=0)
    sd = np.sqrt(squares / np.maximum(n - 1, 1))
    return sd, np.maximum(n - 1.0, 0.0)
