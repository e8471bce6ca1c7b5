"""Tustin's frequency axis, with the gain and the delay of a hold along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import FloatArray, checked_period, ratio, real_array, times
from percept.haptics.loop import AnyHold, hold_of

__all__ = ["Held", "Lag", "Warp", "omega_of_rate", "warp"]

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


class Lag(NamedTuple):
    """The angle ψ = dωT by which a delay of d samples turns what the hold puts out."""

    sin: FloatArray  # sin ψ
    cos: FloatArray  # cos ψ
    sin_per_sin: FloatArray  # sin ψ/sin h, 2d at DC


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

    def held(self, hold: AnyHold) -> Held:
        """Return the gain of `hold` ("average", Eq. 8, or "true") and its products with Ω."""
        kind = hold_of(hold).kind
        with np.errstate(divide="ignore"):
            if kind == "average":
                per_rate = (self.period / 2) * self.cos**2 / self.sin
                return Held(self.cos, (2 / self.period) * self.sin, per_rate)
            gain = np.sinc(self.half / np.pi)
            return Held(gain, gain * self.rate, gain * self.inverse_rate)

    def lag(self, hold: AnyHold) -> Lag | None:
        """Return by how much a hold is delayed; None without a delay."""
        delay = hold_of(hold).delay
        if not delay:
            return None
        turn = (2 * delay) * self.half
        sin = np.sin(turn)
        return Lag(sin, np.cos(turn), ratio(sin, self.sin, empty=2 * delay))


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
