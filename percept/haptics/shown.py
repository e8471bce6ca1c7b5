"""What a display shows over a range of ω: limits of stiffness and damping, and the paper's rule.

Stiffness and damping as displayed, and departures, are looked for on a grid that resolves modes and
resonances, and refined at every peak.

The paper's rule asks whether abs(Z_h) as displayed stays between its limits over a box of (k, b).
Let D be abs(Z_h) of the display at one ω, F that of the box's farthest point and N that of its
nearest. The departure is

    max(ln D/F, ln N/D)                                negative where the display lies inside
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from percept.haptics.arrays import LARGEST, FloatArray, IntArray
from percept.haptics.loop import search_grid
from percept.haptics.perceived import Display, displayed, shown_element
from percept.haptics.records import Device, Mode
from percept.haptics.rendering import resonances
from percept.searches import lowest

#: Nearer to a limit than this, as a logarithm, a display lies on it: rounding could decide. A
#: departure keeps some 13 digits, which leaves three to spare.
ON_LIMIT = 1e-10
# Further a departure is not told apart, as a logarithm: twelve decades, beyond any ratio of two
# impedances that a limit could mean.
_LARGEST = 12.0 * float(np.log(10.0))

Side = tuple[float, float]


class ShownLimits(NamedTuple):
    """The least and the largest stiffness and damping shown over a range of ω, (2,) each."""

    stiffness: FloatArray  # N/m
    damping: FloatArray  # N·s/m


def shown_limits(display: Display, lower: float, upper: float) -> ShownLimits:
    """Return between which limits the stiffness and damping shown stay over a range of ω.

    Parameters
    ----------
    display : Display
        One, or several that share a coupling: what is shown does not depend on the device.
    lower, upper : float
        Ends of the range, rad/s, between 0 and π/T.

    Returns
    -------
    ShownLimits

    Raises
    ------
    UsageError
        The range passes Nyquist.
    """
    loop = replace(display.loop, device=Device(0.0, 0.0))

    def signed(omega: FloatArray, which: IntArray) -> FloatArray:
        """Return stiffness, damping, and both with their signs changed."""
        shown = shown_element(loop.at(omega), display)
        values = np.broadcast_arrays(shown.stiffness, shown.damping, omega)[:2]
        # Differences of infinities would hide a dip from the search.
        k, b = np.clip(values, -LARGEST, LARGEST)
        return np.choose(which, [k, b, -k, -b])

    # Without a filter, and without a mass behind a coupling, both are monotone in ω.
    least = signed(np.array([[lower], [upper]]), np.arange(4)).min(axis=0)
    is_heavy = display.coupling is not None and bool(display.environment.mass)
    if is_heavy or loop.velocity_filter is not None:
        modes = resonances(display.environment, display.coupling)
        candidates = search_grid(loop, modes, within=(lower, upper))
        least = lowest(signed, candidates, 4).value
    stiffness, damping = np.stack([least[:2], -least[2:]], axis=1)
    return ShownLimits(stiffness, damping)


class Departure(NamedTuple):
    """How far abs(Z_h) leaves its limits at most; negative inside."""

    largest: float  # A log ratio
    omega: float  # Where, rad/s

    @property
    def verdict(self) -> Literal["inside", "marginal", "outside"]:
        """Judge; within rounding it is marginal."""
        if self.largest > ON_LIMIT:
            return "outside"
        return "inside" if self.largest < -ON_LIMIT else "marginal"


def departure(
    display: Display, stiffness: Side, damping: Side, lower: float, upper: float
) -> Departure:
    """Search for the largest departure of abs(Z_h) from a box over a range of ω.

    Parameters
    ----------
    display : Display
        A single one.
    stiffness, damping : pair of float
        The box, low and high, N/m and N·s/m.
    lower, upper : float
        Ends of the range, rad/s, above 0 and up to π/T.

    Returns
    -------
    Departure

    Raises
    ------
    UsageError
        The range passes Nyquist or leaves a device's table.
    """

    def depth_inside(omega: FloatArray, _: IntArray) -> FloatArray:
        """Return the departure at each ω with its sign changed, limited to what is told apart."""
        plane, magnitude = displayed(display, omega.ravel())
        low, high = plane.over(stiffness, damping)
        with np.errstate(divide="ignore", invalid="ignore"):
            above = magnitude / high
            below = low / magnitude
            departs = np.log(np.fmax(above, below))
        # NaN is 0/0: the display vanishes with the region's own curve, and departs from nothing.
        departs = np.where(np.isnan(departs), -_LARGEST, departs)
        return -np.clip(departs, -_LARGEST, _LARGEST).reshape(omega.shape)

    candidates = search_grid(display.loop, _resonances(display, stiffness), within=(lower, upper))
    least = lowest(depth_inside, candidates, 1)
    return Departure(-float(least.value[0]), float(least.x[0]))


def _resonances(display: Display, stiffness: Side) -> tuple[Mode, ...]:
    """Return what the masses of device and environment make with the springs shown."""
    environment = display.environment
    device = display.loop.device
    # A table's rows are on the grid already.
    rigid = device if isinstance(device, Device) else Device(0.0, 0.0)
    mass = rigid.mass + environment.mass
    damping = rigid.damping + environment.damping
    springs = [environment.stiffness, *np.maximum(stiffness, 0.0).tolist()]
    modes = [Mode(mass, rigid.stiffness + spring, damping) for spring in springs]
    return (*modes, *resonances(environment, display.coupling))
