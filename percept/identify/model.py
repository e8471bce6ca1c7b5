"""Which device a log is fitted with: its parameters on the log scale, priors and impedance.

Z_d = m·s + b + k/s + Σ modes, with s = jω: a device is not sampled. The log's force lags the true
one by the delay, so the logged force is exp(-jω·delay)·(Z_d·V + coulomb·S), S being the spectrum of
the sign of the velocity.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.identify.spectra import Spectra

__all__ = ["OF_A_MODE", "DeviceModel", "Parameter", "Terms", "mode_names"]

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: SD of every log parameter under the prior: 95 % of it spans four decades either way.
_PRIOR_SD = math.log(100.0)
#: Prior medians: a device held in one hand.
_MASS = 1.0  # kg
_DAMPING = 1.0  # N·s/m
_STIFFNESS = 1e3  # N/m
_DELAY = 1e-3  # s
_COULOMB = 1.0  # N
_MODE_MASS = 0.1  # kg
_MODE_STIFFNESS = 1e4  # N/m
_MODE_DAMPING = 1.0  # N·s/m
#: Parameters of a mode.
OF_A_MODE = 3
_MOST_MODES = 4


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A positive parameter with its prior, normal on the log scale."""

    name: str
    unit: str
    median: float  # Of the prior, in the unit
    sd: float = _PRIOR_SD  # Of the logarithm under the prior


@dataclasses.dataclass(frozen=True)
class Terms:
    """What a device has beside mass and damping."""

    modes: int = 0
    spring: bool = False
    delay: bool = False  # Of the log's force behind its motion
    friction: bool = False  # Coulomb's, from a log in time alone

    def __post_init__(self) -> None:
        if not 0 <= self.modes <= _MOST_MODES:
            problem = f"must be 0 to {_MOST_MODES}."
            raise UsageError(problem, key="modes", value=self.modes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of a point's coordinates."""
        found = [Parameter("mass", "kg", _MASS), Parameter("damping", "N·s/m", _DAMPING)]
        if self.spring:
            found.append(Parameter("stiffness", "N/m", _STIFFNESS))
        if self.delay:
            found.append(Parameter("delay", "s", _DELAY))
        if self.friction:
            found.append(Parameter("coulomb", "N", _COULOMB))
        for number in range(1, self.modes + 1):
            mass, stiffness, damping = mode_names(number)
            found.append(Parameter(mass, "kg", _MODE_MASS))
            found.append(Parameter(stiffness, "N/m", _MODE_STIFFNESS))
            found.append(Parameter(damping, "N·s/m", _MODE_DAMPING))
        return tuple(found)


def mode_names(number: int) -> list[str]:
    """Return the names of mass, stiffness and damping of a mode, counted from 1."""
    return [f"mode {number} {part}" for part in ("mass", "stiffness", "damping")]


class DeviceModel:
    """Impedance and predicted force of devices given by log parameters.

    Parameters
    ----------
    terms : Terms
        What the device has.
    """

    def __init__(self, terms: Terms) -> None:
        self.terms = terms
        self.names = [parameter.name for parameter in terms.parameters]

    def impedance(self, points: Array, omega: Array) -> ComplexArray:
        """Return Z_d of devices at frequencies.

        Parameters
        ----------
        points : ndarray, shape (W, d)
            Logarithms of the parameters, in SI units.
        omega : ndarray, shape (K,)
            rad/s, above zero.

        Returns
        -------
        ndarray of complex, shape (W, K)
            N·s/m, without the delay of the log.
        """
        s = 1j * omega
        impedance: ComplexArray = self._value(points, "mass") * s
        impedance = impedance + self._value(points, "damping")
        if self.terms.spring:
            impedance = impedance + self._value(points, "stiffness") / s
        first = len(self.names) - OF_A_MODE * self.terms.modes
        values = np.exp(points[:, first:, None])
        for mode in range(self.terms.modes):
            mass, stiffness, damping = values[:, OF_A_MODE * mode :][:, :OF_A_MODE].swapaxes(0, 1)
            joint = damping * s + stiffness
            impedance = impedance + mass * s * joint / (mass * s**2 + joint)
        return impedance

    def force(self, points: Array, spectra: Spectra) -> tuple[ComplexArray, ComplexArray]:
        """Return the force of the log that devices predict, and its ratio to the velocity.

        Parameters
        ----------
        points : ndarray, shape (W, d)
            Logarithms of the parameters.
        spectra : Spectra
            Motion at K frequencies.

        Returns
        -------
        force, transfer : ndarray of complex, shape (W, K)
            N, as the log's transform scales it, and N·s/m.
        """
        transfer = self.impedance(points, spectra.omega)
        force = transfer * spectra.velocity
        if self.terms.friction:
            force = force + self._value(points, "coulomb") * spectra.sign
        if self.terms.delay:
            lag = np.exp(-1j * spectra.omega * self._value(points, "delay"))
            force = force * lag
            transfer = transfer * lag
        return force, transfer

    def _value(self, points: Array, name: str) -> Array:
        """Return a parameter's values, (W, 1)."""
        return np.exp(points[:, self.names.index(name), None])
