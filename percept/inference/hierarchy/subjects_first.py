"""Normal equations of a linear design, solved with the subjects' effects eliminated first.

What is left are the latents: a own deviations in each of J environments, and the rest, r
coefficients of fixed terms and slopes. The precision of the effects is one block (q, q) for each of
G patterns, so T = L⁻¹X is found pattern by pattern. W are the sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.remainder import Remainder, joined
from percept.inference.hierarchy.small_cholesky import log_diagonal, solve_lower, with_prior

__all__ = ["SubjectsFirst"]

Array = NDArray[np.float64]


class SubjectsFirst:
    """Subjects' effects are eliminated; own deviations and the rest are left.

    Parameters
    ----------
    equations : CellEquations
        The normal equations at W sets of scales.
    effect_factor : ndarray
        Lower factors of the precisions of the subjects' effects, (q, q, G, W).

    Attributes
    ----------
    latents, log_determinant, remainder
        As in `Elimination`; the remainder holds all K = a J + r latents.
    """

    def __init__(self, equations: CellEquations, effect_factor: Array) -> None:
        problem = equations.problem
        self._deviation_sd = equations.deviation_sd
        deviations = problem.deviations
        by_rest = equations.deviations_by_rest
        _, _, *shape_of_rest = by_rest.shape
        joint = joined(
            blocks=with_prior(equations.deviations),
            blocks_by_rest=by_rest.reshape(deviations, *shape_of_rest),
            rest=equations.rest,
        )
        _, *effect_shape = effect_factor.shape
        by_effects = equations.deviations_by_effects.reshape(deviations, *effect_shape)
        latents_by_effects = np.concatenate([by_effects, equations.rest_by_effects])
        effects_by_latents = latents_by_effects.swapaxes(0, 1)
        for_latents = effect_factor[:, :, None]
        explained = solve_lower(for_latents, effects_by_latents)  # T, (q, K + 1, G, W)
        latents_second = explained.transpose(3, 1, 0, 2)
        width, count, *_ = latents_second.shape
        flat = latents_second.reshape(width, count, -1)
        self.remainder = Remainder(joint, flat)
        draws_last = self.remainder.solution.T
        self.latents = np.ascontiguousarray(draws_last)
        of_effects = 2.0 * problem.subjects @ log_diagonal(effect_factor)
        self.log_determinant = of_effects + self.remainder.log_determinant

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, n, K) whose products are the covariance of n combinations of latents."""
        weights = self._weights(own, rest)
        return self.remainder.columns_of(weights)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations of latents."""
        weights = self._weights(own, rest)
        return self.remainder.variances_of(weights)

    def _weights(self, own: Array, rest: Array) -> Array:
        """Weights (W, n, K) of latents, from (n, a, J) of own deviations and (n, r)."""
        count = len(own)
        sd = self._deviation_sd[:, None]
        scaled = own[..., None] * sd  # (n, a, J, W)
        width = scaled.shape[-1]
        flat = scaled.reshape(count, -1, width)
        of_own = np.moveaxis(flat, -1, 0)
        every_draw = (width, *rest.shape)
        of_rest = np.broadcast_to(rest, every_draw)
        return np.concatenate([of_own, of_rest], axis=2)
