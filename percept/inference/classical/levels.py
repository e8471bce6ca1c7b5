"""Probabilities close to one, without losing what is left of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError


@dataclass(frozen=True)
class OneMinus:
    """The probability ``1 - tail``, remembered by its tail.

    ``0.999999999999`` as a double is 1 - 1.00003e-12: what a double near 1 says about the tail it leaves
    is rough. Where a tail is meant exactly, say ``level=OneMinus(1e-12)``.

    Parameters
    ----------
    tail : float
        What is left; 0 to 1, exclusive.
    """

    tail: float

    def __post_init__(self) -> None:
        if not 0.0 < self.tail < 1.0:
            raise UsageError("The tail of a level must lie strictly between 0 and 1.", value=self.tail)

    def __float__(self) -> float:
        return 1.0 - self.tail


Level: TypeAlias = float | OneMinus


def tail(level: ArrayLike | OneMinus, name: str = "level") -> NDArray[np.float64]:
    """Return 1 − level, exactly for a double from 0.5 up."""
    if isinstance(level, OneMinus):
        return np.asarray(level.tail)
    try:
        values = np.asarray(level, dtype=float)
    except (TypeError, ValueError):
        raise UsageError(f"{name} must be a number.", value=level) from None
    bad = ~((values > 0.0) & (values < 1.0))
    if bad.any():
        raise UsageError(
            f"{name} must lie strictly between 0 and 1.",
            value=float(values[bad].flat[0]),
            hint="99 percent is written 0.99.",
        )
    return 1.0 - values
