"""Environments rendered without a coupling: the damping they need, the largest that stay passive.

Colgate and Schenkel's criterion asks that no passive hand can destabilize a device that samples its
position and holds its force (true hold, velocity by backward difference). The loop is
W = T/(4 sin² h)·(1 − z⁻¹)·H(z) with h = ωT/2. Per unit of stiffness, damping and mass it is

    k: j(T/2)·e^{−jh}/sin h        b: −F·e^{−2jh}        m: −j(2/T)·sin h·e^{−3jh}

where F is the velocity filter. A delay of n whole samples multiplies W by e^{−2jnh}. The device
then needs a damping b_d ≥ Re W at every ω.

A further fraction f of a sample turns each alias of ω by another angle. Their average is
W̄ = W·(1 − f + f·e^{−2jh}), and the condition is b_d² − b_d·Re W̄ ≥ f(1 − f)·sin² h·abs(W)².
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    ComplexArray,
    FloatArray,
    IntArray,
    checked_period,
    nonnegative_array,
    ratio,
)
from percept.haptics.axis import Warp, warp
from percept.haptics.limits import StableRegion, largest_coupling_damping, stable_stiffness
from percept.haptics.loop import AnyHold, Hold
from percept.haptics.perceived import perceived_impedance
from percept.haptics.records import AnyDevice, Device, Environment
from percept.haptics.search import lowest, search_grid
from percept.haptics.velocity import VelocityFilter, filter_response

__all__ = [
    "PassivityDamping",
    "coupled_region",
    "direct_region",
    "largest_passive_damping",
    "largest_passive_stiffness",
    "passivity_damping",
]

_NO_DEVICE = Device(0.0, 0.0)
# Points on a region's edge, evenly spaced in damping: enough to show its corners.
_EDGE_POINTS = 129


class PassivityDamping(NamedTuple):
    """Device damping above which an environment rendered without coupling is passive, N·s/m."""

    colgate: FloatArray  # By Colgate & Schenkel: true zero-order hold, backward differences
    paper: FloatArray  # In the paper's own model (Eqs 7, 8)


def passivity_damping(
    environment: Environment, period: float, *, delay: float = 0.0
) -> PassivityDamping:
    """Return the device damping above which an environment rendered without coupling is passive.

    Parameters
    ----------
    environment : Environment
        Its parameters may be arrays.
    period : float
        Sampling period T, s.
    delay : float
        Of the loop, in samples.

    Returns
    -------
    PassivityDamping
        Of the broadcast shape of the environment's parameters.

    Raises
    ------
    UsageError
        T not positive, a delay that `Hold` refuses.

    Notes
    -----
    Without delay and filter: Colgate & Schenkel ask b_d > T/(2(1 − cos θ))·Re[(1 − e^{−jθ})·H] for
    all θ = ωT. With u = sin²(θ/2) the right-hand side is k·T/2 − b(1 − 2u) − (2m/T)(3u − 4u²):
    convex in u, so largest at DC, k·T/2 − b, or at Nyquist, k·T/2 + b + 2m/T. Without mass that is
    k·T/2 + abs(b). In the paper's model it is k·T/2 − b: there Re Z_h = b_d +
    cos²(θ/2)(b − k·T/2) + (2m/T)·sin²(θ/2), smallest at DC where it can be negative at all.
    Otherwise both are searched over ω.
    """
    period = checked_period(period)
    hold = Hold("average", delay)
    if hold.delay or environment.velocity_filter is not None:
        return _searched_damping(environment, period, hold)
    elastic = np.multiply(environment.stiffness, period / 2)
    inertial = np.multiply(environment.mass, 2 / period)
    colgate = elastic + environment.damping + inertial
    paper = elastic - environment.damping
    # The mass asks for nothing there; its shape counts all the same.
    paper = paper + np.multiply(environment.mass, 0.0)
    return PassivityDamping(np.asarray(colgate)[()], np.asarray(paper)[()])


def _searched_damping(environment: Environment, period: float, hold: Hold) -> PassivityDamping:
    """Return what `passivity_damping` does, by a search over ω."""
    parameters = np.broadcast_arrays(environment.stiffness, environment.damping, environment.mass)
    shape = parameters[0].shape
    k, b, m = (parameter.ravel() for parameter in parameters)
    velocity_filter = environment.velocity_filter

    # What is left of a device without damping: its lowest value is the damping needed, negated.
    def spare_colgate(omega: FloatArray, which: IntArray) -> FloatArray:
        grid = warp(omega, period)
        sampled = _Sampled.of(grid, hold.delay, velocity_filter)
        return -sampled.needed(k[which], b[which], m[which])

    def spare_paper(omega: FloatArray, which: IntArray) -> FloatArray:
        rendered = Environment(k[which], b[which], m[which], velocity_filter)
        perceived = perceived_impedance(omega, _NO_DEVICE, rendered, period, hold=hold)
        return perceived.real

    grid = search_grid(_NO_DEVICE, period, hold)
    colgate = -lowest(spare_colgate, grid, k.size).value
    paper = -lowest(spare_paper, grid, k.size).value
    return PassivityDamping(colgate.reshape(shape)[()], paper.reshape(shape)[()])


class _Sampled(NamedTuple):
    """The sampled loop per unit of stiffness, damping and mass, at each ω (see the module)."""

    spring: FloatArray  # Re W̄ per unit of k, s
    damper: FloatArray  # The same per unit of b
    inertia: FloatArray  # And per unit of m, 1/s
    # sin h·W per unit of k, b and m. Only its size counts, so all three are turned by
    # e^{j(2n + 1)h}/j, which makes that of k real.
    half_period: float  # Of k: T/2, s
    spread_damper: ComplexArray
    spread_inertia: ComplexArray
    spread: float  # f(1 − f)

    @classmethod
    def of(cls, grid: Warp, delay: float, velocity_filter: VelocityFilter | None) -> _Sampled:
        """Take a loop with a delay in samples."""
        whole = float(np.floor(delay))
        fraction = delay - whole
        h = grid.half
        response: ComplexArray = np.ones(h.shape, dtype=np.complex128)
        if velocity_filter is not None:
            response = filter_response(grid, velocity_filter)
        turned_once = _mean_turn(h, whole, fraction, half_samples=1)
        turned_twice = _mean_turn(h, whole, fraction, half_samples=2)
        turned_thrice = _mean_turn(h, whole, fraction, half_samples=3)
        # sin((2n + 1)h)/sin h tends to 2n + 1 at DC.
        at_dc = (1 - fraction) * (2 * whole + 1) + fraction * (2 * whole + 3)
        half_period = grid.period / 2
        per_half_period = 2 / grid.period
        return cls(
            spring=half_period * ratio(-turned_once.imag, grid.sin, empty=at_dc),
            damper=-(turned_twice * response).real,
            inertia=per_half_period * grid.sin * turned_thrice.imag,
            half_period=half_period,
            spread_damper=1j * grid.sin * response * np.exp(-1j * h),
            spread_inertia=-per_half_period * grid.sin**2 * np.exp(-2j * h),
            spread=fraction * (1 - fraction),
        )

    def needed(self, k: FloatArray, b: FloatArray, m: FloatArray) -> FloatArray:
        """Return the device damping that each ω asks for, N·s/m; zero where it asks for none."""
        mean_loop = k * self.spring + b * self.damper + m * self.inertia
        if not self.spread:
            return np.maximum(mean_loop, 0.0)
        loop = k * self.half_period + b * self.spread_damper + m * self.spread_inertia
        # The larger root of b_d² − b_d·Re W̄ = f(1 − f)·sin² h·abs(W)².
        twice_spread = 2 * np.sqrt(self.spread) * np.abs(loop)
        root = np.hypot(mean_loop, twice_spread)
        return np.asarray((mean_loop + root) / 2)

    def largest_stiffness(self, device: FloatArray, b: FloatArray) -> FloatArray:
        """Return the largest k, N/m, that a device damping allows together with b at each ω.

        b_d² − b_d·Re W̄ − f(1 − f)·sin² h·abs(W)² must not be negative. In k it is
        constant − 2·half_slope·k − bend·k².
        """
        spread = self.spread
        bend = spread * self.half_period**2
        mixed = spread * self.half_period * b * self.spread_damper.real
        half_slope = device * self.spring / 2 + mixed
        spare = device * (device - b * self.damper)
        constant = spare - spread * np.abs(b * self.spread_damper) ** 2
        discriminant = half_slope**2 + bend * constant
        root = np.sqrt(np.maximum(discriminant, 0.0))
        # Of the two forms of the root, the one that adds terms of one sign.
        with_rising_slope = ratio(constant, root + half_slope, empty=np.inf)
        with_falling_slope = ratio(root - half_slope, bend, empty=np.inf)
        limit = np.where(half_slope > 0, with_rising_slope, with_falling_slope)
        is_impossible = (constant < 0) | (device == 0)
        return np.where(is_impossible, 0.0, limit)


def _mean_turn(h: FloatArray, whole: float, fraction: float, half_samples: int) -> ComplexArray:
    """Return e^{−j(2n + half_samples)h}, averaged over the samples to either side of a delay."""
    before = np.exp(-1j * (2 * whole + half_samples) * h)
    if not fraction:
        return np.asarray(before)
    after = np.exp(-1j * (2 * whole + half_samples + 2) * h)
    return np.asarray((1 - fraction) * before + fraction * after)


def largest_passive_stiffness(
    device_damping: ArrayLike,
    damping: ArrayLike,
    period: float,
    *,
    delay: float = 0.0,
    velocity_filter: VelocityFilter | None = None,
) -> FloatArray:
    """Return the largest stiffness that is passive with a damping, rendered without coupling.

    Parameters
    ----------
    device_damping : array_like
        b_d, N·s/m, zero or more; of many devices at once.
    damping : array_like
        b of the environment, N·s/m, zero or more.
    period : float
        Sampling period T, s.
    delay : float
        Of the loop, in samples.
    velocity_filter : VelocityFilter, optional
        Of the velocity that b acts on.

    Returns
    -------
    ndarray
        N/m, of the broadcast shape; 0 where b alone is not passive.

    Raises
    ------
    UsageError
        A negative damping, T not positive, a delay or filter out of its range.

    Notes
    -----
    By Colgate & Schenkel's criterion; without delay and filter that is 2(b_d − b)/T.
    """
    period = checked_period(period)
    device = nonnegative_array(device_damping, "device damping", "N·s/m")
    b = nonnegative_array(damping, "damping", "N·s/m")
    device, b = np.broadcast_arrays(device, b)
    hold = Hold("true", delay)
    if not hold.delay and velocity_filter is None:
        return (np.maximum(device - b, 0.0) * (2 / period))[()]
    devices = device.ravel()
    dampings = b.ravel()

    def limits(omega: FloatArray, which: IntArray) -> FloatArray:
        grid = warp(omega, period)
        sampled = _Sampled.of(grid, hold.delay, velocity_filter)
        return sampled.largest_stiffness(devices[which], dampings[which])

    search = search_grid(_NO_DEVICE, period, hold)
    least = lowest(limits, search, devices.size)
    return least.value.reshape(device.shape)[()]


def largest_passive_damping(
    device_damping: ArrayLike,
    period: float,
    *,
    delay: float = 0.0,
    velocity_filter: VelocityFilter | None = None,
) -> FloatArray:
    """Return the largest damping that is passive without stiffness, rendered without coupling.

    Parameters as in `largest_passive_stiffness`. The device damping needed is proportional to the
    damping rendered, so one search at 1 N·s/m serves all devices.

    Returns
    -------
    ndarray
        N·s/m, of the shape of `device_damping`.

    Raises
    ------
    UsageError
        As `largest_passive_stiffness`.
    """
    device = nonnegative_array(device_damping, "device damping", "N·s/m")
    unit = Environment(0.0, 1.0, 0.0, velocity_filter)
    needed = passivity_damping(unit, period, delay=delay)
    return (device / needed.colgate)[()]


def direct_region(
    device_damping: float,
    period: float,
    *,
    delay: float = 0.0,
    velocity_filter: VelocityFilter | None = None,
) -> StableRegion:
    """Return the edge of all (k, b) that are passive when they are rendered without a coupling.

    Parameters as in `largest_passive_stiffness`, for one device.

    Returns
    -------
    StableRegion
        The vertices on the edge from b = 0 on, and the corner at the origin.

    Raises
    ------
    UsageError
        As `largest_passive_stiffness`.
    """
    most = largest_passive_damping(
        device_damping, period, delay=delay, velocity_filter=velocity_filter
    )
    damping = np.linspace(0.0, float(most), _EDGE_POINTS)
    stiffness = largest_passive_stiffness(
        device_damping, damping, period, delay=delay, velocity_filter=velocity_filter
    )
    return StableRegion(np.append(stiffness, 0.0), np.append(damping, 0.0))


def coupled_region(
    device: AnyDevice,
    period: float,
    hold: AnyHold = "average",
    velocity_filter: VelocityFilter | None = None,
) -> StableRegion:
    """Return the edge of all stable couplings: what a rigid wall behind a coupling shows.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Known from DC to Nyquist.
    period : float
        Sampling period T, s.
    hold : {"average", "true"} or Hold
        Eq. 8, or the true zero-order hold; with a delay, a `Hold`.
    velocity_filter : VelocityFilter, optional
        Of the first order, of the velocity that b_c acts on.

    Returns
    -------
    StableRegion
        k_c and b_c on the edge from b_c = 0 on, and the corner at the origin.

    Raises
    ------
    UsageError
        T not positive, a table that begins above Nyquist, an unknown hold.
    """
    most = largest_coupling_damping(device, period, hold, velocity_filter)
    damping = np.linspace(0.0, most, _EDGE_POINTS)
    stiffness = stable_stiffness(device, damping, period, hold, velocity_filter)
    return StableRegion(np.append(stiffness, 0.0), np.append(damping, 0.0))
