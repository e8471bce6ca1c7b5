"""Normal equations of a linear design, solved with one group of unknowns eliminated first.

The unknowns are own deviations, a in each of J environments; subjects' effects, q in each of G
patterns; and the rest, r coefficients of fixed terms and slopes. Effects of two subjects are
independent given the others, and so are own deviations of two environments. So either group is
eliminated block by block, and costs little; the cost of what remains grows with the cube of its
number. The larger group goes first.

All unknowns are standard normal a priori, and their joint precision is [[A, X], [X', Y]], A of the
group that is eliminated. With powers like A^(-1/2) for inverses of lower Cholesky factors,

    T = A^(-1/2)X,  M = Y - T'T

and M is the precision of the K unknowns that remain. The data are one more column of X and Y, and
last: the right side of the equations. A combination with weights x of what is eliminated and y of
what remains has the variance

    |A^(-1/2)x|² + |M^(-1/2)(y - T'A^(-1/2)x)|²

The difference M loses digits where T'T is nearly all of Y. W are the sets of scales, last so that
each step of a factorisation is one pass over all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.small_cholesky import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)

__all__ = ["OwnFirst", "SubjectsFirst", "subtract"]

Array = NDArray[np.float64]


def subtract(joint: Array, explained: Array) -> Array:
    """Turn Y into M = Y - T'T, in place.

    Parameters
    ----------
    joint : ndarray
        Y, the data last, (K + 1, K + 1, W); its lower triangle counts.
    explained : ndarray
        T of B independent vectors of k eliminated unknowns, the data last, (k, K + 1, B, W).

    Returns
    -------
    ndarray
        Diagonal of Y before, (K, W): the part of it that a pivot of M keeps tells its digits.
    """
    diagonal = np.einsum("kkw->kw", joint)[:-1].copy()
    for row in range(len(joint)):
        end = row + 1
        columns = explained[:, :end]
        joint[row, :end] -= np.einsum("kbw,kcbw->cw", explained[:, row], columns)
    return diagonal


class _Remaining:
    """What remains, by M with the data last, (K + 1, K + 1, W); its lower triangle is read."""

    def __init__(self, joint: Array) -> None:
        size = len(joint) - 1
        # The row of the data below the square becomes M^(-1/2) times the right side.
        factor = lower_factor(joint[:, :size])
        self._factor = factor[:size]
        self.solution = solve_upper(self._factor, factor[size])  # (K, W) Those that fit best
        self.log_determinant = 2.0 * log_diagonal(self._factor)
        self.pivots = np.einsum("kkw->kw", self._factor) ** 2

    def columns_of(self, weights: Array) -> Array:
        """M^(-1/2) times weights (K, l, W or 1): their products are the covariance, (K, l, W)."""
        for_combinations = self._factor[:, :, None]
        return solve_lower(for_combinations, weights)


class SubjectsFirst:
    """Subjects' effects are eliminated; own deviations and then the rest remain.

    Parameters
    ----------
    deviation_sd : ndarray
        SDs of the own deviations of each column, (a, W).
    joint : ndarray
        M, the data last, (K + 1, K + 1, W).

    Attributes
    ----------
    latents : ndarray
        Own deviations and the rest that fit best, (a J + r, W).
    log_determinant : ndarray
        Of the joint precision, (W,).
    pivots : ndarray
        Of M, (K, W).
    """

    def __init__(self, deviation_sd: Array, joint: Array) -> None:
        self._deviation_sd = deviation_sd
        self._remaining = _Remaining(joint)
        self.latents = self._remaining.solution
        self.log_determinant = self._remaining.log_determinant
        self.pivots = self._remaining.pivots

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W) whose products are the covariance of n combinations of latents."""
        of_own = _in_units_of_prior(own, self._deviation_sd)
        of_own = of_own.reshape(own[0].size, *of_own.shape[2:])
        of_rest = np.broadcast_to(rest.T[..., None], (rest.shape[1], *of_own.shape[1:]))
        return self._remaining.columns_of(np.concatenate([of_own, of_rest]))

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations of latents."""
        columns = self.columns_of(own, rest)
        return np.einsum("knw,knw->wn", columns, columns)


class OwnFirst:
    """Own deviations of environments are eliminated; effects and then the rest remain.

    Parameters
    ----------
    deviation_sd : ndarray
        SDs of the own deviations of each column, (a, W).
    factor : ndarray
        Lower factors of their precision A in each environment, (a, a, J, W).
    explained : ndarray
        T, the data last, (a, K + 1, J, W).
    joint : ndarray
        M, the data last, (K + 1, K + 1, W).
    effects : int
        Number of effects among the K unknowns.

    Attributes
    ----------
    latents, log_determinant, pivots
        As in `SubjectsFirst`.
    """

    def __init__(
        self,
        deviation_sd: Array,
        factor: Array,
        explained: Array,
        joint: Array,
        effects: int,
    ) -> None:
        self._deviation_sd = deviation_sd
        self._factor = factor
        #: T without the data's column, (a, K, J, W).
        self._explained = explained[:, :-1]
        self._effects = effects
        self._remaining = _Remaining(joint)
        solved = self._remaining.solution
        fitted = np.einsum("akjw,kw->ajw", self._explained, solved)
        deviations = solve_upper(factor, explained[:, -1] - fitted)
        flat = deviations.reshape(fitted[..., 0].size, solved.shape[-1])
        self.latents = np.concatenate([flat, solved[effects:]])
        of_deviations = 2.0 * log_diagonal(factor).sum(axis=0)
        self.log_determinant = of_deviations + self._remaining.log_determinant
        self.pivots = self._remaining.pivots

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (a J + K, n, W) whose products are the covariance of n combinations."""
        scaled = _in_units_of_prior(own, self._deviation_sd)
        whitened = solve_lower(self._factor[:, :, :, None], scaled)  # A^(-1/2)x
        explained = np.einsum("akjw,ajnw->knw", self._explained, whitened)
        of_remaining = self._remaining.columns_of(self._weights(explained, rest))
        of_own = whitened.reshape(own[0].size, *whitened.shape[2:])
        return np.concatenate([of_own, of_remaining])

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of n combinations, most of whose weights of own deviations are zero.

        A^(-1/2) is written out, so that products with the weights can be sparse.
        """
        count, columns, environments = own.shape
        deviations = columns * environments
        unit = np.broadcast_to(np.eye(columns)[:, :, None, None], self._factor.shape)
        inverse = solve_lower(self._factor[:, :, None], unit) * self._deviation_sd[:, None]
        width = inverse.shape[-1]
        # (a, a, J, W) Covariance of own deviations if all that remains were known.
        covariance = np.einsum("kajw,kbjw->abjw", inverse, inverse)
        products = own[:, :, None] * own[:, None]  # (n, a, a, J)
        entries = columns * deviations
        sparse_products = sparse.csr_array(products.reshape(count, entries))
        of_own = sparse_products @ covariance.reshape(entries, width)
        # T'A^(-1/2) times the SDs: what each remaining unknown takes from an own deviation.
        taken = np.einsum("kajw,krjw->ajrw", inverse, self._explained)
        unknowns = taken.shape[2]
        sparse_own = sparse.csr_array(own.reshape(count, deviations))
        explained = sparse_own @ taken.reshape(deviations, unknowns * width)
        by_unknown = explained.reshape(count, unknowns, width).swapaxes(0, 1)
        of_remaining = self._remaining.columns_of(self._weights(by_unknown, rest))
        variances = of_own + np.einsum("knw,knw->nw", of_remaining, of_remaining)
        return np.asarray(variances.T)

    def _weights(self, explained: Array, rest: Array) -> Array:
        """Weights y - T'A^(-1/2)x, (K, n, W), from T'A^(-1/2)x and the rest's y, (n, r)."""
        weights = -explained
        weights[self._effects :] += rest.T[..., None]
        return weights


def _in_units_of_prior(own: Array, deviation_sd: Array) -> Array:
    """Weights (n, a, J) of own deviations times their SDs (a, W): (a, J, n, W)."""
    combinations_last = np.moveaxis(own, 0, -1)
    return np.asarray(combinations_last[..., None] * deviation_sd[:, None, None])
