"""What a run must estimate, and how far each draw pulls each estimate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.share import ALONE, Share

__all__ = ["Estimands", "Estimates", "Means"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates from S kept draws.

    Attributes
    ----------
    names : tuple of str
        One name per estimate.
    value : ndarray, shape (Q,)
        Estimates.
    scale : ndarray, shape (Q,)
        What their Monte Carlo error is compared with: an interval's half-width on the model's scale.
    influence : ndarray, shape (S, Q)
        First-order pull of each draw on each estimate; the mean over draws is zero, and its standard
        error is the estimate's.
    """

    names: tuple[str, ...]
    value: Array
    scale: Array
    influence: Array


class Estimands(Protocol):
    """Reported quantities of a target."""

    def components(self, points: Array) -> Array:
        """Quantities kept per draw: points (W, d) to an array (W, C)."""

    def estimate(self, components: Array, share: Share = ALONE) -> Estimates:
        """Estimates from the components (S, C) of S kept draws, worked on by `share`."""


class Means:
    """Posterior means of functions of the coordinates, their scale being the posterior SD.

    Parameters
    ----------
    names : tuple of str
        One name per function.
    function : callable
        Points (W, d) to values (W, C).
    """

    def __init__(self, names: tuple[str, ...], function: Callable[[Array], Array]) -> None:
        self._names = names
        self._function = function

    def components(self, points: Array) -> Array:
        """Values of the functions, shape (W, C)."""
        return np.asarray(self._function(points))

    def estimate(self, components: Array, share: Share = ALONE) -> Estimates:
        """Means, with deviations as influence."""
        del share
        mean = components.mean(axis=0)
        return Estimates(self._names, mean, components.std(axis=0), components - mean)
