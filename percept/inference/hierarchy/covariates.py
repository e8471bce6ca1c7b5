"""Covariates of trials or subjects: what they add to the sufficient statistics of a study."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.statistics import Statistics

__all__ = ["Covariates", "with_covariates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclasses.dataclass(frozen=True, eq=False)
class Covariates:
    """What M covariates of trials or subjects add to the sufficient statistics."""

    names: tuple[str, ...]
    mean: Array  # (M, C, G) Means over a pattern's subjects, zero where there is no cell
    between: tuple[Array, ...]  # (n, M, E) Rows of each pattern that go with those of responses
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
        Rows of scatter between subjects go with those of the covariates, and scatter between
        trials leaves out what the covariates explain within cells.
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
        factor = np.asarray(np.linalg.qr(apart[cell == c], mode="r"))
        triangle[: len(factor)] = factor
        rows[..., c] = triangle[:count, :count]
        responses[..., c] = triangle[:count, count:]
        trial_rows[..., c] = triangle[count:, count:].T
    of_cells = means[:count].reshape(count, subjects, cells)
    patterns = []
    between = []
    mean = np.zeros((count, cells, len(statistics.patterns)))
    for g, pattern in enumerate(statistics.patterns):
        present = pattern.environments
        own = np.moveaxis(of_cells[:, pattern.members][:, :, present], 1, 0)
        mean[:, present, g] = own.mean(axis=0)
        joint = np.concatenate([own, statistics.cell_means[pattern.members][:, :, present]], axis=1)
        flat = (joint - joint.mean(axis=0)).reshape(len(joint), -1)
        triangle = np.asarray(np.linalg.qr(flat, mode="r"))
        rows_of_pattern = triangle.reshape(-1, count + size, len(present))
        between.append(rows_of_pattern[:, :count])
        of_responses = np.ascontiguousarray(rows_of_pattern[:, count:].transpose(1, 0, 2))
        patterns.append(dataclasses.replace(pattern, rows=of_responses))
    reduced = dataclasses.replace(statistics, patterns=tuple(patterns), trial_rows=trial_rows)
    return reduced, Covariates(names, mean, tuple(between), rows, responses)
