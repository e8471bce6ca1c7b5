"""The four curves of a panel of Fig. 7, where they are read, and with which devices.

The mass and the damping of the device behind the figures were never published. So each reading is
tried on a grid of devices that a hand can move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.haptics import Device, Environment, Loop, corner_curves, environment_impedance
from reports.hbfd.published import LOOKED_AT, Array, Published, Wall

BoolArray = NDArray[np.bool_]

#: Masses a hand can move, kg.
MASSES = np.geomspace(0.01, 30.0, 71)
#: Dampings a hand can move, N·s/m.
DAMPINGS = np.geomspace(0.05, 50.0, 61)

_POINTS = 9  # Of ω over a window, which is at most 13 % of its frequency wide
_FINE = 201  # Of ω over a window where a share of it is counted, and of masses on the ridge
_HALVINGS = 60  # Of a step of a scale, down to the digits of a double


@dataclass(frozen=True, eq=False)
class Curves:
    """The four curves of a panel of Fig. 7, N·s/m, over ω on the last axis."""

    lower: Array  # (..., n), as the others
    upper: Array
    direct: Array
    coupled: Array


#: Says at every ω whether a statement on the curves is true.
Reading: TypeAlias = Callable[[Curves], BoolArray]


def curves(published: Published, wall: Wall, omega: Array, device: Device | None = None) -> Curves:
    """Return the curves of a panel.

    Parameters
    ----------
    published : Published
        The paper.
    wall : Wall
        Whose limits and reference are drawn.
    omega : ndarray, shape (n,)
        rad/s.
    device : Device, optional
        Its mass and damping may be arrays; the scene's by default.

    Returns
    -------
    Curves
        Each of shape (..., n), the device's axes first.
    """
    if device is None:
        device = published.device
    mass = np.asarray(device.mass)[..., None]
    damping = np.asarray(device.damping)[..., None]
    each = Device(mass, damping)
    at_low, at_high = corner_curves(
        Loop(each, published.period), omega, wall.stiffness, wall.damping
    )
    direct = published.felt(omega, wall.environment, device=each)
    coupled = published.felt(omega, wall.environment, device=each, coupling=published.tuned)
    lower = np.minimum(at_low, at_high)
    upper = np.maximum(at_low, at_high)
    return Curves(lower, upper, direct, coupled)


def direct_inside(lines: Curves) -> BoolArray:
    """Say where the curve without a coupling is between the boundaries."""
    return (lines.lower <= lines.direct) & (lines.direct <= lines.upper)


def coupled_inside(lines: Curves) -> BoolArray:
    """Say where the coupled curve is between the boundaries."""
    return (lines.lower <= lines.coupled) & (lines.coupled <= lines.upper)


def _both_below(lines: Curves) -> BoolArray:
    return (lines.direct < lines.lower) & (lines.coupled < lines.lower)


def _both_inside(lines: Curves) -> BoolArray:
    below_upper = lines.direct <= lines.upper
    return (lines.lower <= lines.coupled) & (lines.coupled < lines.direct) & below_upper


def _either_side(lines: Curves) -> BoolArray:
    return (lines.coupled < lines.lower) & (lines.upper < lines.direct)


@dataclass(frozen=True, eq=False)
class Panel:
    """An enlarged panel of Fig. 7 and what the paper reads off it."""

    name: str  # "7b", "7d" or "7f"
    says: str  # The statement, in a few words
    wall: Wall
    window: tuple[float, float]  # rad/s
    reading: Reading


def panels(published: Published) -> tuple[Panel, Panel, Panel]:
    """Return the three enlarged panels: 7b, 7d and 7f."""
    first, second, third = published.drawn
    return (
        Panel("7b", "both below the boundaries", *first, _both_below),
        Panel("7d", "both inside, coupled below direct", *second, _both_inside),
        Panel("7f", "one curve below, one above them", *third, _either_side),
    )


def over_devices(published: Published, panel: Panel, mass: Array, damping: Array) -> BoolArray:
    """Say for which devices a panel's statement is true over its window.

    Parameters
    ----------
    published : Published
        The paper.
    panel : Panel
        The statement, its environment and its window.
    mass, damping : ndarray
        Of the devices, kg and N·s/m; their shapes broadcast.

    Returns
    -------
    ndarray of bool
        Of the broadcast shape.
    """
    omega = np.linspace(*panel.window, _POINTS)
    lines = curves(published, panel.wall, omega, Device(mass, damping))
    return np.asarray(panel.reading(lines).all(axis=-1))


def share_true(published: Published, wall: Wall, reading: Reading) -> float:
    """Return the share of the perceivable range, on a log scale, over which a reading is true."""
    return float(reading(curves(published, wall, published.omega())).mean())


def change_over_band(published: Published, panel: Panel, device: Device) -> Array:
    """Return the change of |Z_h| by the coupling over the band at the same ω, in a window.

    The device may hold arrays; ω is the last axis. The ratio is inf where the band is empty.
    """
    omega = np.linspace(*panel.window, _FINE)
    lines = curves(published, panel.wall, omega, device)
    change = np.abs(lines.coupled - lines.direct)
    band = lines.upper - lines.lower
    infinite = np.full_like(change, np.inf)
    return np.divide(change, band, out=infinite, where=band > 0)


def most_passed(published: Published, panel: Panel) -> tuple[float, Device]:
    """Return the largest share of a window over which the change passes the band, and its device.

    That happens about an ω where the two boundaries cross, so only devices are tried whose
    boundaries cross in the window.
    """
    wall = panel.wall
    window = np.array(panel.window)
    most = 0.0
    device_of_most = published.device
    for damping in (0.0, *DAMPINGS[::6].tolist()):
        # |Z_h|² at the upper limits less that at the lower ones is linear in the mass.
        gaps = []
        for mass in (0.0, 1.0):
            low, high = corner_curves(
                Loop(Device(mass, damping), published.period), window, wall.stiffness, wall.damping
            )
            gaps.append(high**2 - low**2)
        massless, with_one = gaps
        first, last = massless / (massless - with_one)
        masses = np.clip(np.linspace(first, last, _FINE), 0.0, MASSES[-1])
        devices = Device(masses, np.full_like(masses, damping))
        passed = (change_over_band(published, panel, devices) > 1).mean(axis=-1)
        row = int(passed.argmax())
        if passed[row] > most:
            most = float(passed[row])
            device_of_most = Device(float(masses[row]), damping)
    return most, device_of_most


def relative_width(wall: Wall, period: float) -> float:
    """Return how far apart |Z_e| is at the upper and the lower limits, over the reference's."""
    return absolute_width(wall, period) / _magnitude(wall.environment, period)


def absolute_width(wall: Wall, period: float) -> float:
    """Return how far apart |Z_e| is at the upper and the lower limits, N·s/m."""
    return abs(_magnitude(wall.upper, period) - _magnitude(wall.lower, period))


def _magnitude(environment: Environment, period: float) -> float:
    return float(
        np.abs(environment_impedance(Loop(Device(0.0, 0.0), period), LOOKED_AT, environment))
    )


def largest(true_at: Callable[[Array], BoolArray], candidates: Array) -> float | None:
    """Return where a statement stops being true on a rising scale.

    Parameters
    ----------
    true_at : callable
        From values of the scale, shape (n,), to whether the statement is true there.
    candidates : ndarray, shape (n,)
        The scale, increasing.

    Returns
    -------
    float or None
        The largest value with which the statement is true: None if it never is, inf if the last
        candidate is one.
    """
    true = np.flatnonzero(true_at(candidates))
    if not true.size:
        return None
    last = int(true[-1])
    if last == candidates.size - 1:
        return float("inf")
    low, high = candidates[[last, last + 1]].tolist()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if true_at(np.array([middle]))[0]:
            low = middle
        else:
            high = middle
    return float(low)
