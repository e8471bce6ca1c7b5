"""Impedances of a sampled haptic display, exact from DC to Nyquist; their bounds, stability and couplings.

Angular frequencies are in rad/s, impedances in N·s/m, periods in seconds. Only numpy is needed. Equation
numbers are those of "The effect of static virtual couplings on realistic performance of haptic systems".
"""

from __future__ import annotations

from percept.haptics.coupled import EffectiveImpedance, effective_impedance, velocity_ratio
from percept.haptics.design import (
    BestDamping,
    StableRegion,
    best_coupling_damping,
    max_coupling_stiffness,
    max_coupling_stiffness_at,
    stable_region,
)
from percept.haptics.ellipse import magnitude_envelope_ellipse
from percept.haptics.envelope import corner_crossings, corner_curves, magnitude_envelope
from percept.haptics.impedance import (
    coupling_admittance,
    coupling_impedance,
    device_impedance,
    environment_impedance,
    hold,
)
from percept.haptics.llewellyn import AbsoluteStability, TwoPort, absolute_stability, llewellyn, two_port
from percept.haptics.log_ellipse import magnitude_envelope_log_ellipse
from percept.haptics.parameters import AnyDevice, Coupling, Device, Environment, Mode, TabulatedDevice
from percept.haptics.passivity import passivity_damping
from percept.haptics.perceived import perceived_impedance, perceived_magnitude
from percept.haptics.phase import phase_envelope, phase_envelope_ellipse
from percept.haptics.qualify import (
    CouplingDesign,
    EnvironmentBoundary,
    QualifyingRegion,
    design_couplings,
    qualifying_region,
)
from percept.haptics.response import FrequencyResponse
from percept.haptics.stability import (
    RequiredDamping,
    coupling_bound,
    required_damping,
    required_damping_at,
    stability_margin,
)

__all__ = [
    "AbsoluteStability",
    "AnyDevice",
    "BestDamping",
    "Coupling",
    "CouplingDesign",
    "Device",
    "EffectiveImpedance",
    "Environment",
    "EnvironmentBoundary",
    "FrequencyResponse",
    "Mode",
    "QualifyingRegion",
    "RequiredDamping",
    "StableRegion",
    "TabulatedDevice",
    "TwoPort",
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
    "llewellyn",
    "magnitude_envelope",
    "magnitude_envelope_ellipse",
    "magnitude_envelope_log_ellipse",
    "max_coupling_stiffness",
    "max_coupling_stiffness_at",
    "passivity_damping",
    "perceived_impedance",
    "perceived_magnitude",
    "phase_envelope",
    "phase_envelope_ellipse",
    "qualifying_region",
    "required_damping",
    "required_damping_at",
    "stability_margin",
    "stable_region",
    "two_port",
    "velocity_ratio",
]
