"""What is left of normal equations when some unknowns are eliminated.

The unknowns are standard normal a priori, and their joint precision is [[A, X], [X', Y]]: A of the
unknowns to eliminate, Y of the K that remain, X of both. Powers like A^(-1/2) stand for inverses of
lower Cholesky factors. With T = A^(-1/2)X, the unknowns that remain have the precision

    M = Y - T'T

X and Y carry one more column, the data, and so do T and the difference. That column of M is the
right side of the equations for the unknowns that remain.

The difference loses digits where T'T is nearly all of Y. Pivots of M's Cholesky factor over the
diagonal of Y tell what part is left. The last axis has the W sets of scales, so that each step of
the factorisation is one pass over all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.information import LEAST_PIVOT
from percept.inference.hierarchy.small_cholesky import lower_factor, solve_lower, solve_upper

__all__ = ["Remainder"]

Array = NDArray[np.float64]

#: Least part of a pivot with which laws of locations are read. Their errors are then below 1e-5 of
#: an SD, measured in 40 digits: Monte Carlo errors are some hundred times as large.
_LEAST_PIVOT_OF_LAWS = 1e-10


class Remainder:
    """The matrix M = Y - T'T, factored.

    Parameters
    ----------
    joint : ndarray
        Y with the prior's one, the data last, (K + 1, K + 1, W). Only the lower triangle is read,
        and it is overwritten.
    explained : ndarray
        T of B independent vectors of k eliminated unknowns, the data last, (k, K + 1, B, W).

    Attributes
    ----------
    solution : ndarray
        The K unknowns that fit best, (K, W).
    log_determinant : ndarray
        Of M, (W,).
    sound : ndarray of bool
        Whether enough digits are left for the density, (W,).
    laws_sound : ndarray of bool
        Whether enough digits are left for laws of the unknowns, (W,).
    """

    def __init__(self, joint: Array, explained: Array) -> None:
        size = len(joint) - 1
        diagonal = np.einsum("kkw->kw", joint)
        diagonal_of_y = diagonal[:size].copy()
        for row in range(len(joint)):
            end = row + 1
            columns = explained[:, :end]
            joint[row, :end] -= np.einsum("kbw,kcbw->cw", explained[:, row], columns)
        # The row of the data below the square becomes M^(-1/2) times the right side.
        factor = lower_factor(joint[:, :size])
        self._factor = factor[:size]
        self.solution = solve_upper(self._factor, factor[size])
        pivots = np.einsum("kkw->kw", self._factor)
        log_pivots = np.log(pivots)
        self.log_determinant = 2.0 * log_pivots.sum(axis=0)
        squares = pivots * pivots
        kept = squares >= LEAST_PIVOT * diagonal_of_y
        self.sound = kept.all(axis=0)
        kept_by_laws = squares >= _LEAST_PIVOT_OF_LAWS * diagonal_of_y
        self.laws_sound = kept_by_laws.all(axis=0)

    def columns_of(self, weights: Array) -> Array:
        """M^(-1/2) times weights (K, l, W or 1): their products are the covariance, (K, l, W)."""
        for_combinations = self._factor[:, :, None]
        return solve_lower(for_combinations, weights)
