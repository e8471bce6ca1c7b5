"""Impedances of a sampled haptic display, their bounds, stability and couplings, DC to Nyquist.

Angular frequencies are in rad/s, impedances in N·s/m, periods in seconds. Only numpy is needed.
Equation numbers refer to "The effect of static virtual couplings on realistic performance of haptic
systems".
"""

from __future__ import annotations

from percept.haptics.envelope import corner_curves, magnitude_envelope
from percept.haptics.impedance import (
    coupling_impedance,
    device_impedance,
    environment_impedance,
    hold,
)
from percept.haptics.loop import Loop, VelocityFilter
from percept.haptics.perceived import effective_impedance, perceived_impedance
from percept.haptics.records import Coupling, Device, Environment, Mode, TabulatedDevice
from percept.haptics.rendering import can_render, needed_damping
from percept.haptics.stability import (
    absolute_stability,
    max_coupling_stiffness,
    required_damping,
    required_damping_at,
    stability_margin,
)

__all__ = [
    "Coupling",
    "Device",
    "Environment",
    "Loop",
    "Mode",
    "TabulatedDevice",
    "VelocityFilter",
    "absolute_stability",
    "can_render",
    "corner_curves",
    "coupling_impedance",
    "device_impedance",
    "effective_impedance",
    "environment_impedance",
    "hold",
    "magnitude_envelope",
    "max_coupling_stiffness",
    "needed_damping",
    "perceived_impedance",
    "required_damping",
    "required_damping_at",
    "stability_margin",
]
