"""Two ways to solve the normal equations of a linear design: subjects or environments go first.

Effects of two subjects are independent given the latents, and own deviations of two environments
given the rest. Either group is eliminated block by block, and Cholesky factors the remainder. The
precision is [[A, X], [X', R]], with A = LL' of what is eliminated. With T = L⁻¹X and the remainder
M = R - T'T, a combination with the weights a and b has the variance

    |L⁻¹a|² + |M^(-1/2)(b - T'L⁻¹a)|²

The difference loses digits where what is eliminated dwarfs the rest. The pivots of M tell how many.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.hierarchy.blocks import cholesky
from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.information import LEAST_PIVOT, lower_solve, upper_solve
from percept.inference.hierarchy.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)

__all__ = ["Elimination", "EnvironmentsFirst", "SubjectsFirst"]

Array = NDArray[np.float64]


class Elimination(Protocol):
    """Solved normal equations at W sets of scales; a own deviations of J environments, r others."""

    latents: Array  # (a J + r, W) Those that fit best
    log_determinant: Array  # (W,) Of the joint precision of the latents and all effects
    sound: NDArray[np.bool_]  # (W,) Whether enough digits are left

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, L, K) whose products are the covariance of combinations of latents.

        Parameters
        ----------
        own : ndarray
            Weights of own deviations, (L, a, J).
        rest : ndarray
            Weights of the rest, (L, r).
        """

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, L) of combinations with such weights."""


class _Remainder:
    """The matrix M = R - T'T that an elimination leaves, factored.

    R and the columns T' (W, k + 1, K) hold the data last.
    """

    def __init__(self, joint: Array, explained: Array) -> None:
        diagonal_of_r = np.einsum("wii->wi", joint)[:, :-1].copy()
        joint -= explained @ explained.swapaxes(1, 2)
        matrix = joint[:, :-1, :-1]
        data = joint[:, :-1, -1]
        self.lower = cholesky(matrix)
        whitened = lower_solve(self.lower, data)
        self.solution = upper_solve(self.lower, whitened)
        pivots = np.einsum("wii->wi", self.lower)
        log_pivots = np.log(pivots)
        self.log_determinant = 2.0 * log_pivots.sum(axis=1)
        kept = pivots * pivots >= LEAST_PIVOT * diagonal_of_r
        self.sound = kept.all(axis=1)

    def columns_of(self, weights: Array) -> Array:
        """Columns (W, L, K) of weights (W or 1, L, K)."""
        inverse = np.linalg.inv(self.lower)
        return np.asarray(weights @ inverse.swapaxes(1, 2))


class SubjectsFirst:
    """Subjects' effects are eliminated; own deviations and the rest are left."""

    def __init__(self, equations: CellEquations, factor: Array) -> None:
        self._deviation_sd = equations.deviation_sd  # (a, W)
        joint = self._joint(equations)
        deviations = equations.problem.deviations
        by_effects = equations.deviations_by_effects.reshape(deviations, *factor.shape[1:])
        latents_by_effects = np.concatenate([by_effects, equations.rest_by_effects])
        right = latents_by_effects.swapaxes(0, 1)
        explained = solve_lower(factor[:, :, None], right)  # T, (q, Q + 1, G, W)
        width, size = joint.shape[:2]
        draws_first = explained.transpose(3, 1, 0, 2)
        self._remainder = _Remainder(joint, draws_first.reshape(width, size, -1))
        self.latents = np.ascontiguousarray(self._remainder.solution.T)
        subjects = equations.problem.subjects
        of_effects = 2.0 * subjects @ log_diagonal(factor)
        self.log_determinant = of_effects + self._remainder.log_determinant
        self.sound = self._remainder.sound

    def _joint(self, equations: CellEquations) -> Array:
        """Precision of the latents, data last, before subjects' effects go, (W, Q + 1, Q + 1)."""
        own, environments, rest_and_data, width = equations.deviations_by_rest.shape
        count = own * environments
        size = count + rest_and_data
        joint = np.zeros((width, size, size))
        corner = joint[:, :count, :count]
        blocks = corner.reshape(width, own, environments, own, environments)
        environment = np.arange(environments)
        blocks[:, :, environment, :, environment] = equations.deviations.transpose(2, 3, 0, 1)
        mixed = equations.deviations_by_rest.reshape(count, rest_and_data, width)
        mixed = mixed.transpose(2, 0, 1)
        joint[:, :count, count:] = mixed
        joint[:, count:, :count] = mixed.swapaxes(1, 2)
        joint[:, count:, count:] = equations.rest_and_data.transpose(2, 0, 1)
        diagonal = np.arange(size)
        joint[:, diagonal, diagonal] += 1.0
        return joint

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, L, K) of weights of own deviations and of the rest."""
        scaled = own[..., None] * self._deviation_sd[:, None]  # (L, a, J, W)
        width = scaled.shape[-1]
        flat = scaled.reshape(len(own), -1, width)
        deviation_weights = np.moveaxis(flat, -1, 0)
        rest_weights = np.broadcast_to(rest, (width, *rest.shape))
        weights = np.concatenate([deviation_weights, rest_weights], axis=2)
        return self._remainder.columns_of(weights)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, L) of combinations with these weights."""
        columns = self.columns_of(own, rest)
        return np.einsum("wlk,wlk->wl", columns, columns)


class EnvironmentsFirst:
    """Own deviations of environments are eliminated; subjects' effects and the rest are left."""

    def __init__(self, equations: CellEquations, factor: Array) -> None:
        self._deviation_sd = equations.deviation_sd  # (a, W)
        own, environments, rest_and_data, width = equations.deviations_by_rest.shape
        count, patterns = factor.shape[1:3]
        self._effects = count * patterns
        precision = equations.deviations.copy()
        diagonal = np.arange(own)
        precision[diagonal, diagonal] += 1.0
        self._factor = lower_factor(precision)  # (a, a, J, W)
        of_effects = equations.deviations_by_effects.reshape(
            own, environments, self._effects, width
        )
        columns = np.concatenate([of_effects, equations.deviations_by_rest], axis=2)
        explained = solve_lower(self._factor[:, :, :, None], columns)  # T, (a, J, k + 1, W)
        size = self._effects + rest_and_data
        self._explained = explained[:, :, :-1]
        flat = explained.reshape(own * environments, size, width)
        joint = self._joint(equations)
        self._remainder = _Remainder(joint, flat.transpose(2, 1, 0))
        self.sound = self._remainder.sound
        solved = self._remainder.solution.T
        fitted = np.einsum("ajkw,kw->ajw", self._explained, solved)
        # The data's column of T, less what effects and the rest account for.
        residual = explained[:, :, -1] - fitted
        deviations = solve_upper(self._factor, residual)
        deviations = deviations.reshape(own * environments, width)
        self.latents = np.concatenate([deviations, solved[self._effects :]])
        # The remainder has the effects of one subject of each pattern.
        other_subjects = equations.problem.subjects - 1.0
        of_others = other_subjects @ log_diagonal(factor)
        of_environments = log_diagonal(self._factor).sum(axis=0)
        eliminated = 2.0 * (of_others + of_environments)
        self.log_determinant = eliminated + self._remainder.log_determinant

    def _joint(self, equations: CellEquations) -> Array:
        """Precision of effects and the rest, data last, before own deviations go."""
        count, _, patterns, width = equations.effects.shape
        effects = self._effects
        rest_and_data = len(equations.rest_and_data)
        size = effects + rest_and_data
        joint = np.zeros((width, size, size))
        corner = joint[:, :effects, :effects]
        blocks = corner.reshape(width, count, patterns, count, patterns)
        pattern = np.arange(patterns)
        blocks[:, :, pattern, :, pattern] = equations.effects.transpose(2, 3, 0, 1)
        mixed = equations.rest_by_effects.reshape(rest_and_data, effects, width)
        mixed = mixed.transpose(2, 0, 1)
        joint[:, effects:, :effects] = mixed
        joint[:, :effects, effects:] = mixed.swapaxes(1, 2)
        joint[:, effects:, effects:] = equations.rest_and_data.transpose(2, 0, 1)
        diagonal = np.arange(effects, size)
        joint[:, diagonal, diagonal] += 1.0
        return joint

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, L, K) of weights of own deviations and of the rest."""
        count = len(own)
        width = self._deviation_sd.shape[-1]
        weights_last = np.moveaxis(own, 0, 2)[..., None]
        scaled = weights_last * self._deviation_sd[:, None, None]  # (a, J, L, W)
        whitened = solve_lower(self._factor[:, :, :, None], scaled)
        of_own = whitened.reshape(-1, count, width)
        of_own = of_own.transpose(2, 1, 0)  # L⁻¹a
        explained = self._explained.reshape(of_own.shape[2], -1, width)
        weights = -of_own @ explained.transpose(2, 0, 1)
        weights[:, :, self._effects :] += rest
        remaining = self._remainder.columns_of(weights)
        return np.concatenate([of_own, remaining], axis=2)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, L) of combinations with these weights, most of which are zero."""
        count, columns, _ = own.shape
        width = self._deviation_sd.shape[-1]
        unit = np.eye(columns)[:, :, None, None]
        unit = np.broadcast_to(unit, self._factor.shape)
        inverse = solve_lower(self._factor[:, :, None], unit)
        inverse *= self._deviation_sd[:, None]
        covariance = np.einsum("kajw,kbjw->abjw", inverse, inverse)
        products = own[:, :, None] * own[:, None]  # (L, a, a, J)
        sparse_products = sparse.csr_array(products.reshape(count, -1))
        of_own = sparse_products @ covariance.reshape(-1, width)
        solved = np.einsum("kajw,kjrw->ajrw", inverse, self._explained)
        flat = solved.reshape(-1, solved.shape[2] * width)
        sparse_own = sparse.csr_array(own.reshape(count, -1))
        explained = sparse_own @ flat
        explained = explained.reshape(count, -1, width)
        weights = -explained.transpose(2, 0, 1)
        weights[:, :, self._effects :] += rest
        remaining = self._remainder.columns_of(weights)
        of_remaining = np.einsum("wlk,wlk->wl", remaining, remaining)
        return np.asarray(of_own.T + of_remaining)
