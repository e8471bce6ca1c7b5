"""How the verdicts move with the device's mass and damping, which are seldom known well."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.haptics import (
    Device,
    absolute_stability,
    magnitude_envelope,
    perceived_impedance,
    required_damping,
)
from percept.report.apparatus import Apparatus, Box, apparatus_of, boxes_of
from percept.report.select import KINDS, array

__all__ = ["device_sensitivity"]

_TIMES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_POINTS = 61


def device_sensitivity(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Judge stability and realism again for lighter, heavier, less and better damped devices.

    Parameters
    ----------
    document : mapping
        With provenance, intervals and boundaries.

    Returns
    -------
    dict or None
        ``mass`` (kg) and ``damping`` (N·s/m), each of length 7 around the scene's own; ``verdict`` by damping
        and mass: ``"stable"``, ``"marginal"``, ``"unstable"``, None without a coupling; ``inside`` likewise:
        by kind, in how many of ``environments`` the reference, through the coupling if there is one, stays
        inside the exact envelope of that kind's limits at every ω asked for; ``required_damping`` (N·s/m, of
        a rigid device); ``method``, ``family``. None without a device or boundaries.
    """
    apparatus = apparatus_of(document)
    boxes = {kind: found for kind in KINDS if (found := boxes_of(document, kind))}
    if apparatus is None or not boxes or not document["boundaries"]:
        return None
    own = apparatus.device
    masses = [float(own.mass or 1.0) * times for times in _TIMES]
    dampings = [float(own.damping or 1.0) * times for times in _TIMES]
    omega = _thinned(array(document["boundaries"][0]["omega"]))
    devices = [
        [dataclasses.replace(own, mass=mass, damping=damping) for mass in masses] for damping in dampings
    ]
    inside = {
        kind: [
            [sum(_stays_inside(omega, device, apparatus, box) for box in found) for device in row]
            for row in devices
        ]
        for kind, found in boxes.items()
    }
    some = next(iter(boxes.values()))
    needed = None
    if apparatus.coupling is not None:
        record = required_damping(apparatus.coupling, apparatus.period, hold=apparatus.hold)
        needed = float(record.damping)
    return {
        "mass": masses,
        "damping": dampings,
        "verdict": [[_verdict(device, apparatus) for device in row] for row in devices],
        "inside": inside,
        "environments": len(some),
        "required_damping": needed,
        "method": some[0].method,
        "family": some[0].family,
    }


def _verdict(device: Device, apparatus: Apparatus) -> str | None:
    if apparatus.coupling is None:
        return None
    judged = absolute_stability(device, apparatus.coupling, apparatus.period, hold=apparatus.hold)
    return str(judged.verdict)


def _stays_inside(omega: NDArray[np.float64], device: Device, apparatus: Apparatus, box: Box) -> bool:
    lower, upper = magnitude_envelope(
        omega, device, box.stiffness, box.damping, apparatus.period, hold=apparatus.hold
    )
    felt = np.abs(
        perceived_impedance(
            omega,
            device,
            box.environment,
            apparatus.period,
            coupling=apparatus.coupling,
            hold=apparatus.hold,
        )
    )
    return bool(((lower <= felt) & (felt <= upper)).all())


def _thinned(omega: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return at most `_POINTS` of the frequencies, both ends among them."""
    kept = np.unique(np.linspace(0, omega.size - 1, min(_POINTS, omega.size)).round().astype(int))
    return omega[kept]
