"""Impedances of the parts: device, environment, coupling and hold (Eqs 5 to 8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics._arrays import ComplexArray, FloatArray, complex_from, one_of, ratio, times
from percept.haptics._series import Element, reactance, series
from percept.haptics._warp import Warp, warp
from percept.haptics.parameters import AnyDevice, Coupling, Device, Environment, TabulatedDevice

DISCRETIZATIONS = ("tustin", "backward")


def device_impedance(omega: ArrayLike, device: AnyDevice, period: float) -> ComplexArray:
    """Return Z_d(jω) of a device (Eq. 5, flexible modes added).

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        A table is taken as measured: T only says where Nyquist is.
    period : float
        Sampling period T, s.

    Returns
    -------
    ndarray of complex
        N·s/m, of the broadcast shape of ω and the device's parameters. At Nyquist a mass makes it infinite.

    Raises
    ------
    UsageError
        ω above Nyquist or outside the table, T not positive, a value that is not finite.
    """
    return complex_from(*device_parts(warp(omega, period), device))


def device_parts(grid: Warp, device: AnyDevice) -> tuple[FloatArray, FloatArray]:
    """Return Re Z_d and Im Z_d, N·s/m."""
    if isinstance(device, TabulatedDevice):
        value = device.at(grid.omega)
        return value.real, value.imag
    damping, flexible = _modes(grid, device)
    return np.add(device.damping, damping), times(device.mass, grid.rate) + flexible


def rotated_device(grid: Warp, device: AnyDevice) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z_d·e^{jh}, the device as seen from behind the hold's delay, N·s/m."""
    if isinstance(device, TabulatedDevice):
        value = device.at(grid.omega)
        rigid_real, rigid_imag = np.zeros_like(value.real), np.zeros_like(value.real)
        damping, flexible = value.real, value.imag
    else:
        # Ω·cos h is formed as (2/T)·sin h, which stays finite at Nyquist.
        push = (2 / grid.period) * grid.sin
        rigid_real = device.damping * grid.cos - times(
            device.mass, ratio(push * grid.sin, grid.cos, empty=0.0)
        )
        rigid_imag = device.damping * grid.sin + device.mass * push
        damping, flexible = _modes(grid, device)
    real = rigid_real + (damping * grid.cos - flexible * grid.sin)
    return real, rigid_imag + (flexible * grid.cos + damping * grid.sin)


def _modes(grid: Warp, device: Device) -> tuple[FloatArray, FloatArray]:
    """Return the parts of what the flexible modes add, N·s/m."""
    damping = flexible = np.zeros_like(grid.omega)
    for mode in device.modes:
        shown = series(grid, Element(0.0, 0.0, mode.mass), Element(mode.stiffness, mode.damping))
        damping = damping + shown.damping
        flexible = flexible + reactance(grid, shown.stiffness)
    return damping, flexible


def environment_impedance(omega: ArrayLike, environment: Environment, period: float) -> ComplexArray:
    """Return Z_e(jω) by Tustin's method (Eq. 7).

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    environment : Environment
        Its parameters broadcast against ω.
    period : float
        Sampling period T, s.

    Returns
    -------
    ndarray of complex
        N·s/m. Infinite at DC where there is stiffness, at Nyquist where there is mass.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite.
    """
    grid = warp(omega, period)
    reactive = times(environment.mass, grid.rate) - times(environment.stiffness, grid.inverse_rate)
    return complex_from(np.asarray(environment.damping), reactive)


def coupling_impedance(
    omega: ArrayLike, coupling: Coupling, period: float, *, discretization: str = "backward"
) -> ComplexArray:
    """Return Z_c(jω) of a virtual coupling (Eq. 6, or Eq. 12's form).

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    coupling : Coupling
        Its parameters broadcast against ω.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Backward difference (Eq. 6, default) or Tustin (Eq. 12).

    Returns
    -------
    ndarray of complex
        N·s/m. Infinite at DC where there is stiffness.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite, an unknown discretization.
    """
    grid = warp(omega, period)
    damping = tustin_damping(coupling, grid.period, discretization)
    return complex_from(damping, -times(coupling.stiffness, grid.inverse_rate))


def coupling_admittance(
    omega: ArrayLike, coupling: Coupling, period: float, *, discretization: str = "backward"
) -> ComplexArray:
    """Return 1/Z_c(jω), the p22 of Eq. 4, whose real part Eq. 10 bounds from below.

    Parameters are those of `coupling_impedance`.

    Returns
    -------
    ndarray of complex
        m/(N·s): 0 at DC where there is stiffness, infinite where there is no coupling at all.

    Raises
    ------
    UsageError
        As `coupling_impedance`.
    """
    grid = warp(omega, period)
    damping = tustin_damping(coupling, grid.period, discretization)
    spring = times(coupling.stiffness, grid.inverse_rate)
    size = np.hypot(damping, spring)
    # Dividing twice by the modulus keeps its square from leaving the range of a double.
    real = ratio(ratio(damping, size, empty=0.0), size, empty=np.inf)
    return complex_from(real, ratio(ratio(spring, size, empty=0.0), size, empty=0.0))


def tustin_damping(coupling: Coupling, period: float, discretization: str) -> FloatArray:
    """Return the b_c that Tustin's form needs: k_c·(Tz)/(z−1) is k_c/s with k_c·T/2 of damping beside it."""
    one_of(discretization, "discretization", DISCRETIZATIONS)
    if discretization == "tustin":
        return np.asarray(coupling.damping)
    return np.add(coupling.damping, np.multiply(coupling.stiffness, period / 2))


def hold(omega: ArrayLike, period: float, *, kind: str = "average") -> ComplexArray:
    """Return ZOH(jω): the averaging hold of Eq. 8 or the true zero-order hold.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    period : float
        Sampling period T, s.
    kind : {"average", "true"}
        With h = ωT/2: cos h·e^{−jh} (Eq. 8, default) or (sin h/h)·e^{−jh}; the phase is the same.

    Returns
    -------
    ndarray of complex
        Dimensionless, of ω's shape.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite, an unknown kind.
    """
    grid = warp(omega, period)
    gain = grid.held(kind).gain
    return complex_from(gain * grid.cos, -gain * grid.sin)
