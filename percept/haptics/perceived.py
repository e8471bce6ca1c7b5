"""What the hand feels: Z_h without and with a coupling, and what that shows (Eqs 11 to 13)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    IntArray,
    Scalars,
    complex_from,
    real_array,
    times,
)
from percept.haptics.impedance import (
    Element,
    coupling_element,
    device_parts,
    environment_element,
    series,
)
from percept.haptics.loop import Loop, Warp
from percept.haptics.plane import DistancePlane, Point
from percept.haptics.records import Coupling, Device, Environment

__all__ = [
    "Display",
    "displayed",
    "effective_impedance",
    "perceived_impedance",
    "perceived_magnitude",
    "shown_element",
]


@dataclass(frozen=True)
class Display:
    """An environment displayed by the device of a loop, directly or through a coupling.

    Mass and damping of the device and both parameters of the coupling may be arrays of shape (n,):
    then these are n displays.

    Parameters
    ----------
    loop : Loop
        With the device.
    environment : Environment
        Z_e, of single numbers.
    coupling : Coupling, optional
        Z_c in Tustin's form (Eq. 12); None where environment and device are joined directly.
    """

    loop: Loop
    environment: Environment
    coupling: Coupling | None = None

    @property
    def count(self) -> int | None:
        """Number of displays, n; None where no parameter is an array."""
        parameters: list[Scalars] = []
        for record in (self.loop.device, self.coupling):
            if isinstance(record, Device | Coupling):
                parameters += record.parameters().values()
        lengths = [np.size(parameter) for parameter in parameters if np.ndim(parameter)]
        return max(lengths, default=None)

    def select(self, which: IntArray) -> Display:
        """Return the displays of these indices, in this order."""
        loop = self.loop
        if isinstance(loop.device, Device):
            loop = replace(loop, device=loop.device.select(which))
        coupling = self.coupling
        if coupling is not None:
            coupling = coupling.select(which)
        return replace(self, loop=loop, coupling=coupling)


def effective_impedance(
    loop: Loop,
    omega: ArrayLike,
    environment: Environment,
    coupling: Coupling,
    *,
    discretization: str = "tustin",
) -> Point:
    """Return the stiffness and the damping that environment and coupling in series show at each ω.

    Z_eff = Z_eZ_c/(Z_e + Z_c) has the damping Re Z_eff and the stiffness −Ω·Im Z_eff. Both may be
    compared with limits of k and b as any environment's: the same distance form holds.

    Parameters as in `perceived_impedance`.

    Returns
    -------
    Point
        `stiffness`, N/m, and `damping`, N·s/m, of the broadcast shape of all arguments. The
        stiffness is +inf at an undamped resonance of environment and coupling.

    Raises
    ------
    UsageError
        As `perceived_impedance`.
    """
    grid = loop.at(omega)
    element = _coupled(grid, environment, coupling, discretization)
    stiffness, damping, _ = np.broadcast_arrays(element.stiffness, element.damping, grid.omega)
    return Point(stiffness[()], damping[()])


def _coupled(
    grid: Warp, environment: Environment, coupling: Coupling | None, discretization: str
) -> Element:
    """Return the environment, or environment and coupling in series, at each ω."""
    if coupling is None:
        return environment_element(grid, environment)
    behind = Element(environment.stiffness, environment.damping, environment.mass)
    return series(grid, behind, coupling_element(grid, coupling, discretization))


def shown_element(grid: Warp, display: Display) -> Element:
    """Return the stiffness and damping that a display shows at each ω.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    display : Display
        What is displayed. Its environment's mass counts with the device, and is not shown.

    Returns
    -------
    Element
        N/m and N·s/m, without mass.
    """
    element = _coupled(grid, display.environment, display.coupling, "tustin")
    if display.coupling is None:
        return Element(element.stiffness, element.damping)
    inertia = np.multiply(display.environment.mass, grid.rate**2)
    return Element(element.stiffness + inertia, element.damping)


def displayed(display: Display, omega: ArrayLike) -> tuple[DistancePlane, FloatArray]:
    """Return the plane of abs(Z_h) at each ω, rad/s, flat, and the abs(Z_h) displayed, N·s/m."""
    grid = display.loop.at(omega)
    plane = DistancePlane.of(grid, display.environment.mass).flat()
    shown = shown_element(grid, display)
    return plane, plane.distance(Point(shown.stiffness, shown.damping))


def perceived_impedance(
    loop: Loop,
    omega: ArrayLike,
    environment: Environment,
    *,
    coupling: Coupling | None = None,
    discretization: str = "tustin",
) -> ComplexArray:
    """Return Z_h(jω), Eq. 13, or with a coupling Z_h_vc(jω), Eq. 11.

    Parameters
    ----------
    loop : Loop
        With the device, Z_d.
    omega : array_like
        rad/s, up to π/T in magnitude.
    environment : Environment
        What is rendered, Z_e; its parameters broadcast against ω.
    coupling : Coupling, optional
        Z_c between device and environment; none means rigidly joined.
    discretization : {"tustin", "backward"}
        Of the coupling: Eq. 12's form (default) or Eq. 6's.

    Returns
    -------
    ndarray of complex
        N·s/m, of the broadcast shape of all arguments; limits at DC and Nyquist, infinite where the
        limit is.

    Raises
    ------
    UsageError
        ω above Nyquist or outside a device's table, a value that is not finite, an unknown
        discretization.
    """
    grid = loop.at(omega)
    element = _coupled(grid, environment, coupling, discretization)
    real, imaginary = device_parts(grid)
    held_real, held_imaginary = _held_parts(grid, element)
    return complex_from(real + held_real, imaginary + held_imaginary)


def _held_parts(grid: Warp, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of ZOH·(m·s + b + k/s), N·s/m.

    Each product of gain, Ω^±1 and sin h or cos h is written out so that no factor overflows beside
    one that vanishes; only k at DC and m at Nyquist (true hold) are left with an infinite factor.
    """
    held = grid.held()
    gain_cos = held.gain * grid.cos
    gain_sin = held.gain * grid.sin
    real = (
        np.multiply(element.damping, gain_cos)
        + times(element.mass, held.rate * grid.sin)
        - np.multiply(element.stiffness, gain_cos * (grid.period / 2))
    )
    inertial_and_viscous = np.multiply(element.mass, gain_sin * (2 / grid.period)) - np.multiply(
        element.damping, gain_sin
    )
    imaginary = inertial_and_viscous - times(element.stiffness, held.per_rate * grid.cos)
    lag = grid.lag()
    if lag is None:
        return real, imaginary
    # The spring's own part of the imaginary one, times sin ψ, is finite at DC.
    elastic_lag = gain_cos * grid.cos * lag.sin_per_sin * (grid.period / 2)
    late_real = (
        times(lag.cos, real)
        + lag.sin * inertial_and_viscous
        - np.multiply(element.stiffness, elastic_lag)
    )
    return late_real, times(lag.cos, imaginary) - times(lag.sin, real)


def perceived_magnitude(
    loop: Loop,
    omega: ArrayLike,
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    mass: ArrayLike = 0.0,
) -> FloatArray:
    """Return abs(Z_h) as a distance (see `DistancePlane`), for any real k and b.

    Parameters as in `perceived_impedance`; the mass of the environment, kg, may be negative too.

    Returns
    -------
    ndarray
        N·s/m, of the broadcast shape of all arguments.

    Raises
    ------
    UsageError
        As `perceived_impedance`.
    """
    grid = loop.at(omega)
    k = real_array(stiffness, "stiffness", "N/m")
    b = real_array(damping, "damping", "N·s/m")
    m = real_array(mass, "mass", "kg")
    return DistancePlane.of(grid, m).distance(Point(k, b))
