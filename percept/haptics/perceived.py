"""What the hand feels: Z_h without and with a coupling, and what that shows (Eqs 11 to 13).

abs(Z_h) is a distance from one point in the plane of (g·b, g·k/Ω); boxes of (k, b) lie in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    BoolArray,
    ComplexArray,
    FloatArray,
    IntArray,
    Scalars,
    complex_from,
    ratio,
    real_array,
    times,
)
from percept.haptics.impedance import (
    Element,
    coupling_element,
    device_parts,
    environment_element,
    held_parts,
    rotated_device,
    series,
)
from percept.haptics.loop import Loop, Warp
from percept.haptics.records import Coupling, Device, Environment, joint_shape

Limits = tuple[ArrayLike, ArrayLike]
"""Lower and upper limit of k, N/m, or of b, N·s/m."""


class Point(NamedTuple):
    """Stiffness and damping, numbers or arrays of one shape; of either sign."""

    stiffness: Scalars  # N/m
    damping: Scalars  # N·s/m


class Term(NamedTuple):
    """A term of stiffness or damping, gain·value + offset, N·s/m."""

    gain: FloatArray
    offset: FloatArray


class Range(NamedTuple):
    """N limits of one quantity, shape (N,) each."""

    low: FloatArray
    high: FloatArray


class Boxes(NamedTuple):
    """N limits of stiffness and damping."""

    stiffness: Range  # N/m
    damping: Range  # N·s/m


class DistancePlane(NamedTuple):
    """The plane of (g·b, g·k/Ω), in which abs(Z_h) is the distance from one point.

    The device sets that point. With g the hold's gain, h = ωT/2 and a delay of d samples,
    abs(Z_h) = abs(Z_d·e^{j(1 + 2d)h} + g·b + j·g·(m·Ω − k/Ω)).
    """

    gain: FloatArray  # g
    per_rate: FloatArray  # g/Ω, s/rad
    real: FloatArray  # Real part of Z_d·e^{j(1 + 2d)h} + j·g·m·Ω, N·s/m
    imaginary: FloatArray  # Its imaginary part, N·s/m

    @classmethod
    def of(cls, grid: Warp, mass: ArrayLike = 0.0) -> DistancePlane:
        """Take the loop's device with the environment's mass, kg, at each ω."""
        held = grid.held()
        real, imaginary = rotated_device(grid)
        return cls(held.gain, held.per_rate, real, imaginary + times(mass, held.rate))

    def flat(self) -> DistancePlane:
        """Return all fields in one shape (n,)."""
        return DistancePlane(*(field.ravel() for field in np.broadcast_arrays(*self)))

    def select(self, which: IntArray | BoolArray | slice) -> DistancePlane:
        """Return some of the n elements of a flat plane, or of the last axis of another."""
        return DistancePlane(*(field[..., which] for field in self))

    def terms(self) -> tuple[Term, Term]:
        """Return the terms of stiffness and of damping, whose squares add up to abs(Z_h)²."""
        return Term(self.per_rate, -self.imaginary), Term(self.gain, self.real)

    def column(self) -> DistancePlane:
        """Return the n elements of a flat plane as a column, which points broadcast against."""
        return DistancePlane(*(field[:, None] for field in self))

    def offsets(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Return real and imaginary part of Z_h·e^{j(1 + 2d)h}, N·s/m."""
        k, b = point
        return self.gain * b + self.real, self.imaginary - times(k, self.per_rate)

    def distance(self, point: Point) -> FloatArray:
        """Return abs(Z_h), N·s/m."""
        return np.hypot(*self.offsets(point))

    def over(self, stiffness: Limits, damping: Limits) -> Range:
        """Return between which abs(Z_h) lie over boxes of k and b, N·s/m."""
        real = [np.multiply(self.gain, b) + self.real for b in damping]
        ends = [self.imaginary - times(k, self.per_rate) for k in stiffness]
        # g/Ω changes sign with ω.
        imaginary = [np.minimum(*ends), np.maximum(*ends)]
        gaps = []
        reaches = []
        for low, high in (real, imaginary):
            gaps.append(np.maximum(0.0, np.maximum(low, -high)))
            reaches.append(np.maximum(np.abs(low), np.abs(high)))
        return Range(np.hypot(*gaps), np.hypot(*reaches))

    def origin(self) -> Point:
        """Return the (k, b) at which Z_h vanishes; infinite where there is none."""
        k = ratio(self.imaginary, self.per_rate, empty=np.inf)
        return Point(k, ratio(-self.real, self.gain, empty=np.inf))


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
        shape = joint_shape(self.loop.device, self.coupling)
        return shape[0] if shape else None

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
    held_real, held_imaginary = held_parts(grid, grid.held(), element)
    return complex_from(real + held_real, imaginary + held_imaginary)


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
