"""What is left of normal equations when some unknowns are eliminated, factored.

The K unknowns that remain have the precision M. It carries one more column, the data: the right
side of their equations. The last axis has the W sets of scales, so that each step of the
factorisation is one pass over all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.small_cholesky import lower_factor, solve_lower, solve_upper

__all__ = ["Remainder", "subtract"]

Array = NDArray[np.float64]


def subtract(joint: Array, explained: Array) -> None:
    """Turn Y into Y - T'T, in place.

    The joint precision of all unknowns, standard normal a priori, is [[A, X], [X', Y]], A of those
    to eliminate. With powers like A^(-1/2) for inverses of lower Cholesky factors, T = A^(-1/2)X.
    The difference loses digits where T'T is nearly all of Y.

    Parameters
    ----------
    joint : ndarray
        Y with the prior's one, the data last, (K + 1, K + 1, W); its lower triangle counts.
    explained : ndarray
        T of B independent vectors of k eliminated unknowns, the data last, (k, K + 1, B, W).
    """
    for row in range(len(joint)):
        end = row + 1
        columns = explained[:, :end]
        joint[row, :end] -= np.einsum("kbw,kcbw->cw", explained[:, row], columns)


class Remainder:
    """The matrix M, factored.

    Parameters
    ----------
    joint : ndarray
        M, the data last, (K + 1, K + 1, W). Only the lower triangle is read.

    Attributes
    ----------
    solution : ndarray
        The K unknowns that fit best, (K, W).
    log_determinant : ndarray
        Of M, (W,).
    pivots : ndarray
        Squares of the factor's diagonal, (K, W): what the data and the other unknowns leave.
    """

    def __init__(self, joint: Array) -> None:
        size = len(joint) - 1
        # The row of the data below the square becomes M^(-1/2) times the right side.
        factor = lower_factor(joint[:, :size])
        self._factor = factor[:size]
        self.solution = solve_upper(self._factor, factor[size])
        roots = np.einsum("kkw->kw", self._factor)
        self.log_determinant = 2.0 * np.log(roots).sum(axis=0)
        self.pivots = roots * roots

    def columns_of(self, weights: Array) -> Array:
        """M^(-1/2) times weights (K, l, W or 1): their products are the covariance, (K, l, W)."""
        for_combinations = self._factor[:, :, None]
        return solve_lower(for_combinations, weights)
