"""The paper's rule: abs(Z_h) as displayed stays between its limits over a box of (k, b).

Let D be abs(Z_h) of the display at one ω, F that of the box's farthest point and N that of its
nearest. The departure is

    max(ln D/F, ln N/D)                                negative where the display lies inside

Its largest value over a range is looked for on a grid that resolves modes and resonances, and
refined at every peak. Stiffness and damping as displayed have their limits too; where they turn is
known exactly.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from percept.haptics.arrays import FloatArray, IntArray
from percept.haptics.frequencies import search_grid
from percept.haptics.perceived import Display, displayed, shown_element
from percept.haptics.plane import Boxes
from percept.haptics.records import Mode
from percept.haptics.shown import turning_points
from percept.minima import lowest

__all__ = ["ON_LIMIT", "Departure", "departure", "plane_departure"]

#: Nearer to a limit than this, as a logarithm, a display lies on it: rounding could decide. A
#: departure keeps some 13 digits, which leaves three to spare.
ON_LIMIT = 1e-10
# Further a departure is not told apart, as a logarithm: twelve decades, beyond any ratio of two
# impedances that a limit could mean.
_LARGEST = 12.0 * float(np.log(10.0))


class Departure(NamedTuple):
    """How far a display leaves its limits at most; negative inside."""

    largest: float  # A log ratio of abs(Z_h), or widths of the limits of k and b
    omega: float  # Where, rad/s

    @property
    def verdict(self) -> Literal["inside", "marginal", "outside"]:
        """Judge a log ratio; within rounding it is marginal."""
        if self.largest > ON_LIMIT:
            return "outside"
        return "inside" if self.largest < -ON_LIMIT else "marginal"


def departure(display: Display, box: Boxes, lower: float, upper: float) -> Departure:
    """Search for the largest departure of abs(Z_h) from a box over a range of ω.

    Parameters
    ----------
    display : Display
        A single one.
    box : Boxes
        Its limits of stiffness and damping.
    lower, upper : float
        Ends of the range, rad/s, above 0 and up to π/T.

    Returns
    -------
    Departure
        A log ratio.

    Raises
    ------
    UsageError
        The range passes Nyquist or leaves a device's table.
    """

    def inside(omega: FloatArray, _: IntArray) -> FloatArray:
        plane, magnitude = displayed(display, omega.ravel())
        extremes = box.extremes(plane)
        with np.errstate(divide="ignore", invalid="ignore"):
            above = magnitude / plane.distance(extremes.farthest)
            below = plane.distance(extremes.nearest) / magnitude
            departs = np.log(np.fmax(above, below))
        # NaN is 0/0: the display vanishes with the region's own curve, and departs from nothing.
        departs = np.where(np.isnan(departs), -_LARGEST, departs)
        return -np.clip(departs, -_LARGEST, _LARGEST).reshape(omega.shape)

    grid = search_grid(display.loop, _resonances(display, box), within=(lower, upper))
    least = lowest(inside, grid, 1)
    return Departure(-float(least.value[0]), float(least.x[0]))


def _resonances(display: Display, box: Boxes) -> tuple[Mode, ...]:
    """Return what the masses of device and environment make with the springs shown."""
    environment = display.environment
    device = display.loop.device
    mass = float(getattr(device, "mass", 0.0)) + float(environment.mass)
    damping = float(getattr(device, "damping", 0.0)) + float(environment.damping)
    own = float(getattr(device, "stiffness", 0.0))
    springs = [float(environment.stiffness), *np.maximum(box.stiffness, 0.0).ravel()]
    modes = [Mode(mass, own + spring, damping) for spring in springs]
    if display.coupling is not None:
        behind = float(environment.stiffness + display.coupling.stiffness)
        modes.append(Mode(environment.mass, behind, environment.damping))
    return tuple(modes)


def plane_departure(display: Display, box: Boxes, lower: float, upper: float) -> Departure:
    """Return how far the stiffness and damping shown leave a box at most over a range of ω.

    Parameters as in `departure`. A box without width counts as one unit wide.

    Returns
    -------
    Departure
        In widths of the limits.

    Raises
    ------
    UsageError
        The range passes Nyquist.
    """
    omega = turning_points(display, lower, upper)
    shown = shown_element(display.loop.at(omega), display)
    by_stiffness = box.stiffness.widths_off(shown.stiffness)
    by_damping = box.damping.widths_off(shown.damping)
    off, omega = np.broadcast_arrays(np.maximum(by_stiffness, by_damping), omega)
    top = int(off.argmax())
    return Departure(float(off[top]), float(omega[top]))
