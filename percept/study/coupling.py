"""Verdicts on the device and its virtual coupling: stability, and realism per environment."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.records import Boundary
from percept.haptics import AnyDevice, Coupling, Environment

__all__ = ["CouplingStudy", "study_coupling"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class CouplingStudy:
    """What the coupling does, with the device, over the scene's frequencies.

    Attributes
    ----------
    stiffness, damping : float
        Of the coupling, N/m and N·s/m.
    verdict, reason : str
        Absolute stability (Eqs 2-3, 9-10, and the poles): "stable", "marginal" or "unstable".
    margin : float
        Smallest ratio of Re Z_d to what is required, over all frequencies.
    binding_omega : float
        Where it binds, rad/s.
    required_damping : float or None
        Damping a rigid device would need, N·s/m.
    required_omega : float or None
        Where that need is largest, rad/s.
    omega, bound, admittance : ndarray, shape (M,)
        Fig. 4: lower bound of Re(1/Z_c) and Re(1/Z_c) itself, m/(N·s), up to Nyquist.
    realism : DataFrame
        environment, method, kind, family, shape, share_inside_uncoupled, share_inside_coupled
        (shares of the scene's frequencies), effective_stiffness (N/m) and effective_damping (N·s/m) at
        10 rad/s.
    passivity : DataFrame
        environment, needed_colgate, needed_paper (N·s/m), device_damping, passive: one-port passivity
        of rendering the reference directly.
    """

    stiffness: float
    damping: float
    verdict: str
    reason: str
    margin: float
    binding_omega: float
    required_damping: float | None
    required_omega: float | None
    omega: Array
    bound: Array
    admittance: Array
    realism: pd.DataFrame
    passivity: pd.DataFrame


def study_coupling(
    device: AnyDevice,
    coupling: Coupling,
    period: float,
    references: dict[str, Environment],
    boundaries: tuple[Boundary, ...],
    *,
    hold: str,
) -> CouplingStudy:
    """Judge a coupling: Llewellyn's criterion, and membership in the boundaries.

    Parameters
    ----------
    device : Device or TabulatedDevice
        The device.
    coupling : Coupling
        The coupling.
    period : float
        Sampling period, s.
    references : dict of str to Environment
        Reference environments by name.
    boundaries : tuple of Boundary
        Boundaries with `coupled` curves.
    hold : str
        "average" (Eq. 8) or "true".

    Returns
    -------
    CouplingStudy
    """
    verdict = haptics.absolute_stability(device, coupling, period, hold=hold)
    rigid = isinstance(device, haptics.Device)
    need = haptics.required_damping(coupling, period, hold=hold) if rigid else None
    nyquist = np.pi / period
    omega = np.geomspace(1.0, nyquist, 400) if rigid else np.asarray(device.omega)  # type: ignore[union-attr]
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
        realism=_realism(coupling, period, references, boundaries),
        passivity=_passivity(device, period, references),
    )


def _realism(
    coupling: Coupling, period: float, references: dict[str, Environment], boundaries: tuple[Boundary, ...]
) -> pd.DataFrame:
    rows = []
    for boundary in boundaries:
        if boundary.coupled is None:
            continue
        effective = haptics.effective_impedance(10.0, references[boundary.environment], coupling, period)
        rows.append(
            {
                "environment": boundary.environment,
                "method": boundary.method,
                "kind": boundary.kind,
                "family": boundary.family,
                "shape": boundary.shape,
                "share_inside_uncoupled": _share_inside(boundary, boundary.reference),
                "share_inside_coupled": _share_inside(boundary, boundary.coupled),
                "effective_stiffness": float(effective.stiffness),
                "effective_damping": float(effective.damping),
            }
        )
    return pd.DataFrame(rows)


def _share_inside(boundary: Boundary, curve: Array) -> float:
    return float(np.mean((boundary.lower <= curve) & (curve <= boundary.upper)))


def _passivity(device: AnyDevice, period: float, references: dict[str, Environment]) -> pd.DataFrame:
    if not isinstance(device, haptics.Device):
        return pd.DataFrame()
    rows = []
    for name, environment in references.items():
        colgate = float(haptics.passivity_damping(environment, period, model="colgate"))
        paper = float(haptics.passivity_damping(environment, period, model="tustin"))
        rows.append(
            {
                "environment": name,
                "needed_colgate": colgate,
                "needed_paper": paper,
                "device_damping": device.damping,
                "passive": device.damping > colgate,
            }
        )
    return pd.DataFrame(rows)
