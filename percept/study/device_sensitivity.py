"""How the verdicts move with the device's mass and damping, which are seldom known well."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.haptics import Device, absolute_stability, required_damping
from percept.notebook import NotebookRecord
from percept.study.apparatus import Apparatus
from percept.study.boundaries import region_curves
from percept.study.frequencies import thinned
from percept.study.regions import Region

if TYPE_CHECKING:
    from percept.study.study import Study

__all__ = ["DeviceSensitivity", "device_sensitivity"]

Array = NDArray[np.float64]
_TIMES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_POINTS = 61


@dataclasses.dataclass(frozen=True)
class DeviceSensitivity(NotebookRecord):
    """Verdicts for lighter, heavier, less and better damped devices.

    Attributes
    ----------
    mass, damping : tuple of float
        Seven of each, kg and N·s/m: between an eighth and eight times the device's own; where that is zero,
        zero and up to 8.
    own : tuple of int
        Where the device itself stands: place of its damping, of its mass.
    verdict : tuple of tuple of (str or None)
        By damping and mass: "stable", "marginal" or "unstable"; None without a coupling.
    inside : dict of str to tuple of tuple of int
        By kind, then likewise: in how many environments the reference, through the coupling if there is one,
        stays inside the exact envelope of that kind's classical limits at every omega checked.
    frequencies : int
        At how many omega that was checked.
    environments : int
        How many were judged.
    required_damping : float or None
        Damping that the coupling asks of a rigid device, N·s/m.
    method, family : str
        Whose limits.
    """

    mass: tuple[float, ...]
    damping: tuple[float, ...]
    own: tuple[int, int]
    verdict: tuple[tuple[str | None, ...], ...]
    inside: Mapping[str, tuple[tuple[int, ...], ...]]
    frequencies: int
    environments: int
    required_damping: float | None
    method: str
    family: str


def device_sensitivity(study: Study) -> DeviceSensitivity | None:
    """Judge stability and realism again for 49 devices about the scene's.

    Parameters
    ----------
    study : Study
        With both parameters.

    Returns
    -------
    DeviceSensitivity or None
        None without a device, with a measured one, which has neither mass nor damping to vary, or without
        classical intervals.
    """
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
