"""What a run must estimate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of Q quantities."""

    names: tuple[str, ...]  # One name per estimate
    value: Array  # (Q,) Estimates
    scale: Array  # (Q,)


class Estimands(Protocol):
    """Reported quantities of a target."""

    def components(self, points: Array) -> Array:
        """Quantities kept per draw: points (W, d) to an array (W, C)."""

    def parts(self) -> Sequence[Estimands]:
        """Estimands that can be worked on apart, whose estimates make up these in their order."""

    def estimate(self, components: Array) -> tuple[Estimates, Array]:
        """Estimates from the components (S, C) of S kept draws, and their influence functions.

        These, of shape (S, Q), are the first-order pull of each draw on each estimate: their mean over draws
        is zero, and its standard error is the estimate's.
        """


class Means:
    """Posterior means of functions of the coordinates, their scale being the posterior SD."""

    def __init__(self, names: tuple[str, ...], function: Callable[[Array], Array]) -> None:
        self._names = names
        self._function = function

    def components(self, points: Array) -> Array:
        """Values of the functions, shape (W, C)."""
        return np.asarray(self._function(points))

    def parts(self) -> tuple[Means]:
        """All means at once."""
        return (self,)

    def estimate(self, components: Array) -> tuple[Estimates, Array]:
        """Means, with deviations as influence."""
        mean = components.mean(axis=0)
        return Estimates(self._names, mean, components.std(axis=0)), components - mean
