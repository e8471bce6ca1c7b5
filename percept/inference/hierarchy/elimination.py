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
    with_prior,
)

__all__ = ["Elimination", "EnvironmentsFirst", "SubjectsFirst"]

Array = NDArray[np.float64]

#: Least part of a pivot with which laws of locations are read. Their errors are then below 1e-5 of
#: an SD, measured in 40 digits: Monte Carlo errors are some hundred times as large.
_LEAST_PIVOT_OF_LAWS = 1e-10


class Elimination(Protocol):
    """Solved normal equations at W sets of scales; a own deviations of J environments, r others."""

    latents: Array  # (a J + r, W) Those that fit best
    log_determinant: Array  # (W,) Of the joint precision of the latents and all effects
    sound: NDArray[np.bool_]  # (W,) Whether enough digits are left for the density
    laws_sound: NDArray[np.bool_]  # (W,) Whether enough are left for laws of the latents

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

    def __init__(
        self,
        joint: Array,
        explained: Array,
    ) -> None:
        diagonal = np.einsum("wii->wi", joint)
        diagonal_of_r = diagonal[:, :-1].copy()
        joint -= explained @ explained.swapaxes(1, 2)
        rows = joint[:, :-1]
        matrix = rows[:, :, :-1]
        data = rows[:, :, -1]
        self.lower = cholesky(matrix)
        whitened = lower_solve(self.lower, data)
        self.solution = upper_solve(self.lower, whitened)
        pivots = np.einsum("wii->wi", self.lower)
        log_pivots = np.log(pivots)
        self.log_determinant = 2.0 * log_pivots.sum(axis=1)
        squares = pivots * pivots
        kept = squares >= LEAST_PIVOT * diagonal_of_r
        self.sound = kept.all(axis=1)
        kept_by_laws = squares >= _LEAST_PIVOT_OF_LAWS * diagonal_of_r
        self.laws_sound = kept_by_laws.all(axis=1)

    def columns_of(self, weights: Array) -> Array:
        """Columns (W, L, K) of weights (W or 1, L, K)."""
        inverse = np.linalg.inv(self.lower)
        transposed = inverse.swapaxes(1, 2)
        return np.asarray(weights @ transposed)


def _joint(
    blocks: Array,
    blocks_by_rest: Array,
    rest_and_data: Array,
) -> Array:
    """Joint precision of what is left, before elimination, (W, k B + r + 1, k B + r + 1).

    The blocks (k, k, B, W) are the precisions of B independent vectors. The rest and the data stand
    last: by the blocks (k B, r + 1, W), and by one another (r + 1, r + 1, W) without the prior.
    """
    count, _, number, width = blocks.shape
    first = count * number
    size = first + len(rest_and_data)
    joint = np.zeros((width, size, size))
    of_blocks = joint[:, :first]
    of_rest = joint[:, first:]
    corner = of_blocks[:, :, :first]
    by_block = corner.reshape(width, count, number, count, number)
    block = np.arange(number)
    block_first = blocks.transpose(2, 3, 0, 1)
    by_block[:, :, block, :, block] = block_first
    mixed = blocks_by_rest.transpose(2, 0, 1)
    of_blocks[:, :, first:] = mixed
    of_rest[:, :, :first] = mixed.swapaxes(1, 2)
    of_rest[:, :, first:] = rest_and_data.transpose(2, 0, 1)
    rest = np.arange(first, size)
    joint[:, rest, rest] += 1.0
    return joint


class SubjectsFirst:
    """Subjects' effects are eliminated; own deviations and the rest are left."""

    def __init__(self, equations: CellEquations, factor: Array) -> None:
        self._deviation_sd = equations.deviation_sd  # (a, W)
        deviations = equations.problem.deviations
        by_rest = equations.deviations_by_rest
        width = by_rest.shape[-1]
        shape_of_rest = by_rest.shape[2:]
        joint = _joint(
            blocks=with_prior(equations.deviations),
            blocks_by_rest=by_rest.reshape(deviations, *shape_of_rest),
            rest_and_data=equations.rest,
        )
        effect_shape = factor.shape[1:]
        by_effects = equations.deviations_by_effects.reshape(deviations, *effect_shape)
        latents_by_effects = np.concatenate([by_effects, equations.rest_by_effects])
        right = latents_by_effects.swapaxes(0, 1)
        for_latents = factor[:, :, None]
        explained = solve_lower(for_latents, right)  # T, (q, Q + 1, G, W)
        size = joint.shape[1]
        draws_first = explained.transpose(3, 1, 0, 2)
        by_latent = draws_first.reshape(width, size, -1)
        self._remainder = _Remainder(joint, by_latent)
        latents_first = self._remainder.solution.T
        self.latents = np.ascontiguousarray(latents_first)
        subjects = equations.problem.subjects
        of_effects = 2.0 * subjects @ log_diagonal(factor)
        self.log_determinant = of_effects + self._remainder.log_determinant
        self.sound = self._remainder.sound
        self.laws_sound = self._remainder.laws_sound

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, L, K) of weights of own deviations and of the rest."""
        sd = self._deviation_sd[:, None]
        scaled = own[..., None] * sd  # (L, a, J, W)
        count = len(own)
        width = scaled.shape[-1]
        flat = scaled.reshape(count, -1, width)
        deviation_weights = np.moveaxis(flat, -1, 0)
        every_draw = (width, *rest.shape)
        rest_weights = np.broadcast_to(rest, every_draw)
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
        precision = with_prior(equations.deviations)
        self._factor = lower_factor(precision)  # (a, a, J, W)
        of_effects = equations.deviations_by_effects.reshape(
            own, environments, self._effects, width
        )
        of_rest = equations.deviations_by_rest
        columns = np.concatenate([of_effects, of_rest], axis=2)
        for_columns = self._factor[:, :, :, None]
        explained = solve_lower(for_columns, columns)  # T, (a, J, k + 1, W)
        size = self._effects + rest_and_data
        self._explained = explained[:, :, :-1]
        flat = explained.reshape(own * environments, size, width)
        by_rest = equations.rest_by_effects.reshape(rest_and_data, self._effects, width)
        joint = _joint(
            blocks=equations.subject.effect_precision,
            blocks_by_rest=by_rest.swapaxes(0, 1),
            rest_and_data=equations.rest,
        )
        draws_first = flat.transpose(2, 1, 0)
        self._remainder = _Remainder(joint, draws_first)
        self.sound = self._remainder.sound
        self.laws_sound = self._remainder.laws_sound
        solved = self._remainder.solution.T
        fitted = np.einsum("ajkw,kw->ajw", self._explained, solved)
        # The data's column of T, less what effects and the rest account for.
        residual = explained[:, :, -1] - fitted
        deviations = solve_upper(self._factor, residual)
        deviations = deviations.reshape(own * environments, width)
        rest = solved[self._effects :]
        self.latents = np.concatenate([deviations, rest])
        # The remainder holds u = √N b̄ of each pattern, one subject's effects. The effects along the
        # other N - 1 directions have the precision I + Z'H each.
        other_subjects = equations.problem.subjects - 1.0
        of_others = other_subjects @ log_diagonal(factor)
        by_environment = log_diagonal(self._factor)
        of_environments = by_environment.sum(axis=0)
        eliminated = 2.0 * (of_others + of_environments)
        self.log_determinant = eliminated + self._remainder.log_determinant

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (W, L, K) of weights of own deviations and of the rest."""
        count = len(own)
        width = self._deviation_sd.shape[-1]
        weights_last = np.moveaxis(own, 0, 2)
        sd = self._deviation_sd[:, None, None]
        scaled = weights_last[..., None] * sd  # (a, J, L, W)
        for_weights = self._factor[:, :, :, None]
        whitened = solve_lower(for_weights, scaled)
        of_own = whitened.reshape(-1, count, width)
        of_own = of_own.transpose(2, 1, 0)  # L⁻¹a
        deviations = of_own.shape[2]
        explained = self._explained.reshape(deviations, -1, width)
        draws_first = explained.transpose(2, 0, 1)
        weights = -of_own @ draws_first
        weights[:, :, self._effects :] += rest
        remaining = self._remainder.columns_of(weights)
        return np.concatenate([of_own, remaining], axis=2)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, L) of combinations with these weights, most of which are zero."""
        count, columns, _ = own.shape
        width = self._deviation_sd.shape[-1]
        unit = np.eye(columns)
        of_environment = unit[:, :, None, None]
        unit = np.broadcast_to(of_environment, self._factor.shape)
        for_columns = self._factor[:, :, None]
        inverse = solve_lower(for_columns, unit)
        inverse *= self._deviation_sd[:, None]
        covariance = np.einsum("kajw,kbjw->abjw", inverse, inverse)
        products = own[:, :, None] * own[:, None]  # (L, a, a, J)
        flat_products = products.reshape(count, -1)
        sparse_products = sparse.csr_array(flat_products)
        flat_covariance = covariance.reshape(-1, width)
        of_own = sparse_products @ flat_covariance
        solved = np.einsum("kajw,kjrw->ajrw", inverse, self._explained)
        rest_and_effects = solved.shape[2]
        flat = solved.reshape(-1, rest_and_effects * width)
        flat_own = own.reshape(count, -1)
        sparse_own = sparse.csr_array(flat_own)
        explained = sparse_own @ flat
        explained = explained.reshape(count, -1, width)
        weights = -explained.transpose(2, 0, 1)
        weights[:, :, self._effects :] += rest
        remaining = self._remainder.columns_of(weights)
        of_remaining = np.einsum("wlk,wlk->wl", remaining, remaining)
        return np.asarray(of_own.T + of_remaining)
