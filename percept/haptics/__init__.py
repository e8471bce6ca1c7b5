"""Impedances of a sampled haptic display, exact from DC to Nyquist; their bounds, stability and couplings.

Angular frequencies are in rad/s, impedances in N·s/m, periods in seconds. Only numpy is needed. Equation
numbers refer to "The effect of static virtual couplings on realistic performance of haptic systems".
"""

from __future__ import annotations

from percept.haptics.design import (
    CouplingDesign,
    EnvironmentBoundary,
    QualifyingCoupling,
    QualifyingRegion,
    design_couplings,
)
from percept.haptics.ellipse import magnitude_envelope_ellipse, magnitude_envelope_log_ellipse
from percept.haptics.envelope import corner_crossings, corner_curves, magnitude_envelope
from percept.haptics.impedance import (
    coupling_admittance,
    coupling_impedance,
    device_impedance,
    environment_impedance,
    hold,
)
from percept.haptics.limits import (
    best_coupling_damping,
    max_coupling_stiffness,
    passivity_damping,
    stable_region,
)
from percept.haptics.perceived import (
    EffectiveImpedance,
    effective_impedance,
    perceived_impedance,
    perceived_magnitude,
)
from percept.haptics.records import AnyDevice, Coupling, Device, Environment, Mode, TabulatedDevice
from percept.haptics.stability import (
    absolute_stability,
    coupling_bound,
    required_damping,
    required_damping_at,
    stability_margin,
)

__all__ = [
    "AnyDevice",
    "Coupling",
    "CouplingDesign",
    "Device",
    "EffectiveImpedance",
    "Environment",
    "EnvironmentBoundary",
    "Mode",
    "QualifyingCoupling",
    "QualifyingRegion",
    "TabulatedDevice",
    "absolute_stability",
    "best_coupling_damping",
    "corner_crossings",
    "corner_curves",
    "coupling_admittance",
    "coupling_bound",
    "coupling_impedance",
    "design_couplings",
    "device_impedance",
    "effective_impedance",
    "environment_impedance",
    "hold",
    "magnitude_envelope",
    "magnitude_envelope_ellipse",
    "magnitude_envelope_log_ellipse",
    "max_coupling_stiffness",
    "passivity_damping",
    "perceived_impedance",
    "perceived_magnitude",
    "required_damping",
    "required_damping_at",
    "stability_margin",
    "stable_region",
]
