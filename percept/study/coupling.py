"""The device and its virtual coupling: stability, and memberships by the paper's rule."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from percept import haptics
from percept.haptics import TabulatedDevice
from percept.haptics.containment import Boxes, departures, plane_departures
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.haptics.impedance import coupling_admittance
from percept.haptics.search import covers_range
from percept.haptics.stability import coupling_bound
from percept.results import Coupling, Membership
from percept.results.fields import Inside
from percept.study.basics import Skipped
from percept.study.device import BOXES, Setup
from percept.study.regions import Region

__all__ = [
    "design_by_method",
    "no_design",
    "study_coupling",
]

# Frequencies that Llewellyn's criterion is drawn at: enough for a line without corners.
_STABILITY_POINTS = 400
# The criterion is drawn from here on, rad/s, or from this fraction of Nyquist if that is less.
_LOWEST_OMEGA = 1.0
_LOWEST_FRACTION = 1e-3


def study_coupling(
    setup: Setup,
    regions: Sequence[Region],
    within: tuple[float, float],
    *,
    read_at: float,
) -> Coupling:
    """Judge a coupling: Llewellyn's criterion, and memberships over a range, rad/s."""
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
    return Coupling(
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
        memberships=tuple(_memberships(setup, coupling, regions, within, read_at)),
        read_at=float(read_at),
    )


def _memberships(
    setup: Setup,
    coupling: haptics.Coupling,
    regions: Sequence[Region],
    within: tuple[float, float],
    read_at: float,
) -> Iterator[Membership]:
    """Judge every reference against its rectangles and their corners, over a range, rad/s."""
    for region in regions:
        if region.limits is None or region.environment not in setup.references:
            continue
        reference = setup.references[region.environment]
        effective = haptics.effective_impedance(read_at, reference, coupling, setup.period)
        for shape in BOXES:
            uncoupled = _departure(setup, region, shape, within, coupled=False)
            coupled = _departure(setup, region, shape, within, coupled=True)
            yield Membership(
                environment=region.environment,
                method=region.method,
                kind=region.kind,
                family=region.family,
                joint=region.joint,
                shape=shape,
                verdict_uncoupled=uncoupled.verdict,
                departure_uncoupled=uncoupled.magnitude,
                departure_omega_uncoupled=uncoupled.omega,
                plane_departure_uncoupled=uncoupled.plane,
                verdict_coupled=coupled.verdict,
                departure_coupled=coupled.magnitude,
                departure_omega_coupled=coupled.omega,
                plane_departure_coupled=coupled.plane,
                effective_stiffness=float(effective.stiffness),
                effective_damping=float(effective.damping),
            )


class _Departure(NamedTuple):
    """How far a display leaves a boundary at most, as in `Membership`."""

    verdict: Inside
    magnitude: float
    omega: float
    plane: float


def _departure(
    setup: Setup, region: Region, shape: str, within: tuple[float, float], *, coupled: bool
) -> _Departure:
    """Judge one reference against one rectangle, without or through the coupling."""
    assert region.limits is not None
    display = setup.display(region.environment, coupled=coupled)
    boxes = Boxes.of(*region.limits, corners=shape == "corner")
    departed = departures(display, boxes, *within)
    in_plane = plane_departures(display, boxes, *within)
    return _Departure(
        verdict=departed.verdict(),
        magnitude=float(np.expm1(departed.largest[0])),
        omega=float(departed.omega[0]),
        plane=float(in_plane.largest[0]),
    )


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
    """Map the couplings that are stable and realistic, by each method's next user."""
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
