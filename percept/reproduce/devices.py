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
    Environment,
    corner_curves,
    environment_impedance,
    magnitude_envelope,
)
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.reproduce.published import LOOKED_AT, Array, Published, Wall
from percept.reproduce.squares import Square, cells, felt_square, share

BoolArray = NDArray[np.bool_]

#: Devices a hand can move, kg and N·s/m; nobody published the mass or the damping of the one used.
MASSES = np.geomspace(0.01, 30.0, 71)
DAMPINGS = np.geomspace(0.05, 50.0, 61)
_POINTS = 9  # Over a window of at most 13 % of its frequency
_FINE = 201  # Points over a window where a share of it is counted
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


def direct_inside(found: Curves) -> BoolArray:
    """Say where the curve without a coupling stays between the boundaries."""
    return np.asarray(((found.lower <= found.direct) & (found.direct <= found.upper)).all(axis=-1))


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


def share_true(
    published: Published,
    wall: Wall,
    true_of: Callable[[Curves], BoolArray],
    device: Device | None = None,
) -> float:
    """Return the share of the perceivable range, on a log scale, over which a reading is true."""
    edges, middles = cells(
        panel_squares(published, wall, device), *published.span, published.period
    )
    return share(edges, true_of(curves(published, wall, middles[:, None], device)))


def change_over_band(published: Published, panel: Panel, device: Device) -> Array:
    """Return the change of |Z_h| by the coupling over the band at the same ω, over a panel's window.

    The device may hold arrays; ω is the last axis. The ratio is inf where the band is empty.
    """
    omega = np.linspace(*panel.window, _FINE)
    found = curves(published, panel.wall, omega, device)
    change = np.abs(found.coupled - found.direct)
    band = found.upper - found.lower
    return np.divide(change, band, out=np.full_like(change, np.inf), where=band > 0)


def most_passed(published: Published, panel: Panel) -> tuple[float, Device]:
    """Return the largest share of a window over which the change passes the band, and its device.

    That happens about an ω where the two boundaries cross, so only devices are tried whose
    boundaries cross in the window.
    """
    best_share, best = 0.0, published.device
    for damping in (0.0, *DAMPINGS[::6].tolist()):
        first, last = (
            _mass_of_crossing(published, panel.wall, omega, damping) for omega in panel.window
        )
        masses = np.clip(np.linspace(first, last, _FINE), 0.0, MASSES[-1])
        device = Device(masses, np.full_like(masses, damping))
        passed = (change_over_band(published, panel, device) > 1).mean(axis=-1)
        row = int(passed.argmax())
        if passed[row] > best_share:
            best_share = float(passed[row])
            best = Device(float(masses[row]), damping)
    return best_share, best


def _mass_of_crossing(published: Published, wall: Wall, omega: float, damping: float) -> float:
    """Return the device's mass, kg, with which the two boundaries cross at ω; negative if none does."""

    def gap(mass: float, damping: float) -> float:
        """Return |Z_h|² at the upper limits less that at the lower, linear in mass and damping."""
        at_low, at_high = corner_curves(
            omega, Device(mass, damping), wall.stiffness, wall.damping, published.period
        )
        return float(at_high**2 - at_low**2)

    still = gap(0.0, damping)
    return still / (still - gap(1.0, damping))


def relative_width(wall: Wall, period: float) -> float:
    """Return how far apart |Z_e| is at the upper and the lower limits, over the reference's."""
    return absolute_width(wall, period) / _magnitude(wall.environment, period)


def absolute_width(wall: Wall, period: float) -> float:
    """Return how far apart |Z_e| is at the upper and the lower limits, N·s/m."""
    low, high = (
        _magnitude(Environment(k, b), period)
        for k, b in zip(wall.stiffness, wall.damping, strict=True)
    )
    return abs(high - low)


def _magnitude(environment: Environment, period: float) -> float:
    return float(np.abs(environment_impedance(LOOKED_AT, environment, period)))


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
