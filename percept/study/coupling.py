"""Verdicts on the device and its virtual coupling: stability, and realism per environment."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.curves import depth_membership, magnitude_membership
from percept.boundary.realism import Realism
from percept.boundary.records import Boundary
from percept.errors import UsageError
from percept.haptics import Coupling, Environment
from percept.html import NotebookRecord
from percept.study.apparatus import Apparatus
from percept.study.regions import Region

Array = NDArray[np.float64]
#: What a verdict makes of realism: a coupling on the limit of stability is none to use.
_STABLE = {"stable": True, "marginal": False, "unstable": False}


@dataclasses.dataclass(frozen=True, eq=False)
class CouplingStudy(NotebookRecord):
    """What the coupling does, with the device, over the scene's frequencies."""

    stiffness: float
    damping: float
    verdict: str
    reason: str
    margin: float
    binding_omega: float  # Where it binds, rad/s
    required_damping: float | None  # Damping a rigid device would need, N·s/m
    required_omega: float | None  # Where that need is largest, rad/s
    omega: Array  # (M,)
    bound: Array  # (M,)
    admittance: Array  # (M,)
    realism: pd.DataFrame
    read_at: float  # Where single values are read, rad/s
    probability: pd.DataFrame | None = None


def study_coupling(
    apparatus: Apparatus,
    boundaries: tuple[Boundary, ...],
    regions: tuple[Region, ...],
    realisms: Iterable[tuple[str, bool, Realism]] = (),
    *,
    read_at: float,
) -> CouplingStudy:
    """Judge a coupling: Llewellyn's criterion, and membership in the boundaries."""
    device, coupling, period, hold = apparatus.device, apparatus.coupling, apparatus.period, apparatus.hold
    if coupling is None:
        raise UsageError("there is no coupling to judge.", hint="Give the scene a [coupling].")
    verdict = haptics.absolute_stability(device, coupling, period, hold=hold)
    rigid = isinstance(device, haptics.Device)
    need = haptics.required_damping(coupling, period, hold=hold) if rigid else None
    nyquist = np.pi / period
    omega = np.geomspace(min(1.0, 1e-3 * nyquist), nyquist, 400)
    if isinstance(device, haptics.TabulatedDevice):
        omega = device.omega[device.omega <= nyquist]
    return CouplingStudy(
        stiffness=float(coupling.stiffness),
        damping=float(coupling.damping),
        verdict=verdict.verdict,
        reason=verdict.reason,
        margin=float(verdict.smallest_margin),
        binding_omega=float(verdict.binding_omega),
        required_damping=float(need.damping) if need else None,
        required_omega=float(need.omega) if need else None,
        omega=omega,
        bound=haptics.coupling_bound(omega, device, period, hold=hold),
        admittance=haptics.coupling_admittance(omega, coupling, period).real,
        realism=_realism(apparatus, coupling, boundaries, regions, read_at),
        read_at=read_at,
        probability=_probability(realisms, _STABLE.get(verdict.verdict)),
    )


def _realism(
    apparatus: Apparatus,
    coupling: Coupling,
    boundaries: tuple[Boundary, ...],
    regions: tuple[Region, ...],
    read_at: float,
) -> pd.DataFrame:
    found = {(r.environment, r.method, r.kind, r.family, r.joint): r for r in regions}
    effective = {
        name: haptics.effective_impedance(read_at, reference, coupling, apparatus.period)
        for name, reference in apparatus.references.items()
    }
    rows = []
    for boundary in boundaries:
        if boundary.coupled is None:
            continue
        reference = apparatus.references[boundary.environment]
        key = (boundary.environment, boundary.method, boundary.kind, boundary.family, boundary.joint)
        row: dict[str, Any] = dict(
            zip(("environment", "method", "kind", "family", "joint"), key, strict=True)
        )
        row["shape"] = boundary.shape
        for name, curve in (("uncoupled", boundary.reference), ("coupled", boundary.coupled)):
            member = magnitude_membership(boundary.omega, boundary.lower, boundary.upper, curve)
            row[f"share_inside_{name}"] = member.inside
            row[f"leaves_{name}"] = member.leaves
            row[f"margin_{name}"] = member.margin
        row["effective_stiffness"] = float(effective[boundary.environment].stiffness)
        row["effective_damping"] = float(effective[boundary.environment].damping)
        if boundary.shape == "envelope":
            row |= _plane(found[key], boundary.omega, reference, coupling, apparatus.period)
        rows.append(row)
    return pd.DataFrame(rows)


def _plane(
    region: Region, omega: Array, reference: Environment, coupling: Coupling, period: float
) -> dict[str, Any]:
    """Test more strictly: effective stiffness and damping both inside the region."""
    shown = haptics.effective_impedance(omega, reference, coupling, period)
    direct = region.depths(*(np.full(omega.shape, v) for v in (reference.stiffness, reference.damping)))
    coupled = depth_membership(omega, region.depths(shown.stiffness, shown.damping))
    return {
        "plane_uncoupled": depth_membership(omega, direct).inside,
        "plane_coupled": coupled.inside,
        "plane_leaves_coupled": coupled.leaves,
    }


def _probability(realisms: Iterable[tuple[str, bool, Realism]], stable: bool | None) -> pd.DataFrame | None:
    def both(probability: float, coupled: bool) -> float | None:
        return probability * stable if coupled and stable is not None else None

    rows = [
        {
            "environment": environment,
            "coupled": coupled,
            "magnitude": found.magnitude_throughout,
            "plane": found.plane_throughout,
            "stable_and_realistic": both(found.magnitude_throughout, coupled),
            "stable_and_realistic_plane": both(found.plane_throughout, coupled),
        }
        for environment, coupled, found in realisms
    ]
    return pd.DataFrame(rows) if rows else None
