"""Tustin's frequency axis: every trigonometric factor of ω and T, accurate from DC to Nyquist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import LARGEST, SHORTEST_PERIOD, FloatArray, one_of, real_array

HOLDS = ("average", "true")

# π is _PI + _PI_LOW to 107 bits, so that π − ωT keeps its digits next to Nyquist.
_PI = float(np.pi)
_PI_LOW = 1.2246467991473532e-16
_DC_SLACK = 1e-100
_NYQUIST_SLACK = 4 * float(np.spacing(np.pi))


@dataclass(frozen=True)
class Held:
    """The hold's gain g and its products with Ω, each with its limit at DC and Nyquist."""

    gain: FloatArray  # g = abs(ZOH): cos(θ/2) for the averaging hold of Eq
    rate: FloatArray  # g·Ω, rad/s
    per_rate: FloatArray  # g/Ω, s/rad


@dataclass(frozen=True)
class Warp:
    """Angles of a set of ω under sampling with period T, h = ωT/2."""

    omega: FloatArray  # rad/s
    period: float  # T, s
    half: FloatArray
    sin: FloatArray
    cos: FloatArray

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
    """Check ω and T and return their angles."""
    period = checked_period(period)
    omega = real_array(omega, "omega", "rad/s")
    theta = omega * period
    size = np.abs(theta)
    above = size > _PI + _NYQUIST_SLACK
    if above.any():
        raise UsageError(
            f"omega is above the Nyquist frequency, {_PI / period:.17g} rad/s at a period of {period:g} s.",
            value=float(omega[above][0]),
            hint="Lower omega, or shorten the period.",
        )
    # Slower than anything, and nothing below overflows on its way to the limit.
    theta = np.where(size < _DC_SLACK, 0.0 * theta, theta)
    half = theta / 2
    # π − θ is exact where θ is near π, and its sine then keeps every digit that ωT has.
    cos = np.where(size > np.pi / 2, np.sin(((_PI - size) + _PI_LOW) / 2), np.cos(half))
    at_nyquist = size >= _PI - _NYQUIST_SLACK
    cos = np.where(at_nyquist, 0.0, cos)
    sin = np.where(at_nyquist, np.sign(theta), np.sin(half))
    return Warp(omega=omega, period=period, half=half, sin=sin, cos=cos)


def checked_period(period: float) -> float:
    """Return T as a float, or refuse it."""
    value = real_array(period, "period", "s")
    if value.ndim or not value >= SHORTEST_PERIOD:
        raise UsageError(
            "period must be one positive number of seconds.",
            value=period,
            hint=f"Give the sampling period, {SHORTEST_PERIOD:g} to {LARGEST:g} s.",
        )
    return float(value)
