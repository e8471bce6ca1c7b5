"""Normal equations of a linear design, solved with the environments' own deviations first.

What is left are the subjects' effects, q for each of G patterns, and the rest, r coefficients of
fixed terms and slopes: K = q G + r unknowns in this order. The precision of own deviations is one
block (a, a) for each of J environments. So A = LL' and T = L⁻¹X of `remainder` are found
environment by environment. W are the sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.remainder import Remainder, joined
from percept.inference.hierarchy.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
    with_prior,
)

__all__ = ["EnvironmentsFirst"]

Array = NDArray[np.float64]


class EnvironmentsFirst:
    """Own deviations of environments are eliminated; subjects' effects and the rest are left.

    Parameters
    ----------
    equations : CellEquations
        The normal equations at W sets of scales.
    effect_factor : ndarray
        Lower factors of the precisions of the subjects' effects, (q, q, G, W).

    Attributes
    ----------
    latents, log_determinant, remainder
        As in `Elimination`; the remainder holds the K effects and others that are left.
    """

    def __init__(self, equations: CellEquations, effect_factor: Array) -> None:
        self._deviation_sd = equations.deviation_sd
        columns, environments, rest, width = equations.deviations_by_rest.shape
        self._deviations = columns * environments
        effects, patterns = effect_factor.shape[1:3]
        self._effect_count = effects * patterns
        precision = with_prior(equations.deviations)
        self._factor = lower_factor(precision)  # (a, a, J, W)
        by_rest = equations.deviations_by_rest
        by_effects = equations.deviations_by_effects
        by_effects = by_effects.reshape(columns, environments, -1, width)
        mixed = np.concatenate([by_effects, by_rest], axis=2)
        for_columns = self._factor[:, :, :, None]
        explained = solve_lower(for_columns, mixed)  # T, (a, J, K + 1, W)
        #: T without the data's column, (a, J, K, W).
        self._explained = explained[:, :, :-1]
        explained_data = explained[:, :, -1]
        rest_by_effects = equations.rest_by_effects
        rest_by_effects = rest_by_effects.reshape(rest, self._effect_count, width)
        joint = joined(
            blocks=equations.subject.effect_precision,
            blocks_by_rest=rest_by_effects.swapaxes(0, 1),
            rest=equations.rest,
        )
        flat = explained.reshape(self._deviations, -1, width)
        draws_first = flat.transpose(2, 1, 0)
        self.remainder = Remainder(joint, draws_first)
        self.latents = self._solution(explained_data)
        # The remainder holds u = √N b̄ of each pattern, one subject's effects. The effects along the
        # other N - 1 directions have the precision I + Z'H each.
        other_subjects = equations.problem.subjects - 1.0
        of_others = other_subjects @ log_diagonal(effect_factor)
        by_environment = log_diagonal(self._factor)
        of_environments = by_environment.sum(axis=0)
        eliminated = 2.0 * (of_others + of_environments)
        self.log_determinant = eliminated + self.remainder.log_determinant

    def _solution(self, explained_data: Array) -> Array:
        """Latents that fit best, (a J + r, W), from the data's column of T, (a, J, W)."""
        solved = self.remainder.solution.T
        fitted = np.einsum("ajkw,kw->ajw", self._explained, solved)
        residual = explained_data - fitted
        deviations = solve_upper(self._factor, residual)
        width = deviations.shape[-1]
        flat = deviations.reshape(self._deviations, width)
        rest = solved[self._effect_count :]
        return np.concatenate([flat, rest])

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, n, a J + K) whose products are the covariance of n combinations."""
        count = len(own)
        width = self._deviation_sd.shape[-1]
        combinations_last = np.moveaxis(own, 0, 2)
        sd = self._deviation_sd[:, None, None]
        scaled = combinations_last[..., None] * sd  # (a, J, n, W)
        for_combinations = self._factor[:, :, :, None]
        whitened = solve_lower(for_combinations, scaled)
        flat = whitened.reshape(-1, count, width)
        of_own = flat.transpose(2, 1, 0)  # L⁻¹x
        explained = self._explained.reshape(self._deviations, -1, width)
        draws_first = explained.transpose(2, 0, 1)
        explained_own = of_own @ draws_first
        remaining = self._remaining_weights(explained_own, rest)
        of_remaining = self.remainder.columns_of(remaining)
        return np.concatenate([of_own, of_remaining], axis=2)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of n combinations, most of whose weights of own deviations are zero.

        L⁻¹ is written out, so that products with the weights can be sparse.
        """
        count = len(own)
        inverse = self._inverse_times_sd()
        width = inverse.shape[-1]
        # (a, a, J, W) Covariance of own deviations if all that remains were known.
        covariance = np.einsum("kajw,kbjw->abjw", inverse, inverse)
        first = own[:, :, None]
        second = own[:, None]
        products = first * second  # (n, a, a, J)
        flat_products = products.reshape(count, -1)
        flat_covariance = covariance.reshape(-1, width)
        sparse_products = sparse.csr_array(flat_products)
        of_own = sparse_products @ flat_covariance
        # L'⁻¹T times the SDs: what each remaining unknown takes from an own deviation.
        taken = np.einsum("kajw,kjrw->ajrw", inverse, self._explained)
        flat_taken = taken.reshape(self._deviations, -1)
        flat_own = own.reshape(count, -1)
        sparse_own = sparse.csr_array(flat_own)
        explained = sparse_own @ flat_taken
        by_unknown = explained.reshape(count, -1, width)
        draws_first = by_unknown.transpose(2, 0, 1)
        remaining = self._remaining_weights(draws_first, rest)
        of_remaining = self.remainder.variances_of(remaining)
        return np.asarray(of_own.T + of_remaining)

    def _inverse_times_sd(self) -> Array:
        """L⁻¹ with each column times the SD of its own deviation, (a, a, J, W)."""
        columns = len(self._factor)
        unit = np.eye(columns)
        one_environment = unit[:, :, None, None]
        every_environment = np.broadcast_to(one_environment, self._factor.shape)
        for_columns = self._factor[:, :, None]
        inverse = solve_lower(for_columns, every_environment)
        return inverse * self._deviation_sd[:, None]

    def _remaining_weights(self, explained: Array, rest: Array) -> Array:
        """Y - T'L⁻¹x, (W, n, K), from T'L⁻¹x and the weights (n, r) of the rest, y."""
        weights = -explained
        weights[:, :, self._effect_count :] += rest
        return weights
