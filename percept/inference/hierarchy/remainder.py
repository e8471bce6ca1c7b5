"""What is left of normal equations when some unknowns are eliminated.

The unknowns are standard normal a priori, and their joint precision is [[A, X], [X', R]]: A of the
n unknowns to eliminate, R of the K that remain, X of both. With A = LL' and T = L⁻¹X, the unknowns
that remain have the precision

    M = R - T'T

X and R carry one more column, the data, and so do T and the difference. That column of M is the
right side of the equations for the unknowns that remain.

The difference loses digits where T'T is nearly all of R. Pivots of M's Cholesky factor over the
diagonal of R tell what part is left. Arrays of this module have their W sets of scales first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.information import LEAST_PIVOT
from percept.inference.hierarchy.stacked_cholesky import (
    stacked_factor,
    stacked_solve_lower,
    stacked_solve_upper,
)

__all__ = ["Remainder", "joined"]

Array = NDArray[np.float64]

#: Least part of a pivot with which laws of locations are read. Their errors are then below 1e-5 of
#: an SD, measured in 40 digits: Monte Carlo errors are some hundred times as large.
_LEAST_PIVOT_OF_LAWS = 1e-10


class Remainder:
    """The matrix M = R - T'T, factored.

    Parameters
    ----------
    joint : ndarray
        R with the prior's one, the data last, (W, K + 1, K + 1). It is overwritten.
    explained : ndarray
        T', the data last, (W, K + 1, n).

    Attributes
    ----------
    solution : ndarray
        The K unknowns that fit best, (W, K).
    log_determinant : ndarray
        Of M, (W,).
    sound : ndarray of bool
        Whether enough digits are left for the density, (W,).
    laws_sound : ndarray of bool
        Whether enough digits are left for laws of the unknowns, (W,).
    """

    def __init__(self, joint: Array, explained: Array) -> None:
        diagonal = np.einsum("wii->wi", joint)
        diagonal_of_r = diagonal[:, :-1].copy()
        transposed = explained.swapaxes(1, 2)
        joint -= explained @ transposed
        rows = joint[:, :-1]
        matrix = rows[:, :, :-1]
        data = rows[:, :, -1]
        self._factor = stacked_factor(matrix)
        whitened = stacked_solve_lower(self._factor, data)
        self.solution = stacked_solve_upper(self._factor, whitened)
        pivots = np.einsum("wii->wi", self._factor)
        log_pivots = np.log(pivots)
        self.log_determinant = 2.0 * log_pivots.sum(axis=1)
        squares = pivots * pivots
        kept = squares >= LEAST_PIVOT * diagonal_of_r
        self.sound = kept.all(axis=1)
        kept_by_laws = squares >= _LEAST_PIVOT_OF_LAWS * diagonal_of_r
        self.laws_sound = kept_by_laws.all(axis=1)

    def columns_of(self, weights: Array) -> Array:
        """Weights (W or 1, l, K) times M^(-1/2): their products are the covariance, (W, l, K)."""
        inverse = np.linalg.inv(self._factor)
        transposed = inverse.swapaxes(1, 2)
        return np.asarray(weights @ transposed)

    def variances_of(self, weights: Array) -> Array:
        """Variances (W, l) of combinations with weights (W or 1, l, K)."""
        columns = self.columns_of(weights)
        return np.einsum("wlk,wlk->wl", columns, columns)


def joined(blocks: Array, blocks_by_rest: Array, rest: Array) -> Array:
    """Write out R with the prior's one: blocks on the diagonal, and last the rest and the data.

    Parameters
    ----------
    blocks : ndarray
        Precisions of B vectors of k unknowns, independent given all others, with the prior's one,
        (k, k, B, W). Unknown by unknown they stand in one row: number i of vector v is at i B + v.
    blocks_by_rest : ndarray
        These k B unknowns by the rest, the data last, (k B, r + 1, W).
    rest : ndarray
        The rest by itself, the data last, without the prior's one, (r + 1, r + 1, W).

    Returns
    -------
    ndarray
        Shape (W, K + 1, K + 1), K = k B + r.
    """
    count, _, number, width = blocks.shape
    first = count * number
    size = first + len(rest)
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
    of_rest[:, :, first:] = rest.transpose(2, 0, 1)
    diagonal_of_rest = np.arange(first, size)
    joint[:, diagonal_of_rest, diagonal_of_rest] += 1.0
    return joint
