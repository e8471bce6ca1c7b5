"""What the hand feels: Z_h with and without a virtual coupling, and what a coupling shows (Eqs 11 to 13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    Scalars,
    complex_from,
    real_array,
    times,
)
from percept.haptics.impedance import (
    Element,
    Held,
    Warp,
    device_parts,
    rotated_device,
    series,
    tustin_damping,
    warp,
)
from percept.haptics.records import AnyDevice, Coupling, Environment


def effective_impedance(
    omega: ArrayLike,
    environment: Environment,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "tustin",
) -> tuple[FloatArray, FloatArray]:
    """Return the stiffness and the damping that environment and coupling in series show at each ω.

    Z_eff = Z_eZ_c/(Z_e + Z_c) has the damping Re Z_eff and the stiffness −Ω·Im Z_eff. Both may be
    compared with limits of k and b as any environment's: the same distance form holds.

    Parameters as in `perceived_impedance`.

    Returns
    -------
    stiffness, damping : ndarray
        N/m and N·s/m, of the broadcast shape of all arguments. The stiffness is +inf at an undamped
        resonance of environment and coupling.

    Raises
    ------
    UsageError
        As `perceived_impedance`.
    """
    grid = warp(omega, period)
    felt = rendered(grid, environment, coupling, discretization)
    stiffness, damping, _ = np.broadcast_arrays(felt.stiffness, felt.damping, grid.omega)
    return stiffness[()], damping[()]


def rendered(
    grid: Warp, environment: Environment, coupling: Coupling | None, discretization: str = "tustin"
) -> Element:
    """Return the environment, or what it shows through the coupling, at each ω."""
    own = Element(environment.stiffness, environment.damping, environment.mass)
    if coupling is None:
        return own
    return series(
        grid,
        own,
        Element(coupling.stiffness, tustin_damping(coupling, grid.period, discretization)),
    )


def perceived_impedance(
    omega: ArrayLike,
    device: AnyDevice,
    environment: Environment,
    period: float,
    *,
    coupling: Coupling | None = None,
    hold: str = "average",
    discretization: str = "tustin",
) -> ComplexArray:
    """Return Z_h(jω), Eq. 13, or with a coupling Z_h_vc(jω), Eq. 11.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    environment : Environment
        What is rendered, Z_e; its parameters broadcast against ω.
    period : float
        Sampling period T, s.
    coupling : Coupling, optional
        Z_c between device and environment; none means rigidly joined.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.
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
        ω above Nyquist or outside a device's table, T not positive, a value that is not finite, an
        unknown hold or discretization.
    """
    grid = warp(omega, period)
    felt = rendered(grid, environment, coupling, discretization)
    real, imaginary = device_parts(grid, device)
    held_real, held_imaginary = _held_parts(grid, grid.held(hold), felt)
    return complex_from(real + held_real, imaginary + held_imaginary)


def _held_parts(grid: Warp, held: Held, felt: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of ZOH·(m·s + b + k/s), N·s/m.

    Each product of gain, Ω^±1 and sin h or cos h is written out so that no factor overflows beside
    one that vanishes; only k at DC and m at Nyquist (true hold) are left with an infinite factor.
    """
    spring, inertia = grid.period / 2, 2 / grid.period
    real = (
        np.multiply(felt.damping, held.gain * grid.cos)
        + times(felt.mass, held.rate * grid.sin)
        - np.multiply(felt.stiffness, held.gain * grid.cos * spring)
    )
    imaginary = (
        np.multiply(felt.mass, held.gain * grid.sin * inertia)
        - np.multiply(felt.damping, held.gain * grid.sin)
        - times(felt.stiffness, held.per_rate * grid.cos)
    )
    return real, imaginary


def perceived_magnitude(
    omega: ArrayLike,
    device: AnyDevice,
    stiffness: ArrayLike,
    damping: ArrayLike,
    period: float,
    *,
    mass: ArrayLike = 0.0,
    hold: str = "average",
) -> FloatArray:
    """Return abs(Z_h), N·s/m, as a distance, for any real k and b; a mass may be negative too.

    With g the hold's gain and h = ωT/2, abs(Z_h) = abs(Z_d·e^{jh} + g·b + j·g·(m·Ω − k/Ω)): in the
    plane of (g·b, g·k/Ω) it is the distance from one point, set by the device.
    """
    grid = warp(omega, period)
    k, b = real_array(stiffness, "stiffness", "N/m"), real_array(damping, "damping", "N·s/m")
    across, along, held = distance_axes(grid, device, hold, real_array(mass, "mass", "kg"))
    return np.hypot(held.gain * b + across, along - times(k, held.per_rate))


def distance_axes(
    grid: Warp, device: AnyDevice, hold: str, mass: Scalars = 0.0
) -> tuple[FloatArray, FloatArray, Held]:
    """Return across, along and the hold such that abs(Z_h) = hypot(g·b + across, along − k·g/Ω)."""
    held = grid.held(hold)
    across, along = rotated_device(grid, device)
    return across, along + times(mass, held.rate), held
