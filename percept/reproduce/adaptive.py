"""The paper's future work: a coupling that follows the environment, stable and inside the boundary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.haptics import (
    Coupling,
    CouplingDesign,
    Device,
    EnvironmentBoundary,
    best_coupling_damping,
    design_couplings,
    magnitude_envelope,
    max_coupling_stiffness,
    qualifying_region,
    required_damping,
)
from percept.reproduce.published import THEORETICAL, Published

FloatArray = NDArray[np.float64]

_POINTS = 31
_LINES = 17
_DAMPINGS = np.geomspace(0.5, 60.0, 11)
_LEAST = 1e-4
_DIGITS = 1e-3


@dataclass(frozen=True, eq=False)
class Adapted:
    """The couplings that suit each environment on one device, and the one for all, if there is one."""

    device: Device
    design: CouplingDesign  # In the order of Table 1
    static: tuple[bool, ...]  # By environment, whether the paper's tuned coupling is among them


@dataclass(frozen=True, eq=False)
class TradeOff:
    """Stability against realism: what k_c a device carries, and what k_c feels real."""

    damping: FloatArray  # (n,) b_d, N·s/m
    stiffest: FloatArray  # (n,) Largest stable k_c at the best b_c, N/m
    softest: FloatArray  # Smallest stable k_c that keeps each environment inside its boundary, N/m
    least: tuple[float, ...]  # Smallest b_d with which each environment has a coupling, N·s/m
    least_common: float  # Smallest b_d with which one coupling suits all
    static: float  # The b_d that the paper's tuned coupling needs, N·s/m


def next_user_boundaries(
    published: Published, device: Device, omega: FloatArray
) -> tuple[EnvironmentBoundary, ...]:
    """Return the next user's boundary of each environment: prediction interval, exact envelope."""
    return tuple(
        EnvironmentBoundary(wall.environment, *magnitude_envelope(omega, device, k, b, published.period))
        for wall, (k, b) in zip(published.walls, published.next_user, strict=True)
    )


def adapted_couplings(published: Published, *, points: int = 61) -> Adapted:
    """Return the couplings that qualify on the device Fig. 4 implies."""
    damping = float(required_damping(THEORETICAL, published.period).damping)
    device = Device(published.device.mass, damping)
    omega = published.omega(points)
    boundaries = next_user_boundaries(published, device, omega)
    design = design_couplings(omega, device, boundaries, published.period)
    line = np.array([float(published.tuned.damping)])
    static = []
    for boundary in boundaries:
        region = qualifying_region(omega, device, [boundary], published.period, damping=line)
        static.append(
            any(low <= published.tuned.stiffness <= high for low, high in region.intervals[0].tolist())
        )
    return Adapted(device, design, tuple(static))


def trade_off(published: Published) -> TradeOff:
    """Return what stability allows and what realism asks for, over the damping of the device."""
    best = best_coupling_damping(1.0, published.period)
    per_stiffness, per_damping = float(best.device_damping), float(best.coupling_damping)
    stiffest = _DAMPINGS / per_stiffness
    rows = range(len(published.walls))
    softest = np.array([[_softest(published, float(b), [row]) for b in _DAMPINGS] for row in rows])
    least = tuple(_least(published, [row], _bracket(softest[row])) for row in rows)
    together = list(rows)
    common = max(least)
    if np.isfinite(common) and _any_coupling(published, common, together) is None:
        common = _least(published, together, (common, float(_DAMPINGS[-1])))
    return TradeOff(
        damping=_DAMPINGS,
        stiffest=np.asarray(
            max_coupling_stiffness(_DAMPINGS, stiffest * per_damping * (1 - 1e-9), published.period)
        ),
        softest=softest,
        least=least,
        least_common=common,
        static=float(required_damping(published.tuned, published.period).damping),
    )


def _bracket(softest: FloatArray) -> tuple[float, float]:
    """Return a damping that is too small and one that will do; inf where none will."""
    found = np.flatnonzero(np.isfinite(softest))
    if not found.size:
        return float(_DAMPINGS[-1]), float("inf")
    first = int(found[0])
    return (float(_DAMPINGS[first - 1]) if first else _LEAST), float(_DAMPINGS[first])


def _softest(published: Published, damping: float, rows: list[int]) -> float:
    """Return the smallest k_c that suits some environments, N/m; NaN without any."""
    coupling = _any_coupling(published, damping, rows)
    return float("nan") if coupling is None else float(coupling.stiffness)


def _any_coupling(published: Published, damping: float, rows: list[int]) -> Coupling | None:
    device = Device(published.device.mass, damping)
    omega = published.omega(_POINTS)
    boundaries = next_user_boundaries(published, device, omega)
    lines = 8 * damping * np.sin(np.linspace(0.0, np.pi / 2, _LINES)) ** 2
    region = qualifying_region(
        omega, device, [boundaries[row] for row in rows], published.period, damping=lines
    )
    return region.softest


def _least(published: Published, rows: list[int], bracket: tuple[float, float]) -> float:
    """Return the smallest b_d with a coupling for some environments, by bisection."""
    low, high = bracket
    while np.isfinite(high) and high > low * (1 + _DIGITS):
        middle = float(np.sqrt(low * high))
        if _any_coupling(published, middle, rows) is None:
            low = middle
        else:
            high = middle
    return high
