"""Which couplings are stable and keep each environment inside its boundary: the map for a designer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from percept.haptics import (
    Coupling,
    EnvironmentBoundary,
    QualifyingRegion,
    design_couplings,
    magnitude_envelope,
    stable_region,
)
from percept.report.apparatus import apparatus_of, boxes_of
from percept.report.plain import plain
from percept.report.select import array

__all__ = ["coupling_design"]

_POINTS = 81


def coupling_design(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Map the couplings that qualify, by environment and for all environments.

    Parameters
    ----------
    document : mapping
        With provenance, intervals and boundaries.

    Returns
    -------
    dict or None
        ``damping`` (b_c of each line, N·s/m); ``environments``, each with ``name``, ``intervals`` (per line,
        a list of ``[low, high]`` of k_c, N/m), ``largest`` and ``softest`` (``stiffness``, ``damping``, or
        None); ``common`` likewise for all together; ``stable`` (``stiffness`` and ``damping`` of the edge of
        the stable region of a rigid device, None with modes); ``kind``, ``method``, ``family`` of the
        boundary. None without a rigid or modal device, a coupling, or boundaries.
    """
    apparatus, boxes = apparatus_of(document), boxes_of(document, "user")
    if apparatus is None or apparatus.coupling is None or not boxes or not document["boundaries"]:
        return None
    device, period, hold = apparatus.device, apparatus.period, apparatus.hold
    omega = array(document["boundaries"][0]["omega"])
    omega = omega[(omega > 0) & (omega < np.pi / period)]
    omega = np.geomspace(omega[0], omega[-1], min(_POINTS, omega.size))
    limits = [
        EnvironmentBoundary(
            box.environment,
            *magnitude_envelope(omega, device, box.stiffness, box.damping, period, hold=hold),
        )
        for box in boxes
    ]
    design = design_couplings(omega, device, limits, period, hold=hold)
    edge = None
    if not device.modes:
        region = stable_region(float(device.damping), period, hold=hold, points=65)
        edge = {"stiffness": plain(region.stiffness), "damping": plain(region.damping)}
    return {
        "damping": plain(design.common.damping),
        "environments": [
            {"name": box.name, **_region(region)} for box, region in zip(boxes, design.each, strict=True)
        ],
        "common": _region(design.common),
        "stable": edge,
        "kind": "user",
        "method": boxes[0].method,
        "family": boxes[0].family,
    }


def _region(region: QualifyingRegion) -> dict[str, Any]:
    return {
        "intervals": [plain(part) for part in region.intervals],
        "largest": _coupling(region.largest),
        "softest": _coupling(region.softest),
    }


def _coupling(coupling: Coupling | None) -> dict[str, Any] | None:
    if coupling is None:
        return None
    return {"stiffness": float(coupling.stiffness), "damping": float(coupling.damping)}
