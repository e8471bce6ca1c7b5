"""The device and its virtual coupling: stability, and memberships in boundaries by the paper's rule."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from percept import haptics
from percept.haptics import Coupling, TabulatedDevice
from percept.haptics.containment import Boxes, departures, plane_departures
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.haptics.impedance import coupling_admittance
from percept.haptics.search import covers_range
from percept.haptics.stability import coupling_bound
from percept.html import NotebookRecord
from percept.study.basics import Array, Skipped
from percept.study.device import BOXES, Setup
from percept.study.regions import Region

__all__ = [
    "CouplingStudy",
    "design_by_method",
    "no_design",
    "study_coupling",
]

# Frequencies that Llewellyn's criterion is drawn at: enough for a line without corners.
_STABILITY_POINTS = 400
# The criterion is drawn from here on, rad/s, or from this fraction of Nyquist if that is less.
_LOWEST_OMEGA = 1.0
_LOWEST_FRACTION = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class CouplingStudy(NotebookRecord):
    """What the coupling does, with the device, over the scene's frequencies."""

    stiffness: float  #: Of the coupling, N/m
    damping: float  #: Of the coupling, N·s/m
    verdict: str  #: Llewellyn's criterion: "stable", "marginal", "unstable" or "undecided"
    reason: str  #: Why
    margin: float  #: Smallest ratio of what the device has to what the coupling needs
    binding_omega: float  #: Where it binds, rad/s
    required_damping: float | None  #: Damping a rigid device needs, N·s/m; None for other devices
    required_omega: float | None  #: Where that need is largest, rad/s
    omega: Array  #: (M,) Frequencies of the criterion, rad/s
    bound: Array  #: (M,) The criterion's bound there
    admittance: Array  #: (M,) Real part of the coupling's admittance there
    #: Per rectangle of (k, b) and shape, without and through the coupling: the verdict at every
    #: omega of the range ("inside", "marginal" or "outside"), the largest departure (relative,
    #: negative inside) with its omega, rad/s, and that of effective k and b, in widths; also
    #: effective k and b at `read_at`.
    memberships: pd.DataFrame
    read_at: float  #: Where single values are read, rad/s

    @property
    def stable(self) -> bool | None:
        """Whether the coupling is stable, at its limit it is not; None where that is undecided."""
        return {"stable": True, "marginal": False, "unstable": False}.get(self.verdict)


def study_coupling(
    setup: Setup,
    regions: Sequence[Region],
    within: tuple[float, float],
    *,
    read_at: float,
) -> CouplingStudy:
    """Judge a coupling: Llewellyn's criterion, and membership in the boundaries over a range, rad/s."""
    device = setup.device
    coupling = setup.coupling
    period = setup.period
    hold = setup.hold
    assert coupling is not None
    verdict = haptics.absolute_stability(device, coupling, period, hold=hold)
    reason = verdict.reason
    need = None
    if isinstance(device, haptics.Device):
        need = haptics.required_damping(coupling, period, hold=hold)
    nyquist = np.pi / period
    if isinstance(device, TabulatedDevice):
        omega = device.omega[device.omega <= nyquist]
        if verdict.verdict in ("stable", "marginal"):
            # Eqs 9 and 10 look at real parts, and a table shows no more.
            reason = f"The device is measured, so its poles cannot be checked. {reason}"
    else:
        lowest = min(_LOWEST_OMEGA, _LOWEST_FRACTION * nyquist)
        omega = np.geomspace(lowest, nyquist, _STABILITY_POINTS)
    return CouplingStudy(
        stiffness=float(coupling.stiffness),
        damping=float(coupling.damping),
        verdict=verdict.verdict,
        reason=reason,
        margin=float(verdict.smallest_margin),
        binding_omega=float(verdict.binding_omega),
        required_damping=float(need.damping) if need else None,
        required_omega=float(need.omega) if need else None,
        omega=omega,
        bound=coupling_bound(omega, device, period, hold=hold),
        admittance=coupling_admittance(omega, coupling, period).real,
        memberships=pd.DataFrame(_memberships(setup, coupling, regions, within, read_at)),
        read_at=read_at,
    )


def _memberships(
    setup: Setup,
    coupling: Coupling,
    regions: Sequence[Region],
    within: tuple[float, float],
    read_at: float,
) -> Iterator[dict[str, object]]:
    """Judge every reference against its rectangles, and their corners, over a range of omega, rad/s."""
    for region in regions:
        if region.limits is None or region.environment not in setup.references:
            continue
        reference = setup.references[region.environment]
        effective = haptics.effective_impedance(read_at, reference, coupling, setup.period)
        for shape in BOXES:
            row: dict[str, object] = {
                "environment": region.environment,
                "method": region.method,
                "kind": region.kind,
                "family": region.family,
                "joint": region.joint,
                "shape": shape,
            }
            row |= _departures(setup, region, shape, within, coupled=False)
            row |= _departures(setup, region, shape, within, coupled=True)
            row["effective_stiffness"] = float(effective.stiffness)
            row["effective_damping"] = float(effective.damping)
            yield row


def _departures(
    setup: Setup, region: Region, shape: str, within: tuple[float, float], *, coupled: bool
) -> dict[str, object]:
    """Judge one reference against one rectangle, without or through the coupling."""
    assert region.limits is not None
    display = setup.display(region.environment, coupled=coupled)
    boxes = Boxes.of(*region.limits, corners=shape == "corner")
    departed = departures(display, boxes, *within)
    in_plane = plane_departures(display, boxes, *within)
    side = "coupled" if coupled else "uncoupled"
    return {
        f"verdict_{side}": departed.verdict(),
        f"departure_{side}": float(np.expm1(departed.largest[0])),
        f"departure_omega_{side}": float(departed.omega[0]),
        f"plane_departure_{side}": float(in_plane.largest[0]),
    }


def no_design(setup: Setup, kinds: Sequence[str]) -> Skipped | None:
    """Say why no admissible couplings are looked for; None where they are."""
    device = setup.device
    what = "admissible couplings"
    if isinstance(device, TabulatedDevice) and not covers_range(device, setup.period):
        covered = f"{device.omega[0]:g} to {device.omega[-1]:g} rad/s"
        needed = f"all of 0 to {np.pi / setup.period:g}"
        return Skipped(what, f"the device's table covers {covered}, and stability needs {needed}")
    if "user" not in kinds:
        return Skipped(what, "they are judged by intervals of kind user, which were not asked for")
    return None


def design_by_method(
    setup: Setup, regions: Sequence[Region], family: str, within: tuple[float, float]
) -> dict[str, CouplingDesign]:
    """Map the couplings that are stable and realistic, by the limits of kind user of each method."""
    designs = {}
    for method in ("classical", "bayesian"):
        boxes = {}
        for region in regions:
            same = (region.method, region.kind, region.family) == (method, "user", family)
            if same and region.joint == "marginal" and region.limits is not None:
                boxes[region.environment] = region.limits
        if boxes.keys() != setup.references.keys():
            continue
        boundaries = []
        for environment, reference in setup.references.items():
            boundaries.append(EnvironmentBoundary(reference, *boxes[environment]))
        designs[method] = design_couplings(
            setup.device, boundaries, within, setup.period, hold=setup.hold
        )
    return designs
