"""A study of one parameter in one environment: its posterior has one coordinate, so quadrature
is exact."""

from __future__ import annotations

import numpy as np

from percept.inference.left_out import SubjectDensity
from percept.inference.model.model import LinearModel, plain_model
from percept.inference.model.statistics import from_trials

GRID = np.linspace(-12.0, 12.0, 24_001)


def density_of(response: np.ndarray) -> LinearModel:
    subjects = len(response)
    statistics = from_trials(
        response[:, None],
        np.arange(subjects),
        np.zeros(subjects, dtype=int),
        np.zeros((1, 1)),
        parameters=("k",),
        environments=("VE1",),
        subjects=tuple(f"S{i + 1:02d}" for i in range(subjects)),
    )
    return plain_model(statistics)


def subjects_of(response: np.ndarray) -> SubjectDensity:
    count = len(response)
    return SubjectDensity(
        density_of(response), response[:, None], np.arange(count), np.zeros(count, dtype=int)
    )


def weights(density: LinearModel) -> tuple[np.ndarray, float]:
    """Posterior weights of the grid, and the log evidence."""
    value = density(GRID[:, None])
    largest = value.max()
    mass = np.exp(value - largest)
    return mass / mass.sum(), float(largest + np.log(mass.sum() * (GRID[1] - GRID[0])))


def even_draws(density: LinearModel, count: int) -> np.ndarray:
    """Draws of the coordinate at even probabilities: Monte Carlo error next to none."""
    cumulative = np.cumsum(weights(density)[0])
    points = np.interp((np.arange(count) + 0.5) / count, cumulative, GRID)
    return np.random.default_rng(0).permutation(points)[:, None]
