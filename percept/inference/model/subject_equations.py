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

from percept.inference.model.blocks import Block
from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.small_cholesky import lower_factor, with_prior
from percept.inference.model.subject_covariance import SubjectCovariance

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
    noise_determinant : ndarray
        Log determinants of D, summed over all subjects, (W,).
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
        of_kinds = _noise_of_kinds(problem, scales)
        kinds = problem.kind_of_cell
        self.noise = of_kinds[kinds]
        self.noise_determinant = problem.subjects_of_kind @ of_kinds.log_determinant()
        precision = of_kinds.inverse()
        present = problem.present[..., None]
        self.precision = precision[kinds].scaled(present)
        effects = scales.effects[:, :, problem.cell_of_kind]
        size = len(self.precision.variances)
        self.weighted_effects = np.empty((len(effects), size, *self.noise.leading.shape))
        for p, part in enumerate(precision.apply(tuple(effects.swapaxes(0, 1)))):
            np.multiply(part[:, kinds], present, out=self.weighted_effects[:, p])
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
    """D, entries (C, G, W)."""
    return _noise_of_kinds(problem, scales)[problem.kind_of_cell]


def _noise_of_kinds(problem: CellProblem, scales: CellScales) -> Block:
    """Covariance between subjects, and that of the mean of a cell's trials, by kind of cells."""
    noise = scales.between[problem.cell_of_kind]
    if scales.trial is None:
        return noise
    of_one_trial = 1.0 / problem.trials_of_kind
    return noise + scales.trial[problem.group_of_kind].scaled(of_one_trial[:, None])
