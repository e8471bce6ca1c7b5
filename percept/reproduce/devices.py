"""What the paper's figures say of a device: each panel's statement over mass and damping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.haptics import Coupling, Device, corner_curves, magnitude_envelope, perceived_impedance
from percept.reproduce.published import Published, Wall

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

#: Devices a hand can move, kg and N·s/m; nobody published the mass or the damping of the one used.
MASSES = np.geomspace(0.01, 30.0, 71)
DAMPINGS = np.geomspace(0.05, 50.0, 61)
_POINTS = 9
_RANGE = 31


@dataclass(frozen=True, eq=False)
class Curves:
    """The four curves of a panel of Fig. 7, N·s/m, over ω on the last axis."""

    omega: FloatArray  # (n,) rad/s
    lower: FloatArray  # (..., n)
    upper: FloatArray  # (..., n)
    direct: FloatArray  # (..., n)
    coupled: FloatArray  # (..., n)


def curves(omega: FloatArray, device: Device, wall: Wall, coupling: Coupling, period: float) -> Curves:
    """Return the curves of a panel for one device, or an array of them."""
    each = Device(np.asarray(device.mass)[..., None], np.asarray(device.damping)[..., None])
    at_low, at_high = corner_curves(omega, each, wall.stiffness, wall.damping, period)
    return Curves(
        omega=omega,
        lower=np.minimum(at_low, at_high),
        upper=np.maximum(at_low, at_high),
        direct=np.abs(perceived_impedance(omega, each, wall.environment, period)),
        coupled=np.abs(perceived_impedance(omega, each, wall.environment, period, coupling=coupling)),
    )


def _both_below(found: Curves) -> BoolArray:
    return np.asarray(((found.direct < found.lower) & (found.coupled < found.lower)).all(axis=-1))


def _both_inside(found: Curves) -> BoolArray:
    inside = (found.lower <= found.coupled) & (found.coupled < found.direct) & (found.direct <= found.upper)
    return np.asarray(inside.all(axis=-1))


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


def over_devices(
    published: Published,
    panel: Panel,
    mass: FloatArray,
    damping: FloatArray,
    *,
    omega: FloatArray | None = None,
) -> BoolArray:
    """Say for which devices a panel's statement is true over its window."""
    mass, damping = np.broadcast_arrays(np.asarray(mass, dtype=float), np.asarray(damping, dtype=float))
    if omega is None:
        omega = np.linspace(*panel.window, _POINTS)
    device = Device(mass, damping)
    return panel.true_of(curves(omega, device, panel.wall, published.tuned, published.period))


def environments_inside(published: Published, mass: FloatArray, damping: FloatArray) -> IntArray:
    """Count the environments that feel real through the tuned coupling, by device."""
    mass, damping = np.broadcast_arrays(np.asarray(mass, dtype=float), np.asarray(damping, dtype=float))
    device, omega = Device(mass[..., None], damping[..., None]), published.omega(_RANGE)
    count = np.zeros(mass.shape, dtype=np.int64)
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        lower, upper = magnitude_envelope(omega, device, k, b, published.period)
        felt = np.abs(
            perceived_impedance(omega, device, wall.environment, published.period, coupling=published.tuned)
        )
        count += ((lower <= felt) & (felt <= upper)).all(axis=-1)
    return count


def largest(true_at: Callable[[FloatArray], BoolArray], candidates: FloatArray) -> float | None:
    """Return where a statement stops being true, on a rising scale."""
    true = true_at(candidates)
    if not true.any():
        return None
    last = int(np.flatnonzero(true)[-1])
    if last == candidates.size - 1:
        return float("inf")
    low, high = candidates[last], candidates[last + 1]
    while high - low > 1e-12 * high:
        middle = np.sqrt(low * high)
        if true_at(np.array([middle]))[0]:
            low = middle
        else:
            high = middle
    return float(low)
