"""How far two boundaries lie apart: on average over the range, and at the worst omega."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.notebook import NotebookRecord

Array = NDArray[np.float64]
# Lower limits of zero have no logarithm; they count as this share of the smaller of the upper limits.
_FLOOR = 1e-6


@dataclass(frozen=True)
class CurveGap(NotebookRecord):
    """Distance of one curve from another, as natural logarithms of their ratio."""

    area: float  # Mean of abs(log ratio) over log omega
    largest: float  # log(second/first) where it is largest in size
    omega: float  # Where that is, rad/s


def curve_gap(first: Boundary, second: Boundary) -> dict[str, CurveGap]:
    """Compare the lower and the upper curves of two boundaries over the range they share."""
    low, high = max(first.omega[0], second.omega[0]), min(first.omega[-1], second.omega[-1])
    if not low < high:
        raise UsageError("the two boundaries have no range of omega in common.", value=(low, high))
    omega = np.unique(np.concatenate([first.omega, second.omega]))
    omega = omega[(omega >= low) & (omega <= high)]
    x = np.log(omega)
    upper = [_line(one, "upper", x) for one in (first, second)]
    floor = np.log(_FLOOR) + np.minimum(*upper)
    lower = [np.maximum(_line(one, "lower", x), floor) for one in (first, second)]
    gaps = {}
    for side, (one, other) in (("lower", lower), ("upper", upper)):
        ratio = other - one
        worst = int(np.abs(ratio).argmax())
        area = float(np.trapezoid(np.abs(ratio), x) / (x[-1] - x[0]))
        gaps[side] = CurveGap(area, float(ratio[worst]), float(omega[worst]))
    return gaps


def _line(boundary: Boundary, side: str, x: Array) -> Array:
    curve = np.maximum(getattr(boundary, side), np.finfo(float).tiny)
    return np.interp(x, np.log(boundary.omega), np.log(curve))
