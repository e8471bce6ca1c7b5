"""Covariates of trials or subjects: what they add to the sufficient statistics of a study."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Pattern, Statistics

__all__ = ["Covariates", "with_covariates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """What M covariates of trials or subjects add to the sufficient statistics."""

    names: tuple[str, ...]
    mean: Array  # (M, C, G) Cell means by pattern, zero where there is no cell
    rows: Array  # (M, M, C) Rows whose products sum to the covariates' scatter within a cell
    responses: Array  # (M, P, C) What the responses to these rows are


def with_covariates(
    response: Array,
    subject: Indices,
    cell: Indices,
    covariates: Array,
    names: tuple[str, ...],
    statistics: Statistics,
) -> tuple[Statistics, Covariates]:
    """Reduce trials whose responses follow covariates too.

    Parameters
    ----------
    response, subject, cell : ndarray
        As `from_trials`, cells in the place of environments.
    covariates : ndarray
        Values of every trial, centred, shape (trials, M).
    names : tuple of str
        Names of the covariates.
    statistics : Statistics
        Those of the responses alone.

    Returns
    -------
    Statistics
        Each subject is a pattern of its own, and scatter between trials leaves out what the
        covariates explain within cells.
    Covariates
    """
    size = response.shape[1]
    subjects = len(statistics.subjects)
    cells = len(statistics.environments)
    number = subject * cells + cell
    counts = np.bincount(number, minlength=subjects * cells)
    values = np.hstack([covariates, response])
    sums = [np.bincount(number, weights=row, minlength=len(counts)) for row in values.T]
    means = np.stack(sums) / np.maximum(counts, 1)
    apart = values - means[:, number].T
    count = len(names)
    rows = np.zeros((count, count, cells))
    responses = np.zeros((count, size, cells))
    trial_rows = np.zeros((size, size, cells))
    for c in range(cells):
        triangle = np.zeros((count + size, count + size))
        factor = np.linalg.qr(apart[cell == c], mode="r")
        triangle[: len(factor)] = factor
        rows[..., c] = triangle[:count, :count]
        responses[..., c] = triangle[:count, count:]
        trial_rows[..., c] = triangle[count:, count:].T
    patterns = []
    mean = np.zeros((count, cells, subjects))
    counts = counts.reshape(subjects, cells)
    for i in range(subjects):
        present = np.flatnonzero(counts[i])
        own = Pattern(
            environments=present,
            trials=counts[i, present].astype(float),
            members=np.array([i]),
            mean=statistics.cell_means[i][:, present],
            rows=np.zeros((size, 0, len(present))),
        )
        patterns.append(own)
        mean[:, present, i] = means[:count].reshape(count, subjects, cells)[:, i, present]
    constant = -0.5 * size * float(np.log(counts[counts > 0]).sum())
    reduced = dataclasses.replace(
        statistics, patterns=tuple(patterns), trial_rows=trial_rows, constant=constant
    )
    return reduced, Covariates(names, mean, rows, responses)
