"""How the verdicts move with the device's mass and damping, which are seldom known well."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.haptics import Device, absolute_stability, required_damping
from percept.html import NotebookRecord
from percept.study.apparatus import Apparatus
from percept.study.boundaries import region_curves
from percept.study.frequencies import thinned
from percept.study.regions import Region

if TYPE_CHECKING:
    from percept.study.study import Study

Array = NDArray[np.float64]
_TIMES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_POINTS = 61


@dataclasses.dataclass(frozen=True)
class DeviceSensitivity(NotebookRecord):
    """Verdicts for lighter, heavier, less and better damped devices."""

    mass: tuple[float, ...]
    damping: tuple[float, ...]
    own: tuple[int, int]  # Where the device itself stands: place of its damping, of its mass
    verdict: tuple[tuple[str | None, ...], ...]  # By damping and mass: "stable", "marginal" or "unstable"
    inside: Mapping[str, tuple[tuple[int, ...], ...]]
    frequencies: int  # At how many omega that was checked
    environments: int  # How many were judged
    required_damping: float | None  # Damping that the coupling asks of a rigid device, N·s/m
    method: str  # Whose limits
    family: str  # Whose limits


def device_sensitivity(study: Study) -> DeviceSensitivity | None:
    """Judge stability and realism again for 49 devices about the scene's."""
    apparatus = study.apparatus
    if apparatus is None or not isinstance(apparatus.device, Device):
        return None
    limits = {kind: found for kind in study.scene.inference.kinds if (found := _limits(study, kind))}
    if not limits:
        return None
    own = apparatus.device
    masses, dampings = _about(float(own.mass)), _about(float(own.damping))
    moved = [
        [
            dataclasses.replace(apparatus, device=dataclasses.replace(own, mass=mass, damping=damping))
            for mass in masses
        ]
        for damping in dampings
    ]
    # All 49 at once: mass along the rows, damping down them.
    every = dataclasses.replace(own, mass=np.array(masses), damping=np.array(dampings)[:, None])
    together = dataclasses.replace(apparatus, device=every)
    omega = thinned(study.omega, _POINTS)[:, None, None]
    coupled = apparatus.coupling is not None
    felt = {e: together.curve(e, omega, coupled=coupled) for e in apparatus.references}
    inside = {
        str(kind): tuple(
            map(tuple, np.sum([_stays_inside(together, one, omega, felt) for one in found], axis=0).tolist())
        )
        for kind, found in limits.items()
    }
    needed = None
    if apparatus.coupling is not None:
        needed = float(required_damping(apparatus.coupling, apparatus.period, hold=apparatus.hold).damping)
    some = next(iter(limits.values()))
    return DeviceSensitivity(
        mass=masses,
        damping=dampings,
        own=(dampings.index(float(own.damping)), masses.index(float(own.mass))),
        verdict=tuple(tuple(_verdict(one) for one in row) for row in moved),
        inside=inside,
        frequencies=omega.size,
        environments=len(some),
        required_damping=needed,
        method="classical",
        family=" or ".join(dict.fromkeys(region.family for region in some)),
    )


def _about(own: float) -> tuple[float, ...]:
    return tuple(own * times for times in _TIMES) if own else (0.0, *_TIMES[1:])


def _limits(study: Study, kind: str) -> list[Region]:
    """Classical rectangles of a kind, one per environment: in the scene's family where it has one."""
    families = (study.scene.inference.family, "lognormal", "normal")
    known = {
        (region.environment, region.family): region
        for region in study.regions
        if (region.method, region.kind, region.joint) == ("classical", kind, "marginal")
    }
    found = (
        next((known[name, family] for family in families if (name, family) in known), None)
        for name in study.environments
    )
    return [region for region in found if region is not None]


def _verdict(apparatus: Apparatus) -> str | None:
    if apparatus.coupling is None:
        return None
    return str(
        absolute_stability(
            apparatus.device, apparatus.coupling, apparatus.period, hold=apparatus.hold
        ).verdict
    )


def _stays_inside(
    apparatus: Apparatus, region: Region, omega: Array, felt: Mapping[str, Array]
) -> NDArray[np.int_]:
    """1 for every device with which the environment's curve stays inside at all frequencies."""
    lower, upper = region_curves(
        region, "envelope", omega, apparatus.device, apparatus.period, hold=apparatus.hold
    )
    shown = felt[region.environment]
    return ((lower <= shown) & (shown <= upper)).all(axis=0).astype(int)
