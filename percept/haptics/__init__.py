"""Impedances of a sampled haptic display, exact from DC to Nyquist; their bounds, stability and couplings.

Angular frequencies are in rad/s, impedances in N·s/m, periods in seconds. Only numpy is needed. Equation
numbers are those of "The effect of static virtual couplings on realistic performance of haptic systems".
"""

from __future__ import annotations

from percept.haptics.envelope import corner_crossings, corner_curves, magnitude_envelope
from percept.haptics.impedance import (
    coupling_admittance,
    coupling_impedance,
    device_impedance,
    environment_impedance,
    hold,
)
from percept.haptics.parameters import AnyDevice, Coupling, Device, Environment, Mode, TabulatedDevice
from percept.haptics.perceived import perceived_impedance, perceived_magnitude
from percept.haptics.response import FrequencyResponse
from percept.haptics.stability import (
    RequiredDamping,
    coupling_bound,
    required_damping,
    required_damping_at,
    stability_margin,
)

__all__ = [
    "AnyDevice",
    "Coupling",
    "Device",
    "Environment",
    "FrequencyResponse",
    "Mode",
    "RequiredDamping",
    "TabulatedDevice",
    "corner_crossings",
    "corner_curves",
    "coupling_admittance",
    "coupling_bound",
    "coupling_impedance",
    "device_impedance",
    "environment_impedance",
    "hold",
    "magnitude_envelope",
    "perceived_impedance",
    "perceived_magnitude",
    "required_damping",
    "required_damping_at",
    "stability_margin",
]
