"""Verdicts on the device and its virtual coupling: stability, realism, and couplings that are both."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import special

from percept import haptics
from percept.boundary.realism import Realism, realism
from percept.haptics import Coupling, TabulatedDevice
from percept.haptics.containment import Boxes, departures, plane_departures
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.haptics.impedance import coupling_admittance
from percept.haptics.search import covers_range
from percept.haptics.stability import coupling_bound
from percept.html import NotebookRecord
from percept.scene import InferenceTable
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.device import BOXES, Setup
from percept.study.regions import Region

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: By environment, and whether it is displayed through the coupling.
Realisms = dict[tuple[str, bool], Realism]
_LABELS = ("environment", "method", "kind", "family", "joint")
# Frequencies that Llewellyn's criterion is drawn at.
_STABILITY_POINTS = 400


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
    realism: pd.DataFrame
    read_at: float  #: Where single values are read, rad/s
    #: Probability over posterior draws of being realistic throughout; None without a Bayesian fit.
    probability: pd.DataFrame | None = None


def study_coupling(
    setup: Setup,
    regions: Sequence[Region],
    realisms: Realisms,
    within: tuple[float, float],
    *,
    read_at: float,
) -> CouplingStudy:
    """Judge a coupling: Llewellyn's criterion, and membership in the boundaries over a range, rad/s."""
    device, coupling, period, hold = setup.device, setup.coupling, setup.period, setup.hold
    assert coupling is not None
    verdict = haptics.absolute_stability(device, coupling, period, hold=hold)
    rigid = isinstance(device, haptics.Device)
    need = haptics.required_damping(coupling, period, hold=hold) if rigid else None
    nyquist = np.pi / period
    omega, reason = (
        np.geomspace(min(1.0, 1e-3 * nyquist), nyquist, _STABILITY_POINTS),
        verdict.reason,
    )
    if isinstance(device, TabulatedDevice):
        omega = device.omega[device.omega <= nyquist]
        if verdict.verdict in ("stable", "marginal"):
            # Eqs 9 and 10 look at real parts, and a table shows no more.
            reason = f"The device is measured, so its poles cannot be checked. {reason}"
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
        realism=pd.DataFrame(_verdicts(setup, coupling, regions, within, read_at)),
        read_at=read_at,
        probability=_probability(realisms, verdict.verdict) if realisms else None,
    )


def _verdicts(
    setup: Setup,
    coupling: Coupling,
    regions: Sequence[Region],
    within: tuple[float, float],
    read_at: float,
) -> Iterator[dict[str, Any]]:
    """Judge every reference against its rectangles, and their corners, at every omega of a range, rad/s."""
    for region in regions:
        if region.limits is None or region.environment not in setup.references:
            continue
        reference = setup.references[region.environment]
        stiffness, damping = haptics.effective_impedance(read_at, reference, coupling, setup.period)
        for shape in BOXES:
            row: dict[str, Any] = {name: getattr(region, name) for name in _LABELS} | {
                "shape": shape
            }
            for side, coupled in (("uncoupled", False), ("coupled", True)):
                display = setup.display(region.environment, coupled=coupled)
                boxes = Boxes.of(*region.limits, corners=shape == "corner")
                departed = departures(display, boxes, *within)
                row[f"verdict_{side}"] = departed.verdict()
                row[f"departure_{side}"] = float(np.expm1(departed.largest[0]))
                row[f"departure_omega_{side}"] = float(departed.omega[0])
                in_plane = plane_departures(display, boxes, *within)
                row[f"plane_departure_{side}"] = float(in_plane.largest[0])
            yield row | {
                "effective_stiffness": float(stiffness),
                "effective_damping": float(damping),
            }


def _probability(realisms: Realisms, verdict: str) -> pd.DataFrame:
    """Probabilities of being realistic; times stability, of which a coupling at its limit has none."""
    stable = {"stable": True, "marginal": False, "unstable": False}.get(verdict)
    rows = []
    for (environment, coupled), found in realisms.items():
        row = {"environment": environment, "coupled": coupled, **dataclasses.asdict(found)}
        known = coupled and stable is not None
        for name, held in (("", found.magnitude), ("_plane", found.plane)):
            row[f"stable_and_realistic{name}"] = held * bool(stable) if known else None
        rows.append(row)
    return pd.DataFrame(rows)


def no_design(setup: Setup, kinds: Sequence[str]) -> Skipped | None:
    """Say why no admissible couplings are looked for; None where they are."""
    device, what = setup.device, "admissible couplings"
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
    found = {}
    for method in ("classical", "bayesian"):
        wanted = (method, "user", family, "marginal")
        boxes = {
            r.environment: r.limits
            for r in regions
            if (r.method, r.kind, r.family, r.joint) == wanted and r.limits is not None
        }
        if boxes.keys() == setup.references.keys():
            limits = [
                EnvironmentBoundary(own, *boxes[name]) for name, own in setup.references.items()
            ]
            found[method] = design_couplings(
                setup.device, limits, within, setup.period, hold=setup.hold
            )
    return found


def populations(fit: Fit, asked: InferenceTable) -> dict[str, Boxes]:
    """Limits between which the level of all users lie, per posterior draw and environment."""
    means, _ = fit.model.draw(fit.points, generator(asked.seed, Stream.REALISM))
    reach = -special.ndtri(0.5 * (1.0 - asked.level)) * fit.model.laws(fit.points).population_sd
    lower, upper = fit.scale.native(means - reach), fit.scale.native(means + reach)
    pairs = zip(fit.environments, fit.pairs(lower).values(), fit.pairs(upper).values(), strict=True)
    return {e: Boxes.of((low[0], high[0]), (low[1], high[1])) for e, low, high in pairs}


def study_realism(
    setup: Setup, fit: Fit, asked: InferenceTable, within: tuple[float, float]
) -> Realisms:
    """Judge every reference, without and through the coupling, at every frequency of a range, rad/s."""
    return {
        (environment, coupled): realism(setup.display(environment, coupled=coupled), users, *within)
        for environment, users in populations(fit, asked).items()
        for coupled in (False, True)[: 1 + (setup.coupling is not None)]
    }
