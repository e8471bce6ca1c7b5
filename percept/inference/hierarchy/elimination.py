"""Two orders in which the normal equations of a linear design are solved, and the choice of one.

Effects of two subjects are independent given the latents, and own deviations of two environments
given the rest. Either group is eliminated block by block (`SubjectsFirst`, `EnvironmentsFirst`),
and `Remainder` holds what is left. Cost grows with the cube of what is left. So the larger group
goes first.

With A the precision of what is eliminated, and T and M as in `remainder`, a combination with
weights x of what is eliminated and y of what is left has the variance

    |A^(-1/2)x|² + |M^(-1/2)(y - T'A^(-1/2)x)|²
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.cell_equations import CellEquations
from percept.inference.hierarchy.environments_first import EnvironmentsFirst
from percept.inference.hierarchy.remainder import Remainder, subtract
from percept.inference.hierarchy.small_cholesky import lower_factor, solve_lower, with_prior
from percept.inference.hierarchy.subjects_first import SubjectsFirst

__all__ = ["Elimination", "Solved", "solve"]

Array = NDArray[np.float64]


class Solved(Protocol):
    """Latents at W sets of scales: a own deviations in each of J environments, and r others."""

    latents: Array  # (a J + r, W) Those that fit best: own deviations, then the r of the rest

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W) whose products are the covariance of n combinations of latents.

        Parameters
        ----------
        own : ndarray
            Weights of the deviations themselves, in response units, (n, a, J). Effects have none.
        rest : ndarray
            Weights of the other latents, which are standard normal, (n, r).
        """

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n) of combinations with such weights."""


class Elimination(Solved, Protocol):
    """Normal equations solved."""

    log_determinant: Array  # (W,) Of the joint precision of latents and whitened effects


def solve(equations: CellEquations) -> tuple[Elimination, Array]:
    """Solve the normal equations, in the order that leaves the smaller matrix.

    Parameters
    ----------
    equations : CellEquations
        The normal equations at W sets of scales.

    Returns
    -------
    Elimination
    kept : ndarray
        Least part of a pivot that the elimination has left, (W,): the part of its digits.
    """
    effects = len(equations.effects_by_latents)
    if equations.problem.eliminates_environments(effects):
        return _environments_first(equations)
    solved = SubjectsFirst(equations)
    return solved, solved.kept


def _environments_first(equations: CellEquations) -> tuple[EnvironmentsFirst, Array]:
    """Eliminate own deviations."""
    columns, environments, _, width = equations.deviations_by_rest.shape
    effects, _, patterns, _ = equations.effects_by_latents.shape
    own = columns * environments
    factor = lower_factor(with_prior(equations.deviations))  # (a, a, J, W)
    by_own = equations.effects_by_latents[:, :own]
    by_own = by_own.reshape(effects, columns, environments, patterns, width)
    own_by_effects = by_own.transpose(1, 0, 3, 2, 4)  # (a, q, G, J, W)
    own_by_effects = own_by_effects.reshape(columns, effects * patterns, environments, width)
    own_by_rest = equations.deviations_by_rest.swapaxes(1, 2)
    mixed = np.concatenate([own_by_effects, own_by_rest], axis=1)
    explained = solve_lower(factor[:, :, None], mixed)  # T, (a, K + 1, J, W)
    joint = _joint_precision(equations, own)
    whole = np.einsum("kkw->kw", joint)[:-1].copy()
    subtract(joint, explained)
    remainder = Remainder(joint)
    solved = EnvironmentsFirst(
        equations.deviation_sd, factor, explained, remainder, effects * patterns
    )
    return solved, (remainder.pivots / whole).min(axis=0, initial=1.0)


def _joint_precision(equations: CellEquations, own: int) -> Array:
    """Lower triangle of the precision of what is left, the data last: (K + 1, K + 1, W)."""
    effects, _, patterns, _ = equations.effects_by_latents.shape
    rest, _, width = equations.rest.shape
    first = effects * patterns
    joint = np.zeros((first + rest, first + rest, width))
    by_rest = equations.effects_by_latents[:, own:]  # (q, r + 1, G, W)
    rest_by_effects = by_rest.swapaxes(0, 1)
    joint[first:, :first] = rest_by_effects.reshape(rest, first, width)
    joint[first:, first:] = equations.rest.swapaxes(0, 1)
    diagonal = np.arange(first + rest)
    joint[diagonal, diagonal] += 1.0  # The prior's one, and all that effects have
    return joint
