"""Tustin's frequency axis; impedances of device, environment, coupling and hold (Eqs 5 to 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    Scalars,
    checked_period,
    complex_from,
    one_of,
    ratio,
    real_array,
    times,
)
from percept.haptics.records import AnyDevice, Coupling, Device, Environment, TabulatedDevice

__all__ = [
    "DISCRETIZATIONS",
    "HOLDS",
    "Element",
    "Held",
    "Warp",
    "coupling_admittance",
    "coupling_impedance",
    "device_impedance",
    "device_parts",
    "environment_impedance",
    "hold",
    "omega_of_rate",
    "rotated_device",
    "series",
    "tustin_damping",
    "warp",
]

HOLDS = ("average", "true")
DISCRETIZATIONS = ("tustin", "backward")

# π is _PI + _PI_LOW to 107 bits, so that π − ωT keeps its digits next to Nyquist.
_PI = float(np.pi)
_PI_LOW = 1.2246467991473532e-16
# A smaller ωT counts as zero: nothing below then overflows on its way to the limit.
_DC_SLACK = 1e-100
# ωT this near to π is Nyquist: as a product of two doubles it is not known better.
_NYQUIST_SLACK = 4 * float(np.spacing(np.pi))


class Held(NamedTuple):
    """The hold's gain g and its products with Ω, each with its limit at DC and Nyquist."""

    gain: FloatArray  # g = abs(ZOH), cos h for the averaging hold (Eq. 8)
    rate: FloatArray  # g·Ω, rad/s
    per_rate: FloatArray  # g/Ω, s/rad


@dataclass(frozen=True)
class Warp:
    """Angles of a set of ω under sampling with period T, h = ωT/2, accurate from DC to Nyquist."""

    omega: FloatArray  # rad/s
    period: float  # T, s
    half: FloatArray  # h, rad
    sin: FloatArray  # sin h
    cos: FloatArray  # cos h

    @property
    def rate(self) -> FloatArray:
        """Ω = (2/T)·tan h, so that Tustin's s is jΩ; infinite at Nyquist."""
        with np.errstate(divide="ignore"):
            return (2 / self.period) * self.sin / self.cos

    @property
    def inverse_rate(self) -> FloatArray:
        """1/Ω = (T/2)·cot h; infinite at DC."""
        with np.errstate(divide="ignore"):
            return (self.period / 2) * self.cos / self.sin

    @property
    def one_minus_cos(self) -> FloatArray:
        """1 − cos h, without the cancellation."""
        return 2 * np.sin(self.half / 2) ** 2

    def spring(self, stiffness: ArrayLike) -> FloatArray:
        """Return Im(k/s) = −k/Ω."""
        return -times(stiffness, self.inverse_rate)

    def held(self, hold: str) -> Held:
        """Return the gain of `hold` ("average", Eq. 8, or "true") and its products with Ω."""
        one_of(hold, "hold", HOLDS)
        with np.errstate(divide="ignore"):
            if hold == "average":
                per_rate = (self.period / 2) * self.cos**2 / self.sin
                return Held(self.cos, (2 / self.period) * self.sin, per_rate)
            gain = np.sinc(self.half / np.pi)
            return Held(gain, gain * self.rate, gain * self.inverse_rate)


def warp(omega: ArrayLike, period: float) -> Warp:
    """Check ω and T and return their angles.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    period : float
        Sampling period T, s.

    Returns
    -------
    Warp
        Of ω's shape; ωT within 4 ulp of π is Nyquist.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite.
    """
    period = checked_period(period)
    omega = real_array(omega, "omega", "rad/s")
    theta = omega * period
    size = np.abs(theta)
    above = size > _PI + _NYQUIST_SLACK
    if above.any():
        raise UsageError(
            f"omega is above the Nyquist frequency, {_PI / period:.17g} rad/s at a period of"
            f" {period:g} s.",
            value=float(omega[above][0]),
            hint="Lower omega, or shorten the period.",
        )
    theta = np.where(size < _DC_SLACK, 0.0 * theta, theta)
    half = theta / 2
    # π − θ is exact where θ is near π, and its sine then keeps every digit that ωT has.
    below_nyquist = (_PI - size) + _PI_LOW
    cos = np.where(size > np.pi / 2, np.sin(below_nyquist / 2), np.cos(half))
    at_nyquist = size >= _PI - _NYQUIST_SLACK
    return Warp(
        omega=omega,
        period=period,
        half=half,
        sin=np.where(at_nyquist, np.sign(theta), np.sin(half)),
        cos=np.where(at_nyquist, 0.0, cos),
    )


def omega_of_rate(rate: ArrayLike, period: float) -> FloatArray:
    """Return the ω, rad/s, at which Tustin's Ω is a given rate, rad/s."""
    half = np.arctan(np.multiply(rate, period / 2))
    return np.asarray((2 / period) * half)


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
    total = np.hypot(r1 + r2, x1 + x2)

    def of_total(part: FloatArray) -> FloatArray:
        return ratio(part, total, empty=0.0)

    w1 = of_total(np.hypot(r2, x2)) ** 2
    w2 = of_total(np.hypot(r1, x1)) ** 2
    damping = times(w1, first.damping) + times(w2, second.damping)
    at_dc = grid.sin == 0
    at_nyquist = grid.cos == 0
    # The rate at Nyquist is not used there; 0 keeps it finite.
    rate = np.where(at_nyquist, 0.0, grid.rate)
    inertia = np.multiply(first.mass, rate**2)
    with np.errstate(invalid="ignore"):
        k1 = first.stiffness - inertia
        k2 = second.stiffness
        by_dampers = times(of_total(r2) ** 2, k1) + times(of_total(r1) ** 2, k2)
        stiffness = by_dampers + times(of_total(x1) * of_total(x2), k1 + k2)
    pole = (total == 0) & (x1 != 0)
    finite = np.isfinite(stiffness) & ~pole
    stiffness = np.where(finite, stiffness, np.inf)
    if at_dc.any():
        end = _series_at_dc(first, second)
        stiffness = np.where(at_dc, end.stiffness, stiffness)
        damping = np.where(at_dc, end.damping, damping)
    if at_nyquist.any():
        end = _series_at_nyquist(first, second)
        stiffness = np.where(at_nyquist, end.stiffness, stiffness)
        damping = np.where(at_nyquist, end.damping, damping)
    return Element(stiffness, damping)


def _scaled_parts(grid: Warp, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z·sin h·cos h, which is finite from DC to Nyquist."""
    inertia = np.multiply(element.mass, (2 / grid.period) * grid.sin**2)
    spring = np.multiply(element.stiffness, (grid.period / 2) * grid.cos**2)
    return np.multiply(element.damping, grid.sin * grid.cos), inertia - spring


def _series_at_dc(first: Element, second: Element) -> Element:
    """Return two elements in series at DC, where stiffness outgrows damping."""
    by_stiffness = np.add(first.stiffness, second.stiffness) > 0
    z1 = np.where(by_stiffness, first.stiffness, first.damping)
    z2 = np.where(by_stiffness, second.stiffness, second.damping)
    return _weighted(first, second, z1, z2)


def _series_at_nyquist(first: Element, second: Element) -> Element:
    """Return them at Nyquist, where damping outgrows stiffness, and a mass outgrows both."""
    by_damping = np.add(first.damping, second.damping) > 0
    z1 = np.where(by_damping, first.damping, first.stiffness)
    z2 = np.where(by_damping, second.damping, second.stiffness)
    heavy = np.asarray(first.mass) > 0
    z1 = np.where(heavy, 1.0, z1)
    z2 = np.where(heavy, 0.0, z2)
    end = _weighted(first, second, z1, z2)
    # Next to Nyquist a mass takes b₂²/m off the stiffness.
    taken = ratio(np.square(second.damping), first.mass, empty=0.0)
    stiffness = end.stiffness - np.where(heavy, taken, 0.0)
    return Element(stiffness, end.damping)


def _weighted(first: Element, second: Element, z1: FloatArray, z2: FloatArray) -> Element:
    """Return a₂²Z₁ + a₁²Z₂ with aᵢ = zᵢ/(z₁ + z₂), zᵢ the leading parts of Zᵢ."""
    w1 = ratio(z2, z1 + z2, empty=0.0) ** 2
    w2 = ratio(z1, z1 + z2, empty=0.0) ** 2
    return Element(
        stiffness=w1 * first.stiffness + w2 * second.stiffness,
        damping=w1 * first.damping + w2 * second.damping,
    )


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
        N·s/m, of the broadcast shape of ω and the device's parameters. At Nyquist a mass makes it
        infinite.

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
    inertia = times(device.mass, grid.rate)
    return np.add(device.damping, damping), inertia + flexible


def rotated_device(grid: Warp, device: AnyDevice) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z_d·e^{jh}, the device as seen from behind the hold's delay, N·s/m."""
    if isinstance(device, TabulatedDevice):
        value = device.at(grid.omega)
        rigid_real = rigid_imag = np.zeros_like(value.real)
        damping = value.real
        flexible = value.imag
    else:
        # Ω·cos h is formed as (2/T)·sin h, which stays finite at Nyquist.
        push = (2 / grid.period) * grid.sin
        push_tan = ratio(push * grid.sin, grid.cos, empty=0.0)
        swing = times(device.mass, push_tan)
        rigid_real = device.damping * grid.cos - swing
        rigid_imag = device.damping * grid.sin + device.mass * push
        damping, flexible = _modes(grid, device)
    real = rigid_real + (damping * grid.cos - flexible * grid.sin)
    imaginary = rigid_imag + (flexible * grid.cos + damping * grid.sin)
    return real, imaginary


def _modes(grid: Warp, device: Device) -> tuple[FloatArray, FloatArray]:
    """Return the parts of what the flexible modes add, N·s/m."""
    damping = flexible = np.zeros_like(grid.omega)
    for mode in device.modes:
        mass = Element(0.0, 0.0, mode.mass)
        shown = series(grid, mass, Element(mode.stiffness, mode.damping))
        damping = damping + shown.damping
        flexible = flexible + grid.spring(shown.stiffness)
    return damping, flexible


def environment_impedance(
    omega: ArrayLike, environment: Environment, period: float
) -> ComplexArray:
    """Return Z_e(jω) by Tustin's method (Eq. 7).

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
    grid = warp(omega, period)
    reactive = times(environment.mass, grid.rate) + grid.spring(environment.stiffness)
    return complex_from(np.asarray(environment.damping), reactive)


def coupling_impedance(
    omega: ArrayLike, coupling: Coupling, period: float, *, discretization: str = "backward"
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
    grid = warp(omega, period)
    return complex_from(
        tustin_damping(coupling, grid.period, discretization), grid.spring(coupling.stiffness)
    )


def coupling_admittance(
    omega: ArrayLike, coupling: Coupling, period: float, *, discretization: str = "backward"
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
    z_c = coupling_impedance(omega, coupling, period, discretization=discretization)
    size = np.hypot(z_c.real, z_c.imag)
    # Dividing twice by the modulus keeps its square from leaving the range of a double.
    cos = ratio(z_c.real, size, empty=0.0)
    sin = ratio(-z_c.imag, size, empty=0.0)
    real = ratio(cos, size, empty=np.inf)
    return complex_from(real, ratio(sin, size, empty=0.0))


def tustin_damping(coupling: Coupling, period: float, discretization: str) -> FloatArray:
    """Return the b_c of Tustin's form: k_c·(Tz)/(z−1) is k_c/s plus a damping of k_c·T/2."""
    one_of(discretization, "discretization", DISCRETIZATIONS)
    if discretization == "tustin":
        return np.asarray(coupling.damping)
    return np.add(coupling.damping, np.multiply(coupling.stiffness, period / 2))


def hold(omega: ArrayLike, period: float, *, kind: str = "average") -> ComplexArray:
    """Return ZOH(jω): the averaging hold of Eq. 8 or the true zero-order hold.

    ω and T as in `device_impedance`. With h = ωT/2 the hold is cos h·e^{−jh} for the kind "average"
    (Eq. 8), and (sin h/h)·e^{−jh} for "true".

    Returns
    -------
    ndarray of complex
        Dimensionless, of ω's shape.

    Raises
    ------
    UsageError
        As `device_impedance`, and for an unknown kind of hold.
    """
    grid = warp(omega, period)
    gain = grid.held(kind).gain
    return complex_from(gain * grid.cos, -gain * grid.sin)
