"""Rough devices to climb from: delays and resonances are tried over the band of the log."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from percept.identify.density import DeviceDensity
from percept.identify.model import OF_A_MODE

__all__ = ["rough_devices"]

Array = NDArray[np.float64]

#: Resonances tried for a mode, evenly spaced in their logarithm over the band. The tests hold
#: climbs from such starts against climbs from the truth.
_RESONANCES = 32
#: Masses tried for a mode, as multiples of the device's: a decade apart, for the climb to refine.
_MASS_RATIOS = (0.03, 0.3, 3.0)
#: Damping ratios tried for a mode: a sharp resonance and a blunt one.
_DAMPING_RATIOS = (0.01, 0.1)
#: Delays tried, as the phase at the highest line, rad. Their steps are smaller than the basin from
#: which a climb finds a delay: half a turn.
_PHASES = (0.03, 0.1, 0.3, 0.6, 1.0, 1.5, 2.2, 3.0, 4.5, 6.0)
#: Devices to climb from: the most probable start may lie in another basin than the mode.
_MOST_STARTS = 3
#: A median of the lines may be negative. Then the start is the prior's 2.3 % quantile.
_LEAST_SDS = 2.0


def rough_devices(density: DeviceDensity, fewer: Array | None) -> Array:
    """Return the most probable of many rough devices.

    Parameters
    ----------
    density : DeviceDensity
        Of a log.
    fewer : ndarray, shape (1, d - 3), or None
        Log parameters of the fitted device with one mode less, where that has modes.

    Returns
    -------
    ndarray, shape (up to 3, d)
        Log parameters.
    """
    if not density.model.terms.modes:
        return _most_probable(density, _without_modes(density), _MOST_STARTS)
    devices = fewer
    if devices is None:
        devices = _without_modes(density)
    omega = density.spectra.omega
    resonances = np.geomspace(omega[0], omega[-1], _RESONANCES)
    starts = []
    for device, resonance in itertools.product(devices, resonances):
        candidates = _with_mode(device, resonance)
        best = _most_probable(density, candidates, 1)
        starts.append(best[0])
    return _most_probable(density, np.array(starts), _MOST_STARTS)


def _most_probable(density: DeviceDensity, devices: Array, most: int) -> Array:
    """Return the devices of the highest density, the best first."""
    order = np.argsort(-density(devices))
    return devices[order[:most]]


def _with_mode(device: Array, resonance: float) -> Array:
    """Give a device (d - 3,) a mode at a resonance, rad/s, of several masses and dampings."""
    devices = []
    for mass_ratio, damping_ratio in itertools.product(_MASS_RATIOS, _DAMPING_RATIOS):
        mass = mass_ratio * np.exp(device[0])
        stiffness = mass * resonance**2
        damping = 2.0 * damping_ratio * mass * resonance
        mode = np.log([mass, stiffness, damping])
        devices.append(np.append(device, mode))
    return np.array(devices)


def _without_modes(density: DeviceDensity) -> Array:
    """Return a rough device per delay: the medians over lines of what each says of m and b."""
    terms = density.model.terms
    omega = density.spectra.omega
    response = density.spectra.response
    size = len(density.names) - OF_A_MODE * terms.modes
    smallest = np.exp(density.prior_mean - _LEAST_SDS * density.prior_sd)
    delays = np.zeros(1)
    if terms.delay:
        delays = np.array(_PHASES) / omega[-1]
    devices = []
    for delay in delays:
        undelayed = response * np.exp(1j * omega * delay)
        # A rigid device without a spring has the impedance jω·m + b.
        mass = np.median(undelayed.imag / omega)
        damping = np.median(undelayed.real)
        device = density.prior_mean[:size].copy()
        device[0] = np.log(max(mass, smallest[0]))
        device[1] = np.log(max(damping, smallest[1]))
        if terms.delay:
            device[density.names.index("delay")] = np.log(delay)
        devices.append(device)
    return np.array(devices)
