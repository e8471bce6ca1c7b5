"""Draws of the subjects' effects, given scales, locations and data.

Shapes: P quantities, C cells, E of them in a pattern of n subjects, N subjects in all, q effects of
a subject, W draws of the scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.laws import SubjectLaws
from percept.inference.model.statistics import Statistics
from percept.inference.model.subject_covariance import SubjectCovariance

__all__ = ["draw_effects_of"]

Array = NDArray[np.float64]


def draw_effects_of(
    laws: SubjectLaws,
    statistics: Statistics,
    own_cells: NDArray[np.bool_],
    locations: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw what every subject adds, averaged over its own cells.

    Parameters
    ----------
    laws : SubjectLaws
        At W sets of scales; the columns of effects differ between cells.
    statistics : Statistics
        Of the responses.
    own_cells : ndarray of bool
        Cells that are averaged over, shape (N, C): the same for all subjects of a pattern.
    locations : ndarray
        Locations drawn at these scales, on the response scale, shape (W, P C).
    rng : numpy.random.Generator
        Source of the draws.

    Returns
    -------
    ndarray
        On the response scale, shape (W, N, P).
    """
    cell_means = statistics.cell_means
    beta = locations.T.reshape(laws.mean.shape)  # (P, C, W)
    effects = np.empty((len(locations), len(cell_means), len(beta)))
    for pattern, noise in zip(statistics.patterns, laws.noise, strict=True):
        present = pattern.environments
        covariance = SubjectCovariance(noise, laws.effects[:, :, present])
        pattern_means = cell_means[pattern.members][:, :, present, None]
        residual = pattern_means - beta[:, present]  # (n, P, E, W)
        own = own_cells[pattern.members[0]]
        average_columns = laws.effects[:, :, own].mean(axis=2)  # (q, P, W)
        latents = covariance.draw_effects(residual, rng)  # (q, n, W)
        effects[:, pattern.members] = np.einsum("qnw,qpw->wnp", latents, average_columns)
    return effects
