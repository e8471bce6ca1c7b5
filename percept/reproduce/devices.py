"""What depends on the device: the statements of the paper's figures, and couplings that suit environments.

The second part is the paper's future work: a coupling that follows the environment, stable and
inside the next user's boundary.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.haptics import (
    Device,
    corner_curves,
    magnitude_envelope,
)
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.haptics.search import section_minimum
from percept.reproduce.published import Array, Published, Wall
from percept.reproduce.squares import Square, felt_square

BoolArray = NDArray[np.bool_]

#: Devices a hand can move, kg and N·s/m; nobody published the mass or the damping of the one used.
MASSES = np.geomspace(0.01, 30.0, 71)
DAMPINGS = np.geomspace(0.05, 50.0, 61)
_POINTS = 9  # Over a window of at most 13 % of its frequency
_RIDGE = 801  # Masses one percent apart: the window of Fig. 7b, squared, is four times as wide
_RANGE = 31  # Over the perceivable range
_NARROW = 1e-12  # Relative width to which a limit is halved


@dataclass(frozen=True, eq=False)
class Curves:
    """The four curves of a panel of Fig. 7, N·s/m, over ω on the last axis."""

    lower: Array  # (..., n), as the others
    upper: Array
    direct: Array
    coupled: Array


def curves(published: Published, wall: Wall, omega: Array, device: Device | None = None) -> Curves:
    """Return the curves of a panel, for the scene's device, another, or an array of them."""
    device = published.device if device is None else device
    each = Device(np.asarray(device.mass)[..., None], np.asarray(device.damping)[..., None])
    ends = corner_curves(omega, each, wall.stiffness, wall.damping, published.period)
    return Curves(
        lower=np.minimum(*ends),
        upper=np.maximum(*ends),
        direct=published.felt(omega, wall.environment, device=each),
        coupled=published.felt(omega, wall.environment, device=each, coupling=published.tuned),
    )


def _both_below(found: Curves) -> BoolArray:
    return np.asarray(((found.direct < found.lower) & (found.coupled < found.lower)).all(axis=-1))


def _both_inside(found: Curves) -> BoolArray:
    inside = (
        (found.lower <= found.coupled)
        & (found.coupled < found.direct)
        & (found.direct <= found.upper)
    )
    return np.asarray(inside.all(axis=-1))


def coupled_inside(found: Curves) -> BoolArray:
    """Say where the coupled curve stays between the boundaries."""
    return np.asarray(
        ((found.lower <= found.coupled) & (found.coupled <= found.upper)).all(axis=-1)
    )


def _either_side(found: Curves) -> BoolArray:
    return np.asarray(((found.coupled < found.lower) & (found.upper < found.direct)).all(axis=-1))


@dataclass(frozen=True, eq=False)
class Panel:
    """An enlarged panel of Fig. 7 and what the paper reads off it."""

    name: str  # "7b", "7d" or "7f"
    says: str  # The statement, in a few words
    wall: Wall
    window: tuple[float, float]  # rad/s
    true_of: Callable[[Curves], BoolArray]


def panels(published: Published) -> tuple[Panel, ...]:
    """Return the three enlarged panels."""
    read = (
        ("7b", "both below the boundaries", _both_below),
        ("7d", "both inside, coupled below direct", _both_inside),
        ("7f", "one curve below, one above them", _either_side),
    )
    return tuple(
        Panel(name, says, wall, window, true_of)
        for (name, says, true_of), (wall, window) in zip(read, published.drawn, strict=True)
    )


def over_devices(published: Published, panel: Panel, mass: Array, damping: Array) -> BoolArray:
    """Say for which devices a panel's statement is true over its window."""
    omega = np.linspace(*panel.window, _POINTS)
    return panel.true_of(curves(published, panel.wall, omega, Device(mass, damping)))


def environments_inside(published: Published, mass: Array, damping: Array) -> NDArray[np.int64]:
    """Count the environments that feel real through the tuned coupling, by device."""
    device, omega = Device(mass[..., None], damping[..., None]), published.omega(_RANGE)
    count = np.zeros(np.broadcast_shapes(mass.shape, damping.shape), dtype=np.int64)
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        lower, upper = magnitude_envelope(omega, device, k, b, published.period)
        felt = published.felt(omega, wall.environment, device=device, coupling=published.tuned)
        count += ((lower <= felt) & (felt <= upper)).all(axis=-1)
    return count


def panel_squares(published: Published, wall: Wall, device: Device | None = None) -> list[Square]:
    """Return the squares of a panel's four curves: direct, coupled, at the lower and at the upper limits."""
    device, period = published.device if device is None else device, published.period
    ends = zip(wall.stiffness, wall.damping, strict=True)
    return [
        felt_square(device, wall.k, wall.b, period),
        felt_square(device, wall.k, wall.b, period, coupling=published.tuned),
        *(felt_square(device, k, b, period) for k, b in ends),
    ]


def widest_change(
    published: Published, panel: Panel, device: Device | None = None
) -> tuple[float, Device]:
    """Return the largest change of |Z_h| by the coupling, over the band's width, and the device it is with.

    Both are the largest in the window. The band is narrow where its two curves cross in the window:
    a ridge across all devices, found on a fine grid of masses for each damping and climbed from
    there.
    """
    omega = np.linspace(*panel.window, _POINTS)

    def closeness(mass: Array, damping: Array) -> Array:
        found = curves(published, panel.wall, omega, Device(mass, damping))
        change = np.abs(found.coupled / found.direct - 1).max(axis=-1)
        band = ((found.upper - found.lower) / found.direct).max(axis=-1)
        return np.asarray(-change / band)

    if device is not None:
        return -float(closeness(np.array(device.mass), np.array(device.damping))), device
    masses, dampings = np.geomspace(MASSES[0], MASSES[-1], _RIDGE), np.append(0.0, DAMPINGS[::6])
    best = closeness(masses, dampings[:, None]).argmin(axis=1)
    low, high = masses[np.maximum(best - 1, 0)], masses[np.minimum(best + 1, _RIDGE - 1)]
    mass = section_minimum(lambda mass: closeness(mass, dampings), low, high)
    row = int((found := closeness(mass, dampings)).argmin())
    return -float(found[row]), Device(float(mass[row]), float(dampings[row]))


def largest(true_at: Callable[[Array], BoolArray], candidates: Array) -> float | None:
    """Return where a statement stops being true on a rising scale: None if it never is, inf if always."""
    true = true_at(candidates)
    if not true.any():
        return None
    last = int(np.flatnonzero(true)[-1])
    if last == candidates.size - 1:
        return float("inf")
    low, high = candidates[last : last + 2]
    while high > low * (1 + _NARROW):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if true_at(np.array([middle]))[0] else (low, middle)
    return float(low)


@dataclass(frozen=True, eq=False)
class Adapted:
    """The couplings that suit each environment on one device, and the one for all, if there is one."""

    device: Device
    design: CouplingDesign  # In the order of Table 1
    static: tuple[bool, ...]  # By environment, whether the paper's tuned coupling is among them


def next_user_boundaries(published: Published) -> tuple[EnvironmentBoundary, ...]:
    """Return the limits of each environment: prediction intervals of the next user."""
    return tuple(
        EnvironmentBoundary(wall.environment, k, b)
        for wall, (k, b) in zip(published.walls, published.next_user, strict=True)
    )


def adapted_couplings(published: Published) -> Adapted:
    """Return the couplings that qualify on the device Fig. 4 implies."""
    device = Device(published.device.mass, published.needed())
    boundaries = next_user_boundaries(published)
    design = design_couplings(device, boundaries, published.span, published.period)
    line = np.array([float(published.tuned.damping)])
    tuned = design_couplings(device, boundaries, published.span, published.period, damping=line)
    static = (
        any(low <= published.tuned.stiffness <= high for low, high in region.intervals[0].tolist())
        for region in tuned.each
    )
    return Adapted(device, design, tuple(static))
