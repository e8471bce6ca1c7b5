"""Covariance of one subject's cell means, V = D + ZZ', used without being formed.

D is the noise, a small block for each of the subject's E cells. Z are the q columns of the
subject's effects, which are standard normal a priori. All that is needed of V follows from the
weighted columns H = D⁻¹Z and the factor L of the effects' precision, LL' = I + Z'H. With r a vector
of the subject's cell means less their locations,

    log det V = log det D + 2 log det L
    V⁻¹       = D⁻¹ - H (LL')⁻¹ H'
    r'V⁻¹r    = (r - Zb)'D⁻¹(r - Zb) + b'b,    b = (LL')⁻¹H'r

The last line is used for distances: b are the effects that fit r best, and squares are added where
the second line would subtract. Arrays have P quantities, n vectors r and W sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, Vector
from percept.inference.model.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
    with_prior,
)

__all__ = ["SubjectCovariance"]

Array = NDArray[np.float64]


class SubjectCovariance:
    """V = D + ZZ' over the cells of a subject, at W sets of scales.

    Parameters
    ----------
    noise : Block
        D, entries (E, W).
    effects : ndarray
        Z, shape (q, P, E, W).
    """

    def __init__(self, noise: Block, effects: Array) -> None:
        self._noise = noise
        self._effects = effects
        by_quantity = np.moveaxis(effects, 1, 0)
        precision = noise.inverse()
        weighted = precision.apply(tuple(by_quantity))
        #: (q, P, E, W) H.
        self._weighted_effects = np.stack(weighted, axis=1)
        products = np.einsum("apew,bpew->abw", effects, self._weighted_effects)
        #: (q, q, W) L.
        self._factor = lower_factor(with_prior(products))
        #: (q, q, 1, W) L, to be used for n vectors at once.
        self._factor_for_rows = self._factor[:, :, None]

    def log_determinant(self) -> Array:
        """Return log det V, shape (W,)."""
        of_cells = self._noise.log_determinant()
        of_effects = 2.0 * log_diagonal(self._factor)
        return of_cells.sum(axis=0) + of_effects

    def whiten(self, r: Vector) -> list[Vector]:
        """Split vectors (n, E, W) into pieces whose squares sum to r'V⁻¹r."""
        rows = np.stack(r, axis=1)
        whitened = self._whitened_effects_by_draw(rows)
        effects = solve_upper(self._factor_for_rows, whitened)
        unexplained = self._unexplained(rows, effects)
        of_cells = self._noise.whiten(unexplained)
        of_effects = tuple(effects)
        return [of_cells, of_effects]

    def scatter_distance(self, rows: Array) -> Array:
        """Sum of r'V⁻¹r over rows r, (n, P, E, W), or (n, P, E, 1) of constants: shape (W,)."""
        if rows.shape[-1] == 1:
            whitened = self.whitened_effects(rows[..., 0])
        else:
            whitened = self._whitened_effects_by_draw(rows)
        effects = solve_upper(self._factor_for_rows, whitened)
        unexplained = self._unexplained(rows, effects)
        by_cell = self._noise.distance(unexplained)
        of_cells = by_cell.sum(axis=0)
        of_effects = np.einsum("qnw,qnw->w", effects, effects)
        return np.asarray(of_cells + of_effects)

    def draw_effects(self, rows: Array, rng: np.random.Generator) -> Array:
        """Draw subjects' effects (q, n, W) given rows r (n, P, E, W).

        Given r, effects have the mean b and the covariance (LL')⁻¹: b + L'⁻¹ times normal draws.
        """
        whitened = self._whitened_effects_by_draw(rows)
        normals = rng.standard_normal(whitened.shape)
        return solve_upper(self._factor_for_rows, whitened + normals)

    def whitened_effects(self, rows: Array) -> Array:
        """L⁻¹H'r of constant rows r (n, P, E), one product of matrices: shape (q, n, W)."""
        effects, size, cells, width = self._weighted_effects.shape
        by_cell = self._weighted_effects.reshape(effects, size * cells, width)
        flat_rows = rows.reshape(len(rows), size * cells)
        products = flat_rows @ by_cell
        return solve_lower(self._factor_for_rows, products)

    def _whitened_effects_by_draw(self, rows: Array) -> Array:
        """L⁻¹H'r of rows r (n, P, E, W) that differ between draws: shape (q, n, W)."""
        products = np.einsum("npew,qpew->qnw", rows, self._weighted_effects)
        return solve_lower(self._factor_for_rows, products)

    def _unexplained(self, rows: Array, effects: Array) -> Vector:
        """R - Zb of rows r (n, P, E, W or 1) and effects b (q, n, W)."""
        unexplained = []
        for p in range(rows.shape[1]):
            columns = self._effects[:, p]
            explained = np.einsum("qew,qnw->new", columns, effects)
            unexplained.append(rows[:, p] - explained)
        return tuple(unexplained)
