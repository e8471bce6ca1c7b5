"""How far subjects' cell means scatter, and how much of it is trials: what tells of their SDs.

Arrays have the shape (P, J): P quantities by J cells.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.statistics import Statistics

__all__ = ["CellScatter", "cell_scatter", "centred"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class CellScatter:
    """Scatter of subjects' means in each cell: sd² has the mean sigma² + noise."""

    sd: Array  # (P, J) SD of the means, zero where there is none
    df: Array  # (P, J) Its degrees of freedom
    noise: Array  # (P, J) Variance that the scatter of trials gives to a mean; zero without repeats


def cell_scatter(
    statistics: Statistics,
    *,
    subject_effect: bool,
) -> CellScatter:
    """Scatter between subjects, without their means over cells where these have a variance."""
    noise = _noise_of_trials(statistics)
    sd = statistics.sd
    df = statistics.df
    if subject_effect:
        # Scatter of subjects' means over cells says nothing of sigma.
        sd_within, df_within = _within_subjects(statistics.cell_means)
        has_scatter = sd_within > 0
        smaller = has_scatter & (sd_within < sd)
        sd = np.where(smaller, sd_within, sd)
        df = np.where(smaller, df_within, df)
    return CellScatter(sd, df, noise)


def centred(
    values: Array,
    present: Flags,
    axis: int,
) -> Array:
    """Values less their mean along an axis, zero where not present."""
    known = np.where(present, values, 0.0)
    total = known.sum(axis=axis, keepdims=True)
    count = present.sum(axis=axis, keepdims=True)
    mean = total / np.maximum(count, 1)
    departures = values - mean
    return np.where(present, departures, 0.0)


def _within_subjects(cell_means: Array) -> tuple[Array, Array]:
    """SD and degrees of freedom of cell means (N, P, J) about the means of cells and subjects."""
    complete = np.isfinite(cell_means).all(axis=1)  # (N, J)
    cells = complete.sum(axis=1)
    several = cells > 1
    values = cell_means[several]
    present = np.isfinite(values)
    about_cells = centred(values, present, 0)
    residuals = centred(about_cells, present, 2)
    subjects_of_cell = present.sum(axis=0)
    cells_of_subject = present.sum(axis=2, keepdims=True)
    # Each subject's mean takes one degree of freedom, in equal parts from the subject's cells, and
    # each cell's mean takes one from its subjects.
    lost_by_subject = 1.0 / np.maximum(cells_of_subject, 1)
    lost_by_cell = 1.0 / np.maximum(subjects_of_cell, 1)
    kept = np.where(present, 1.0 - lost_by_subject, 0.0)
    df = kept.sum(axis=0)
    df *= 1.0 - lost_by_cell
    squares = np.square(residuals).sum(axis=0)
    nothing = np.zeros_like(df)
    variance = np.divide(squares, df, out=nothing, where=df > 0)
    return np.sqrt(variance), df


def _noise_of_trials(statistics: Statistics) -> Array:
    """Variance that trials give to a cell's mean, averaged over the subjects of the cell."""
    df = statistics.trial_df
    squares = np.square(statistics.trial_rows).sum(axis=1)
    all_squares = squares.sum(axis=1, keepdims=True)
    # An environment without repeats takes the variance that the others have together.
    pooled = all_squares / max(df.sum(), 1.0)
    alone = squares / np.maximum(df, 1.0)
    variance = np.where(df > 0, alone, pooled)
    subjects = np.zeros(df.size)
    inverse_trials = np.zeros(df.size)
    for pattern in statistics.patterns:
        subjects[pattern.environments] += pattern.subjects
        inverse_trials[pattern.environments] += pattern.subjects / pattern.trials
    return variance * inverse_trials / subjects
