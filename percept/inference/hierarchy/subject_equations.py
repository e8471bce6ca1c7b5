"""What one subject of each pattern says of its effects: the noise of its cells, and their columns.

Subjects of one pattern have the same cells and numbers of trials. Given the scales, the cell means
of one subject are its locations, Z b and noise. The effects b are standard normal a priori, and the
noise has the covariance D, a small block for each cell. Two products of these serve all that
follows:

    H = D⁻¹Z          the columns of the effects, weighted
    LL' = I + Z'H     the precision of the effects, given the locations

The shapes of arrays use these letters:

    W  sets of scales (draws)     G  patterns of cells and trials     q  effects of one subject
    P  quantities                 C  cells of the study               E  cells of one pattern
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, precision_entries
from percept.inference.hierarchy.cell_problem import CellProblem
from percept.inference.hierarchy.cell_scales import CellScales
from percept.inference.hierarchy.small_cholesky import lower_factor, with_prior
from percept.inference.hierarchy.subject_covariance import SubjectCovariance

__all__ = ["SubjectEquations", "noise_of"]

Array = NDArray[np.float64]


class SubjectEquations:
    """Noise and effects of one subject of each pattern, at W sets of scales.

    Attributes
    ----------
    noise : Block
        D, entries (C, G, W). Where a pattern lacks a cell, its value has no meaning.
    precision : Block
        D⁻¹, entries (C, G, W), zero where a pattern lacks a cell.
    precision_entries : ndarray
        D⁻¹ written out, (P, P, C, G, W).
    effect_columns : ndarray
        Z, (q, P, C, W).
    weighted_effects : ndarray
        H = D⁻¹Z, (q, P, C, G, W).
    effect_factor : ndarray
        L, (q, q, G, W).
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._problem = problem
        self.effect_columns = scales.effects
        self.noise = noise_of(problem, scales)
        present = problem.present[..., None]
        precision = self.noise.inverse()
        self.precision = precision.scaled(present)
        self.precision_entries = precision_entries(self.precision)
        for_patterns = scales.effects[:, :, :, None]  # (q, P, C, 1, W)
        quantities_first = for_patterns.swapaxes(0, 1)
        weighted = self.precision.apply(tuple(quantities_first))
        self.weighted_effects = np.stack(weighted, axis=1)
        products = np.einsum("apcw,bpcgw->abgw", scales.effects, self.weighted_effects)
        self.effect_factor = lower_factor(with_prior(products))

    def covariances(self) -> list[SubjectCovariance]:
        """Covariance of a subject's cell means, for each entry of `problem.scatter`."""
        covariances = []
        for scatter in self._problem.scatter:
            noise = self.noise[scatter.cells, scatter.pattern]
            effects = self.effect_columns[:, :, scatter.cells]
            covariances.append(SubjectCovariance(noise, effects))
        return covariances


def noise_of(problem: CellProblem, scales: CellScales) -> Block:
    """D, entries (C, G, W).

    It is the covariance between subjects, and that of the mean of a cell's trials.
    """
    noise = scales.between[:, None]
    if scales.trial is not None:
        trial = scales.trial[problem.trial_group]
        of_one_trial = 1.0 / problem.trials
        noise = noise + trial.scaled(of_one_trial[..., None])
    width = scales.effects.shape[-1]
    grid = (*problem.present.shape, width)
    return noise.mapped(lambda part: np.broadcast_to(part, grid))
