"""Normal equations of a linear design, solved with the subjects' effects eliminated first.

What is left are the latents: a own deviations in each of J environments, and the rest, r
coefficients of fixed terms and slopes, K = a J + r in this order. Whitened effects have the
precision one, so T of `remainder.subtract` are the products of latents with them. W are the sets
of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.remainder import Remainder, subtract

__all__ = ["SubjectsFirst"]

Array = NDArray[np.float64]


class SubjectsFirst:
    """Subjects' effects are eliminated; own deviations and the rest are left.

    Parameters
    ----------
    equations : CellEquations
        The normal equations at W sets of scales.

    Attributes
    ----------
    latents, log_determinant
        As in `Elimination`.
    kept : ndarray
        Least part of a pivot that the elimination has left, (W,).
    """

    def __init__(self, equations: CellEquations) -> None:
        self._deviation_sd = equations.deviation_sd
        joint = _joint_precision(equations)
        whole = np.einsum("kkw->kw", joint)[:-1].copy()
        subtract(joint, equations.effects_by_latents)
        self.remainder = Remainder(joint)
        self.kept = (self.remainder.pivots / whole).min(axis=0, initial=1.0)
        self.latents = self.remainder.solution
        self.log_determinant = self.remainder.log_determinant

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W) whose products are the covariance of n combinations of latents."""
        count = len(own)
        sd = self._deviation_sd[:, None, None]
        combinations_last = np.moveaxis(own, 0, -1)
        scaled = combinations_last[..., None] * sd  # (a, J, n, W)
        width = scaled.shape[-1]
        of_own = scaled.reshape(own[0].size, count, width)
        every_draw = (rest.shape[1], count, width)
        of_rest = np.broadcast_to(rest.T[..., None], every_draw)
        weights = np.concatenate([of_own, of_rest])
        return self.remainder.columns_of(weights)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations of latents."""
        columns = self.columns_of(own, rest)
        return np.einsum("knw,knw->wn", columns, columns)


def _joint_precision(equations: CellEquations) -> Array:
    """Lower triangle of the latents' precision, the data last: (K + 1, K + 1, W)."""
    columns, environments, rest, width = equations.deviations_by_rest.shape
    own = columns * environments
    size = own + rest
    joint = np.zeros((size, size, width))
    environment = np.arange(environments)
    for first in range(columns):
        for second in range(columns):
            rows = first * environments + environment
            others = second * environments + environment
            joint[rows, others] = equations.deviations[first, second]
    by_rest = equations.deviations_by_rest.reshape(own, rest, width)
    joint[own:, :own] = by_rest.swapaxes(0, 1)
    joint[own:, own:] = equations.rest.swapaxes(0, 1)
    diagonal = np.arange(size)
    joint[diagonal, diagonal] += 1.0
    return joint
