"""An environment seen through its virtual coupling: Z_eff and the velocity ratio of Eq. 12."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics._arrays import ComplexArray, FloatArray, complex_from, ratio
from percept.haptics._series import Element, Shown, end_shares, reactance, scaled_parts, series
from percept.haptics._warp import Warp, warp
from percept.haptics.impedance import tustin_damping
from percept.haptics.parameters import Coupling, Environment
from percept.haptics.response import FrequencyResponse
from percept.notebook import NotebookRecord


@dataclass(frozen=True, eq=False)
class EffectiveImpedance(NotebookRecord):
    """Z_eff = Z_eZ_c/(Z_e + Z_c), as the stiffness and damping it shows at each ω.

    Both may be compared with limits of k and b as any environment's: the same distance form holds.

    Attributes
    ----------
    omega : ndarray
        rad/s.
    stiffness : ndarray
        −Ω·Im Z_eff, N/m; +inf at an undamped resonance of environment and coupling.
    damping : ndarray
        Re Z_eff, N·s/m.
    period : float
        Sampling period T, s.
    """

    omega: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    period: float

    @property
    def value(self) -> ComplexArray:
        """Z_eff, N·s/m."""
        return complex_from(self.damping, reactance(warp(self.omega, self.period), self.stiffness))

    @property
    def response(self) -> FrequencyResponse:
        """Z_eff as a frequency response."""
        return FrequencyResponse(omega=self.omega, value=self.value, period=self.period)


def effective_impedance(
    omega: ArrayLike,
    environment: Environment,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "tustin",
) -> EffectiveImpedance:
    """Return what environment and coupling in series show at each ω.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    environment : Environment
        Z_e; its parameters broadcast against ω.
    coupling : Coupling
        Z_c; its parameters broadcast against ω.
    period : float
        Sampling period T, s.
    discretization : {"tustin", "backward"}
        Of the coupling: Eq. 12's form (default) or Eq. 6's.

    Returns
    -------
    EffectiveImpedance
        Stiffness and damping have the broadcast shape of all arguments, `omega` its own.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite, an unknown discretization.
    """
    grid = warp(omega, period)
    shown = through_coupling(grid, environment, coupling, discretization)
    shape = np.broadcast_shapes(grid.omega.shape, shown.stiffness.shape)
    return EffectiveImpedance(
        omega=grid.omega,
        stiffness=np.broadcast_to(shown.stiffness, shape),
        damping=np.broadcast_to(shown.damping, shape),
        period=grid.period,
    )


def through_coupling(grid: Warp, environment: Environment, coupling: Coupling, discretization: str) -> Shown:
    """Return what Z_eZ_c/(Z_e + Z_c) shows at each ω."""
    return series(grid, *_elements(grid, environment, coupling, discretization))


def _elements(
    grid: Warp, environment: Environment, coupling: Coupling, discretization: str
) -> tuple[Element, Element]:
    return (
        Element(environment.stiffness, environment.damping, environment.mass),
        Element(coupling.stiffness, tustin_damping(coupling, grid.period, discretization)),
    )


def velocity_ratio(
    omega: ArrayLike,
    environment: Environment,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "tustin",
) -> ComplexArray:
    """Return v_e/v_h = Z_c/(Z_e + Z_c), how much of the hand's velocity reaches the environment (Eq. 12).

    Parameters are those of `effective_impedance`.

    Returns
    -------
    ndarray of complex
        Dimensionless; 0 without a coupling, infinite at an undamped resonance of environment and coupling.

    Raises
    ------
    UsageError
        As `effective_impedance`.
    """
    grid = warp(omega, period)
    environs, coupler = _elements(grid, environment, coupling, discretization)
    r_e, x_e = scaled_parts(grid, environs)
    r_c, x_c = scaled_parts(grid, coupler)
    real, imaginary = r_e + r_c, x_e + x_c
    size = np.hypot(real, imaginary)
    # Z_c·conj(Z_e + Z_c)/|Z_e + Z_c|², dividing once before and once after the products.
    real, imaginary = ratio(real, size, empty=0.0), ratio(imaginary, size, empty=0.0)
    resonant = (size == 0) & (np.hypot(r_c, x_c) > 0)
    along = np.where(resonant, np.inf, ratio(r_c * real + x_c * imaginary, size, empty=0.0))
    across = ratio(x_c * real - r_c * imaginary, size, empty=0.0)
    (dc, _), (nyquist, _) = end_shares(environs, coupler)
    along = np.where(grid.sin == 0, dc, np.where(grid.cos == 0, nyquist, along))
    return complex_from(along, np.where((grid.sin == 0) | (grid.cos == 0), 0.0, across))
