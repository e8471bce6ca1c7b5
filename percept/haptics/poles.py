"""Poles of the network of device and coupling (Eq. 4), in the z plane."""

from __future__ import annotations

import numpy as np

from percept.haptics._arrays import ComplexArray
from percept.haptics.impedance import tustin_damping
from percept.haptics.parameters import AnyDevice, Coupling, TabulatedDevice


def network_poles(
    device: AnyDevice, coupling: Coupling, period: float, discretization: str
) -> ComplexArray | None:
    """Return the poles of Eq. 4's matrix in the z plane, None where the device is a table.

    Elements in parallel, and entries of the matrix, do not raise each other's order, so each pole is listed
    once.
    """
    if isinstance(device, TabulatedDevice):
        return None
    poles: list[complex] = [0.0]  # the hold's delay
    if device.mass:
        poles.append(-1.0)  # Tustin's s is infinite there
    for mode in device.modes:
        for s in _mode_poles(float(mode.mass), float(mode.stiffness), float(mode.damping)):
            poles.append((2 + s * period) / (2 - s * period))
    stretch = float(np.multiply(coupling.stiffness, period))
    if stretch:
        beta = float(tustin_damping(coupling, period, discretization))
        poles.append((2 * beta - stretch) / (2 * beta + stretch))
    return np.unique(np.array(poles, dtype=np.complex128))


def _mode_poles(mass: float, stiffness: float, damping: float) -> list[complex]:
    """Return the roots of m·s² + b·s + k that are poles of the mode."""
    if not mass or not (stiffness or damping):
        return []
    if not stiffness:
        return [-damping / mass]
    rate, decay = np.sqrt(stiffness) / np.sqrt(mass), damping / mass / 2
    if decay < rate:
        swing = np.sqrt(rate - decay) * np.sqrt(rate + decay)
        return [complex(-decay, swing), complex(-decay, -swing)]
    fast = -(decay + np.sqrt(decay - rate) * np.sqrt(decay + rate))
    return [fast, rate * (rate / fast)]
