"""Couplings for a study's environments: stable, and realistic to the next user."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept import haptics
from percept.haptics.search import covers_range
from percept.study.apparatus import Apparatus
from percept.study.boundaries import region_curves
from percept.study.regions import Region

Array = NDArray[np.float64]
_POINTS = 81


def design_by_method(
    apparatus: Apparatus, regions: tuple[Region, ...], family: str, omega: Array
) -> dict[str, haptics.CouplingDesign]:
    """Map the couplings that qualify, by the envelope of kind user of each method."""
    if not covers_range(apparatus.device, apparatus.period):
        return {}
    grid = np.geomspace(omega[0], omega[-1], min(_POINTS, omega.size))
    found = {}
    for method in ("classical", "bayesian"):
        chosen = {
            r.environment: r
            for r in regions
            if (r.method, r.kind, r.family, r.joint) == (method, "user", family, "marginal")
        }
        if set(chosen) != set(apparatus.references):
            continue
        limits = [
            haptics.EnvironmentBoundary(
                reference,
                *region_curves(
                    chosen[name], "envelope", grid, apparatus.device, apparatus.period, hold=apparatus.hold
                ),
            )
            for name, reference in apparatus.references.items()
        ]
        found[method] = haptics.design_couplings(
            grid, apparatus.device, limits, apparatus.period, hold=apparatus.hold
        )
    return found
