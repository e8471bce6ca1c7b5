"""Normal equations of a linear design, solved with the environments' own deviations first.

What is left are the subjects' effects, q for each of G patterns, and the rest, r coefficients of
fixed terms and slopes: K = q G + r unknowns in this order. The precision A of own deviations is one
block (a, a) for each of J environments. So A^(-1/2) and T of `remainder.subtract` are found
environment by environment. W are the sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.hierarchy.remainder import Remainder
from percept.inference.hierarchy.small_cholesky import (
    log_diagonal,
    solve_lower,
    solve_upper,
)

__all__ = ["EnvironmentsFirst"]

Array = NDArray[np.float64]


class EnvironmentsFirst:
    """Own deviations of environments are eliminated; subjects' effects and the rest are left.

    Parameters
    ----------
    deviation_sd : ndarray
        SDs of the own deviations of each column, (a, W).
    factor : ndarray
        Lower factors of the deviations' precision A in each environment, (a, a, J, W).
    explained : ndarray
        T = A^(-1/2)X, the data last, (a, K + 1, J, W).
    remainder : Remainder
        Precision of the K unknowns that are left: effects first.
    effects : int
        Number of effects among them.

    Attributes
    ----------
    latents, log_determinant
        As in `Elimination`.
    """

    def __init__(
        self,
        deviation_sd: Array,
        factor: Array,
        explained: Array,
        remainder: Remainder,
        effects: int,
    ) -> None:
        self._deviation_sd = deviation_sd
        self._factor = factor
        #: T without the data's column, (a, K, J, W).
        self._explained = explained[:, :-1]
        self._effect_count = effects
        columns, _, environments, _ = explained.shape
        self._deviations = columns * environments
        self.remainder = remainder
        self.latents = self._solution(explained[:, -1])
        of_environments = log_diagonal(factor).sum(axis=0)
        self.log_determinant = 2.0 * of_environments + remainder.log_determinant

    def _solution(self, explained_data: Array) -> Array:
        """Latents that fit best, (a J + r, W), from the data's column of T, (a, J, W)."""
        solved = self.remainder.solution
        fitted = np.einsum("akjw,kw->ajw", self._explained, solved)
        deviations = solve_upper(self._factor, explained_data - fitted)
        flat = deviations.reshape(self._deviations, solved.shape[-1])
        rest = solved[self._effect_count :]
        return np.concatenate([flat, rest])

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (a J + K, n, W) whose products are the covariance of n combinations."""
        combinations_last = np.moveaxis(own, 0, -1)
        sd = self._deviation_sd[:, None, None]
        scaled = combinations_last[..., None] * sd  # (a, J, n, W)
        whitened = solve_lower(self._factor[:, :, :, None], scaled)  # A^(-1/2)x
        explained = np.einsum("akjw,ajnw->knw", self._explained, whitened)
        of_remaining = self.remainder.columns_of(self._remaining_weights(explained, rest))
        count, width = whitened.shape[2:]
        of_own = whitened.reshape(self._deviations, count, width)
        return np.concatenate([of_own, of_remaining])

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of n combinations, most of whose weights of own deviations are zero.

        A^(-1/2) is written out, so that products with the weights can be sparse.
        """
        count, columns, _ = own.shape
        inverse = self._inverse_times_sd()
        width = inverse.shape[-1]
        # (a, a, J, W) Covariance of own deviations if all that remains were known.
        covariance = np.einsum("kajw,kbjw->abjw", inverse, inverse)
        first = own[:, :, None]
        second = own[:, None]
        products = first * second  # (n, a, a, J)
        entries = columns * self._deviations
        flat_products = products.reshape(count, entries)
        flat_covariance = covariance.reshape(entries, width)
        sparse_products = sparse.csr_array(flat_products)
        of_own = sparse_products @ flat_covariance
        # T'A^(-1/2) times the SDs: what each remaining unknown takes from an own deviation.
        taken = np.einsum("kajw,krjw->ajrw", inverse, self._explained)
        unknowns = taken.shape[2]
        flat_taken = taken.reshape(self._deviations, unknowns * width)
        flat_own = own.reshape(count, self._deviations)
        sparse_own = sparse.csr_array(flat_own)
        explained = sparse_own @ flat_taken
        by_unknown = explained.reshape(count, unknowns, width).swapaxes(0, 1)
        columns = self.remainder.columns_of(self._remaining_weights(by_unknown, rest))
        of_remaining = np.einsum("knw,knw->nw", columns, columns)
        variances = of_own + of_remaining
        return np.asarray(variances.T)

    def _inverse_times_sd(self) -> Array:
        """A^(-1/2) with each column times the SD of its own deviation, (a, a, J, W)."""
        columns = len(self._factor)
        unit = np.eye(columns)
        one_environment = unit[:, :, None, None]
        every_environment = np.broadcast_to(one_environment, self._factor.shape)
        for_columns = self._factor[:, :, None]
        inverse = solve_lower(for_columns, every_environment)
        return inverse * self._deviation_sd[:, None]

    def _remaining_weights(self, explained: Array, rest: Array) -> Array:
        """Weights y - T'A^(-1/2)x, (K, n, W), from T'A^(-1/2)x and the rest's y, (n, r)."""
        weights = -explained
        weights[self._effect_count :] += rest.T[..., None]
        return weights
