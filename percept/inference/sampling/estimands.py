"""What a run estimates: reported quantities, and the pull of every draw on each of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Estimands", "Estimates", "Means"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of Q quantities."""

    names: tuple[str, ...]  # One name per estimate
    value: Array  # (Q,) Estimates
    scale: Array  # (Q,) What a tolerance of one means, such as an interval's half-width


class Estimands(Protocol):
    """Reported quantities of a target."""

    def components(self, points: Array) -> Array:
        """Quantities kept per draw: points (W, d) to an array (W, C)."""

    def estimates(self, components: Array) -> Iterable[tuple[Estimates, Array]]:
        """Estimates from the components (S, C) of S kept draws, and their influence functions, in parts.

        An influence function (S, Q) is the first-order pull of each draw on each estimate. Its mean
        over draws is zero, and its standard error is the estimate's. Memory holds one part at a
        time.
        """


class Means:
    """Posterior means of functions of the coordinates, their scale being the posterior SD."""

    def __init__(self, names: tuple[str, ...], function: Callable[[Array], Array]) -> None:
        self._names = names
        self._function = function

    def components(self, points: Array) -> Array:
        """Values of the functions, shape (W, C)."""
        return np.asarray(self._function(points))

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Means, with deviations as influence."""
        mean = components.mean(axis=0)
        yield Estimates(self._names, mean, components.std(axis=0)), components - mean
