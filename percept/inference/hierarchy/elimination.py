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
from percept.inference.hierarchy.remainder import Remainder
from percept.inference.hierarchy.subjects_first import SubjectsFirst

__all__ = ["Elimination", "solve"]

Array = NDArray[np.float64]


class Elimination(Protocol):
    """Normal equations solved at W sets of scales: a own deviations in each of J environments."""

    latents: Array  # (a J + r, W) Those that fit best: own deviations, then the r of the rest
    log_determinant: Array  # (W,) Of the joint precision of latents and whitened effects
    remainder: Remainder  # What is left, and whether enough digits are

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


def solve(equations: CellEquations) -> Elimination:
    """Solve the normal equations, in the order that leaves the smaller matrix.

    Parameters
    ----------
    equations : CellEquations
        The normal equations at W sets of scales.

    Returns
    -------
    Elimination
    """
    effects = len(equations.effects_by_latents)
    if equations.problem.eliminates_environments(effects):
        return EnvironmentsFirst(equations)
    return SubjectsFirst(equations)
