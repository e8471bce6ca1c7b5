"""The control loop about a device: how it holds, delays and filters; angles along its axis.

Tustin's frequency axis runs from DC to Nyquist, and every quantity on it has its limit at either
end. Searches and drawings take frequencies at which no feature of the loop is missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    checked_period,
    one_of,
    ratio,
    real_array,
    times,
)
from percept.haptics.records import AnyDevice, Device, Mode, TabulatedDevice

HOLDS = ("average", "true")
# In samples. Searches over frequency then need 40,000 points; a loop so late renders nothing.
_LONGEST_DELAY = 1000.0
# Sections of a higher order differ less from an ideal low pass than sensors do.
_HIGHEST_ORDER = 8
# π is _PI + _PI_LOW to 107 bits, so that π − ωT keeps its digits next to Nyquist.
_PI = float(np.pi)
_PI_LOW = 1.2246467991473532e-16
# A smaller ωT counts as zero: nothing below then overflows on its way to the limit.
_DC_SLACK = 1e-100
# ωT this near to π is Nyquist: as a product of two doubles it is not known better.
_NYQUIST_SLACK = 4 * float(np.spacing(np.pi))
# A table may leave out this fraction of the range up to Nyquist at either end.
_COVERED = 1e-3
# Points of a search between DC and Nyquist, evenly spaced and as many evenly in the logarithm: 100
# to each of its six decades.
_SPACED = 600
# Points to a sample of delay: what it asks for rises and falls once in two samples.
_SPACED_PER_SAMPLE = 40
# Where a mode is looked at, in its widths to either side of its resonance: each a fifth farther out
# than the last.
_OFFSETS = np.geomspace(1e-2, 1e3, 60)
# A mode without damping counts as this wide, as a fraction of its resonance.
_NARROWEST = 1e-6
# Points of the shortest grid: a peak or a turn needs three.
_FEWEST = 3


@dataclass(frozen=True)
class VelocityFilter:
    """A low pass that the velocity goes through before a damper acts on it.

    It is Butterworth's, discretized by Tustin's method so that the cutoff stays where it is.

    Parameters
    ----------
    cutoff : float
        rad/s, where the gain is √½; above zero, and below π/T of the loop it is used in.
    order : int, optional
        1 to 8.

    Raises
    ------
    UsageError
        A cutoff or an order out of these ranges.
    """

    cutoff: float
    order: int = 1

    def __post_init__(self) -> None:
        cutoff = real_array(self.cutoff, "cutoff of the velocity filter", "rad/s")
        if cutoff.ndim or not cutoff > 0:
            raise UsageError(
                "cutoff of the velocity filter must be one number above zero, in rad/s.",
                value=self.cutoff,
                hint="A cutoff in Hz is multiplied by 2π.",
            )
        if self.order not in range(1, _HIGHEST_ORDER + 1):
            raise UsageError(
                f"order of the velocity filter must be 1 to {_HIGHEST_ORDER}.", value=self.order
            )
        object.__setattr__(self, "cutoff", float(cutoff))


@dataclass(frozen=True)
class Loop:
    """A device in the control loop that renders with it.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Z_d.
    period : float
        Sampling period T, s.
    hold : {"average", "true"}
        Eq. 8 (default), or the true zero-order hold.
    velocity_filter : VelocityFilter, optional
        Of the velocity of the device. The damper that joins the device acts on it: that of the
        coupling, or without a coupling that of the environment.
    delay : float
        d, samples, zero or more; fractions are allowed. The hold is multiplied by e^{−jdωT}.

    Raises
    ------
    UsageError
        T not positive, an unknown hold, a delay that is negative, not finite or above 1,000
        samples, a filter with its cutoff at Nyquist or above.
    """

    device: AnyDevice
    period: float
    hold: str = "average"
    velocity_filter: VelocityFilter | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        period = checked_period(self.period)
        one_of(self.hold, "hold", HOLDS)
        delay = real_array(self.delay, "delay", "samples")
        if delay.ndim or not 0 <= delay <= _LONGEST_DELAY:
            raise UsageError(
                f"delay must be one number of samples, 0 to {_LONGEST_DELAY:g}.",
                value=self.delay,
                hint="A delay in seconds is divided by the sampling period.",
            )
        if self.velocity_filter is not None and self.velocity_filter.cutoff * period >= np.pi:
            raise UsageError(
                "cutoff of the velocity filter does not lie below the Nyquist frequency,"
                f" {np.pi / period:.6g} rad/s.",
                value=self.velocity_filter.cutoff,
                hint="Lower the cutoff (rad/s, not Hz), or shorten the period.",
            )
        object.__setattr__(self, "period", period)
        object.__setattr__(self, "delay", float(delay))

    @property
    def nyquist(self) -> float:
        """π/T, rad/s."""
        return _PI / self.period

    @property
    def rigid(self) -> Device | None:
        """The device where it is a mass, a damper and a spring alone."""
        device = self.device
        return device if isinstance(device, Device) and not device.modes else None

    def at(self, omega: ArrayLike) -> Warp:
        """Check ω and return its angles.

        Parameters
        ----------
        omega : array_like
            rad/s, up to π/T in magnitude.

        Returns
        -------
        Warp
            Of ω's shape; ωT within 4 ulp of π is Nyquist.

        Raises
        ------
        UsageError
            ω above Nyquist, or a value that is not finite.
        """
        omega = real_array(omega, "omega", "rad/s")
        theta = omega * self.period
        size = np.abs(theta)
        above = size > _PI + _NYQUIST_SLACK
        if above.any():
            raise UsageError(
                f"omega is above the Nyquist frequency, {self.nyquist:.17g} rad/s at a period of"
                f" {self.period:g} s.",
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
            loop=self,
            omega=omega,
            half=half,
            sin=np.where(at_nyquist, np.sign(theta), np.sin(half)),
            cos=np.where(at_nyquist, 0.0, cos),
        )


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
    """Angles of a set of ω in a loop with period T, h = ωT/2, accurate from DC to Nyquist."""

    loop: Loop
    omega: FloatArray  # rad/s
    half: FloatArray  # h, rad
    sin: FloatArray  # sin h
    cos: FloatArray  # cos h

    @property
    def period(self) -> float:
        """T, s."""
        return self.loop.period

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

    def spring(self, stiffness: ArrayLike) -> FloatArray:
        """Return Im(k/s) = −k/Ω."""
        return -times(stiffness, self.inverse_rate)

    def held(self) -> Held:
        """Return the gain of the loop's hold and its products with Ω."""
        gain = self.cos
        rate = (2 / self.period) * self.sin
        if self.loop.hold == "true":
            gain = np.sinc(self.half / np.pi)
            rate = gain * self.rate
        return Held(gain, rate, gain * self.inverse_rate)

    def lag(self) -> Lag:
        """Return by how much the loop is delayed."""
        turn = (2 * self.loop.delay) * self.half
        sin = np.sin(turn)
        return Lag(sin, np.cos(turn), ratio(sin, self.sin, empty=2 * self.loop.delay))

    def turn(self) -> ComplexArray:
        """Return e^{−j(h + ψ)}, by which hold and delay turn a force."""
        lag = self.lag()
        return np.asarray((self.cos - 1j * self.sin) * (lag.cos - 1j * lag.sin))


def covers_range(loop: Loop) -> bool:
    """Say whether a device is known from DC to Nyquist.

    A table may leave out a thousandth of the range at either end.
    """
    device = loop.device
    if not isinstance(device, TabulatedDevice):
        return True
    from_dc = device.omega[0] <= _COVERED * loop.nyquist
    to_nyquist = device.omega[-1] >= (1 - _COVERED) * loop.nyquist
    return bool(from_dc and to_nyquist)


def search_grid(
    loop: Loop, modes: tuple[Mode, ...] = (), *, within: tuple[float, float] | None = None
) -> FloatArray:
    """Return ω at which no feature of a device, of more modes or of a delay is missed.

    Parameters
    ----------
    loop : Loop
        The modes of its device, or the rows of its table, add to an even grid, and so does a long
        delay.
    modes : tuple of Mode, optional
        Others that resonate.
    within : pair of float, optional
        Ends of the grid, rad/s; by default DC and Nyquist, or the ends of the table.

    Returns
    -------
    ndarray, shape (n,)
        rad/s, increasing.

    Raises
    ------
    UsageError
        The table begins above Nyquist.
    """
    device = loop.device
    nyquist = np.pi / loop.period
    for_delay = int(np.ceil(_SPACED_PER_SAMPLE * loop.delay))
    parts = [
        np.array([0.0]),
        np.geomspace(1e-6, 1, _SPACED) * nyquist,
        np.linspace(0, 1, max(_SPACED, for_delay)) * nyquist,
    ]
    first = 0.0
    last = nyquist
    if isinstance(device, TabulatedDevice):
        first = float(device.omega[0])
        last = min(float(device.omega[-1]), nyquist)
        if first > nyquist:
            raise UsageError(
                "the device's table begins above the Nyquist frequency.",
                value=first,
                hint="Check the sampling period and the unit of omega (rad/s, not Hz).",
            )
        parts.append(device.omega)
    else:
        modes = (*device.modes, *modes)
    parts += [_around(mode, loop.period) for mode in modes if mode.resonance]
    if within is not None:
        first, last = within
        parts.append(np.array(within))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= first) & (omega <= last)]


def _around(mode: Mode, period: float) -> FloatArray:
    """Return ω, rad/s, about the resonance of a mode."""
    width = mode.damping / mode.mass + _NARROWEST * mode.resonance
    rates = mode.resonance + width * np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
    # At these Ω of Tustin's method.
    half = np.arctan(np.maximum(rates, 0.0) * (period / 2))
    return np.asarray((2 / period) * half)


def log_grid(within: tuple[float, float], per_decade: int, near: FloatArray) -> FloatArray:
    """Return ω even in the logarithm, and those near features.

    Parameters
    ----------
    within : pair of float
        First and last frequency, rad/s.
    per_decade : int
        Frequencies per decade of the even ones, at least.
    near : ndarray, shape (R,) or (D, R)
        Further frequencies, rad/s; of D devices each has its own.

    Returns
    -------
    ndarray, shape (n,) or (D, n)
        rad/s, increasing; of D devices those beyond the range stand at its ends.
    """
    lower, upper = within
    intervals = int(np.ceil(per_decade * np.log10(upper / lower)))
    even = np.geomspace(lower, upper, max(_FEWEST, intervals + 1))
    if near.ndim == 1:
        inside = near[(near > lower) & (near < upper)]
        return np.unique(np.concatenate([even, inside]))
    rows = np.tile(even, (len(near), 1))
    return np.sort(np.hstack([rows, np.clip(near, lower, upper)]), axis=1)
