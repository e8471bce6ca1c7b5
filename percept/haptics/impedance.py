"""Impedances of device, environment, coupling and hold (Eqs 5 to 8), and of filtered dampers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    Scalars,
    complex_from,
    one_of,
    ratio,
    times,
)
from percept.haptics.loop import Held, Loop, VelocityFilter, Warp
from percept.haptics.records import Coupling, Device, Environment, TabulatedDevice

DISCRETIZATIONS = ("tustin", "backward")


class Element(NamedTuple):
    """m·s + b + k/s, of numbers or arrays that broadcast; of either sign."""

    stiffness: Scalars  # k, N/m
    damping: Scalars  # b, N·s/m
    mass: Scalars = 0.0  # m, kg


def series(grid: Warp, first: Element, second: Element) -> Element:
    """Return the damping and the stiffness of two elements in series, at each ω.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    first, second : Element
        Z₁ and Z₂; `second` has no mass. Their parameters broadcast against ω.

    Returns
    -------
    Element
        Re Z, N·s/m, and −Ω·Im Z, N/m, of Z = Z₁Z₂/(Z₁ + Z₂). At an undamped resonance the
        stiffness is +inf (a pole has no sign).

    Notes
    -----
    Z₁Z₂/(Z₁ + Z₂) = a₂²Z₁ + a₁²Z₂ with aᵢ = |Zᵢ|/|Z₁ + Z₂|: both weights are positive, so a passive
    pair keeps every digit of its damping. In the stiffness what springs and masses add to the
    weights is drawn together to k₁k₂(k₁ + k₂): left in them, it would be a difference of large
    numbers near a resonance, k₁ = −k₂.
    """
    r1, x1 = _scaled_parts(grid, first)
    r2, x2 = _scaled_parts(grid, second)
    at_nyquist = grid.cos == 0
    vanishing = (at_nyquist | (grid.sin == 0)) & (r1 + r2 == 0) & (x1 + x2 == 0)
    if vanishing.any():
        # At an end where neither a spring nor a mass leads, dampers do. Without dampers springs do.
        undamped = np.add(first.damping, second.damping) == 0
        r1 = np.where(vanishing, np.where(undamped, first.stiffness, first.damping), r1)
        r2 = np.where(vanishing, np.where(undamped, second.stiffness, second.damping), r2)
    total = np.hypot(r1 + r2, x1 + x2)

    def over_total(part: FloatArray) -> FloatArray:
        return ratio(part, total, empty=0.0)

    weight1 = over_total(np.hypot(r2, x2)) ** 2
    weight2 = over_total(np.hypot(r1, x1)) ** 2
    damping = times(weight1, first.damping) + times(weight2, second.damping)
    # The rate at Nyquist is not used there; 0 keeps it finite.
    inertia = np.multiply(first.mass, np.where(at_nyquist, 0.0, grid.rate) ** 2)
    with np.errstate(invalid="ignore"):
        k1 = first.stiffness - inertia
        k2 = second.stiffness
        by_dampers = times(over_total(r2) ** 2, k1) + times(over_total(r1) ** 2, k2)
        stiffness = by_dampers + times(over_total(x1) * over_total(x2), k1 + k2)
    pole = (total == 0) & (x1 != 0)
    stiffness = np.where(np.isfinite(stiffness) & ~pole, stiffness, np.inf)
    # A mass outgrows all at Nyquist, and next to it takes b₂²/m off the stiffness.
    heavy = at_nyquist & (np.asarray(first.mass) > 0)
    taken = ratio(np.square(second.damping), first.mass, empty=0.0)
    return Element(np.where(heavy, second.stiffness - taken, stiffness), damping)


def _scaled_parts(grid: Warp, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z·sin h·cos h, which is finite from DC to Nyquist."""
    inertia = np.multiply(element.mass, (2 / grid.period) * grid.sin**2)
    spring = np.multiply(element.stiffness, (grid.period / 2) * grid.cos**2)
    return np.multiply(element.damping, grid.sin * grid.cos), inertia - spring


def device_impedance(loop: Loop, omega: ArrayLike) -> ComplexArray:
    """Return Z_d(jω) of a loop's device (Eq. 5, a spring and flexible modes added).

    Parameters
    ----------
    loop : Loop
        A table is taken as measured: T only says where Nyquist is.
    omega : array_like
        rad/s, up to π/T in magnitude.

    Returns
    -------
    ndarray of complex
        N·s/m, of the broadcast shape of ω and the device's parameters. At Nyquist a mass makes it
        infinite, at DC a spring.

    Raises
    ------
    UsageError
        ω above Nyquist or outside the table, or a value that is not finite.
    """
    return complex_from(*device_parts(loop.at(omega)))


def device_parts(grid: Warp) -> tuple[FloatArray, FloatArray]:
    """Return Re Z_d and Im Z_d, N·s/m."""
    device = grid.loop.device
    if isinstance(device, TabulatedDevice):
        value = device.at(grid.omega)
        return value.real, value.imag
    return element_parts(grid, _device_element(grid, device))


def element_parts(grid: Warp, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of m·s + b + k/s, N·s/m."""
    reactance = times(element.mass, grid.rate) + grid.spring(element.stiffness)
    return np.asarray(element.damping), reactance


def rotated_device(grid: Warp) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z_d·e^{j(h + ψ)}, the device from behind hold and delay, N·s/m."""
    device = grid.loop.device
    if isinstance(device, TabulatedDevice):
        turned = device.at(grid.omega) / grid.turn()
        return turned.real, turned.imag
    stiffness, damping, mass = _device_element(grid, device)
    conjugate = Element(np.negative(stiffness), damping, np.negative(mass))
    not_held = Held(np.ones_like(grid.omega), grid.rate, grid.inverse_rate)
    real, imaginary = held_parts(grid, not_held, conjugate)
    return real, -imaginary


def held_parts(grid: Warp, held: Held, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of g·e^{−j(h + ψ)}·(m·s + b + k/s), N·s/m.

    Each product of gain, Ω^±1 and sin h or cos h is written out so that no factor overflows beside
    one that vanishes; only k at DC and m at Nyquist (true hold) are left with an infinite factor.
    """
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
    # The spring's own part of the imaginary one, times sin ψ, is finite at DC.
    elastic_lag = gain_cos * grid.cos * lag.sin_per_sin * (grid.period / 2)
    late_real = (
        times(lag.cos, real)
        + lag.sin * inertial_and_viscous
        - times(element.stiffness, elastic_lag)
    )
    return late_real, times(lag.cos, imaginary) - times(lag.sin, real)


def _device_element(grid: Warp, device: Device) -> Element:
    """Return mass, damping and stiffness of a device at each ω, with those its modes show."""
    stiffness: Scalars = device.stiffness
    damping = np.add(device.damping, np.zeros_like(grid.omega))
    for mode in device.modes:
        mass = Element(0.0, 0.0, mode.mass)
        shown = series(grid, mass, Element(mode.stiffness, mode.damping))
        damping = damping + shown.damping
        stiffness = stiffness + shown.stiffness
    return Element(stiffness, damping, device.mass)


def environment_impedance(loop: Loop, omega: ArrayLike, environment: Environment) -> ComplexArray:
    """Return Z_e(jω) of an environment that joins the device, by Tustin's method (Eq. 7).

    Parameters as in `device_impedance`; the environment's broadcast against ω.

    Returns
    -------
    ndarray of complex
        N·s/m. Infinite at DC where there is stiffness, at Nyquist where there is mass.

    Raises
    ------
    UsageError
        As `device_impedance`.
    """
    grid = loop.at(omega)
    return complex_from(*element_parts(grid, environment_element(grid, environment)))


def environment_element(grid: Warp, environment: Environment) -> Element:
    """Return an environment that joins the device: a filter makes a part of its damper a spring."""
    undamped = Element(environment.stiffness, 0.0, environment.mass)
    return _with_damper(grid, undamped, environment.damping)


def coupling_element(grid: Warp, coupling: Coupling, discretization: str) -> Element:
    """Return a coupling at each ω in Tustin's form, its damper filtered likewise."""
    spring = Element(coupling.stiffness, spring_damping(coupling, grid.period, discretization))
    return _with_damper(grid, spring, coupling.damping)


def _with_damper(grid: Warp, element: Element, damping: Scalars) -> Element:
    """Add a damper, which acts on the filtered velocity where there is a filter."""
    velocity_filter = grid.loop.velocity_filter
    if velocity_filter is None:
        return element._replace(damping=np.add(element.damping, damping))
    response = filter_response(grid, velocity_filter)
    # At Nyquist Ω·Im F is the warped cutoff for the first order, and vanishes for the others.
    end = 0.0
    if velocity_filter.order == 1:
        end = (2 / grid.period) * float(np.tan(velocity_filter.cutoff * grid.period / 2))
    stiffness = ratio(-response.imag * (2 / grid.period) * grid.sin, grid.cos, empty=end)
    return Element(
        stiffness=element.stiffness + np.multiply(damping, stiffness),
        damping=element.damping + np.multiply(damping, response.real),
        mass=element.mass,
    )


def filter_response(grid: Warp, velocity_filter: VelocityFilter) -> ComplexArray:
    """Return F(jω), exact from DC, 1, to Nyquist, 0.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    velocity_filter : VelocityFilter
        Its cutoff lies below Nyquist.

    Returns
    -------
    ndarray of complex
        Dimensionless, of ω's shape.

    Notes
    -----
    With x = tan h/tan h_c, h_c half the cutoff times T, a pair of poles of damping ratio ζ gives
    1/(1 − x² + 2jζx), and the pole of an odd order 1/(1 + jx). Both are multiplied by powers of
    u = cos h·sin h_c, so that nothing is infinite, with v = sin h·cos h_c in place of x. Then
    u² − v² is sin(h_c − h)·sin(h_c + h).
    """
    half_cutoff = velocity_filter.cutoff * grid.period / 2
    u = grid.cos * np.sin(half_cutoff)
    v = grid.sin * np.cos(half_cutoff)
    difference = np.sin(half_cutoff - grid.half) * np.sin(half_cutoff + grid.half)
    order = velocity_filter.order
    response = np.ones(grid.omega.shape, dtype=np.complex128)
    if order % 2:
        response = u / complex_from(u, v)
    for pair in range(order // 2):
        damping_ratio = np.sin((2 * pair + 1) * np.pi / (2 * order))
        response = response * (u * u / complex_from(difference, 2 * damping_ratio * u * v))
    return np.asarray(response)


def coupling_impedance(
    loop: Loop, omega: ArrayLike, coupling: Coupling, *, discretization: str = "backward"
) -> ComplexArray:
    """Return Z_c(jω) of a virtual coupling (Eq. 6, or Eq. 12's form).

    Parameters as in `device_impedance`; the coupling's broadcast against ω.
    `discretization` is the backward difference (Eq. 6, default) or "tustin" (Eq. 12).

    Returns
    -------
    ndarray of complex
        N·s/m. Infinite at DC where there is stiffness.

    Raises
    ------
    UsageError
        As `device_impedance`, and for an unknown discretization.
    """
    grid = loop.at(omega)
    return complex_from(*element_parts(grid, coupling_element(grid, coupling, discretization)))


def coupling_admittance(
    loop: Loop, omega: ArrayLike, coupling: Coupling, *, discretization: str = "backward"
) -> ComplexArray:
    """Return 1/Z_c(jω), the p22 of Eq. 4.

    Parameters as in `coupling_impedance`.

    Returns
    -------
    ndarray of complex
        m/(N·s). Infinite where there is no coupling at all.

    Raises
    ------
    UsageError
        As `coupling_impedance`.
    """
    z_c = coupling_impedance(loop, omega, coupling, discretization=discretization)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(z_c == 0, np.inf, 1 / z_c)[()]


def spring_damping(coupling: Coupling, period: float, discretization: str) -> FloatArray:
    """Return the damping of a spring in Tustin's form: k_c·(Tz)/(z−1) is k_c/s and k_c·T/2."""
    one_of(discretization, "discretization", DISCRETIZATIONS)
    return np.multiply(coupling.stiffness, 0.0 if discretization == "tustin" else period / 2)


def hold(loop: Loop, omega: ArrayLike) -> ComplexArray:
    """Return ZOH(jω): the averaging hold of Eq. 8 or the true zero-order hold.

    Parameters as in `device_impedance`. With h = ωT/2 the hold is cos h·e^{−jh} for "average"
    (Eq. 8), and (sin h/h)·e^{−jh} for "true". A delay of d samples multiplies it by e^{−2jdh}.

    Returns
    -------
    ndarray of complex
        Dimensionless, of ω's shape.

    Raises
    ------
    UsageError
        As `device_impedance`.
    """
    grid = loop.at(omega)
    return np.asarray(grid.held().gain * grid.turn())[()]
