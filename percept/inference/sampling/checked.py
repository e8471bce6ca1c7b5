"""A target that is watched for NaN at every call."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError

Array = NDArray[np.float64]


class Target(Protocol):
    """A log density to sample."""

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,); -inf allowed, NaN not."""


class Checked:
    """A target whose values are never NaN."""

    def __init__(self, target: Target) -> None:
        self._target = target

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return self._target.names

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), shape (W,)."""
        values = self._target(points)
        bad = np.isnan(values)
        if bad.any():
            where = _describe(self.names, points[int(np.argmax(bad))])
            raise RefusalError(f"the log density is NaN at {where}.")
        return values


def refuse_impossible(target: Target, points: Array, values: Array) -> None:
    """Refuse to go on when the density is -inf at all of the points."""
    if np.all(np.isneginf(values)):
        where = _describe(target.names, points[0])
        raise RefusalError(
            f"the log density is -inf at every walker, for example at {where}.",
            hint="Check the data and the priors of these parameters.",
        )


def _describe(names: list[str], point: Array) -> str:
    """Write out the four coordinates farthest from zero, in order."""
    extreme = np.argsort(-np.abs(point))[:4]
    return ", ".join(f"{names[i]} = {point[i]:.6g}" for i in sorted(extreme.tolist()))
