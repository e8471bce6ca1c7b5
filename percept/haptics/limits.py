"""Which couplings meet the paper's Eq. 10 with a device: the stiffest, and all of them.

With b the device's damping, β the coupling's in Tustin's form, K = k_c·T and ρ = b/β, Eq. 10 over
all ω reads K ≤ 2βκ(ρ), where κ² = (8ρ − 1)(1 + ρ)²/(27ρ²) for 1/8 ≤ ρ ≤ 1/5 and κ² = 4ρ above;
below 1/8 nothing meets it. Under the true hold it is K² ≤ 16bβ and β ≤ πb. A delay leaves no such
forms: limits are then searched over ω.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    FloatArray,
    IntArray,
    checked_period,
    nonnegative_array,
    one_of,
    ratio,
)
from percept.haptics.axis import warp
from percept.haptics.impedance import DISCRETIZATIONS, device_parts
from percept.haptics.loop import AnyHold, hold_of
from percept.haptics.records import AnyDevice, Device
from percept.haptics.search import lowest, rising_root, search_grid
from percept.haptics.stability import demands

__all__ = [
    "max_coupling_stiffness",
    "stiffness_limits",
]

# b_c/b up to which the limit is set at DC under the backward difference (β = 5b there).
_DC_LIMIT = 5 - 2 * np.sqrt(5)


def max_coupling_stiffness(
    device_damping: ArrayLike,
    coupling_damping: ArrayLike,
    period: float,
    *,
    discretization: str = "backward",
    hold: AnyHold = "average",
) -> FloatArray:
    """Return the largest k_c with which a rigid device meets Eq. 10.

    Parameters
    ----------
    device_damping : array_like
        b_d, N·s/m, zero or more.
    coupling_damping : array_like
        b_c, N·s/m, zero or more.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"} or Hold
        Eq. 8, or the true zero-order hold; with a delay, a `Hold`.

    Returns
    -------
    ndarray
        N/m, of the broadcast shape; 0 where no positive stiffness does.

    Raises
    ------
    UsageError
        A negative damping, T not positive, a value that is not finite, an unknown discretization or
        hold.
    """
    period = checked_period(period)
    one_of(discretization, "discretization", DISCRETIZATIONS)
    hold = hold_of(hold)
    b = nonnegative_array(device_damping, "device damping", "N·s/m")
    b_c = nonnegative_array(coupling_damping, "coupling damping", "N·s/m")
    b, b_c = np.broadcast_arrays(b, b_c)
    if hold.delay:
        return _searched_stiffness(b, b_c, period, discretization, hold)[()]
    if discretization == "tustin":
        return (_stretch(b, b_c, hold) / period)[()]
    root_b = np.sqrt(b)
    at_dc = 4 * root_b * (root_b + np.sqrt(b + b_c))
    if hold_of(hold).kind == "true":
        at_nyquist = np.maximum(0.0, 2 * (np.pi * b - b_c))
        stretch = np.minimum(at_dc, at_nyquist)
    else:
        c = ratio(b_c, b, empty=np.inf)
        interior = (c > _DC_LIMIT) & (c < 8)
        # Outside the interior any c and room serve: their root is not used.
        room = np.where(interior, ratio(8 * b - b_c, b, empty=0.0), 1.0)
        root = _interior_root(np.where(interior, c, 7.0), room)
        stretch = np.where(c > _DC_LIMIT, 0.0, at_dc)
        stretch = np.where(interior, 2 * b * root, stretch)
    return (stretch / period)[()]


def _searched_stiffness(
    b: FloatArray, b_c: FloatArray, period: float, discretization: str, hold: AnyHold
) -> FloatArray:
    """Return the largest k_c of rigid devices, N/m, by a search over ω."""
    of_devices = b.ravel()
    of_couplings = b_c.ravel()

    def limits(omega: FloatArray, which: IntArray) -> FloatArray:
        device = Device(0.0, of_devices[which])
        damping = of_couplings[which]
        if discretization == "backward":
            return stiffness_limits(omega, device, damping, period, hold)
        # Eq. 10 is viscous·β² + elastic·K² ≤ b·β.
        viscous, elastic = demands(warp(omega, period), hold)
        spare = of_devices[which] - viscous * damping
        square = ratio(np.maximum(spare, 0.0) * damping, elastic, empty=np.inf)
        return np.where(spare < 0, 0.0, np.sqrt(square)) / period

    least = lowest(limits, search_grid(Device(0.0, 0.0), period, hold), of_devices.size)
    return least.value.reshape(b.shape)


def _stretch(b: FloatArray, beta: FloatArray, hold: AnyHold) -> FloatArray:
    """Return the largest K = k_c·T, N·s/m, at a damping β in Tustin's form; 0 where none is."""
    at_dc = 4 * np.sqrt(b) * np.sqrt(beta)
    if hold_of(hold).kind == "true":
        return np.where(beta <= np.pi * b, at_dc, 0.0)
    rho = ratio(b, beta, empty=0.0)
    inner = np.clip(rho, 0.125, 0.2)
    # 8ρ − 1 as (8b − β)/β, which keeps its digits next to the limit.
    above_limit = np.maximum(0.0, ratio(8 * b - beta, beta, empty=0.0))
    # Where ρ > 0.2 any value serves: the limit at DC holds.
    above_limit = np.where(rho > 0.2, 0.6, above_limit)
    kappa = np.sqrt(above_limit / 27) * (1 + inner) / inner
    return np.where(rho > 0.2, at_dc, 2 * beta * kappa)


def _interior_root(c: FloatArray, room: FloatArray) -> FloatArray:
    """Return δ = K/2b of the backward difference, between 0 and `room`.

    With e = 8 − c, the room, it solves 27δ² = (c + δ)(e − δ)(1 + c + δ)².
    The difference of the two sides is convex between the root and e: Newton from e falls onto the
    root without overshooting.
    """
    c, room = np.broadcast_arrays(c, room)
    shape = c.shape
    c = c.ravel()
    room = room.ravel()

    def excess(which: IntArray, delta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return left minus right side, and its slope."""
        beta = c[which] + delta
        rest = room[which] - delta
        square = (1 + beta) ** 2
        value = 27 * delta**2 - beta * rest * square
        slope = 54 * delta - square * (rest - beta) - 2 * beta * rest * (1 + beta)
        return value, slope

    return rising_root(excess, room, np.zeros_like(room), room).reshape(shape)


def stiffness_limits(
    omega: ArrayLike, device: AnyDevice, b_c: FloatArray, period: float, hold: AnyHold
) -> FloatArray:
    """Return the largest k_c that Eq. 10 allows at each ω; 0 where none is, inf where all are."""
    grid = warp(omega, period)
    available, _ = device_parts(grid, device)
    # Eq. 10 is viscous·β² + elastic·K² ≤ available·β.
    viscous, elastic = demands(grid, hold)
    needed = viscous * b_c
    spare = available - needed
    half_b = (needed - available / 2) / 2
    a = viscous / 4 + elastic
    # a·K² + 2·half_b·K − b_c·spare = 0, in the form that adds terms of one sign.
    spare_root = np.sqrt(np.maximum(spare, 0.0))
    root = np.hypot(half_b, np.sqrt(a) * np.sqrt(b_c) * spare_root)
    falling = ratio(root - half_b, a, empty=np.inf)
    rising = ratio(b_c * spare, root + half_b, empty=0.0)
    stretch = np.where(half_b <= 0, falling, rising)
    none = (spare < 0) | (available < 0)
    return (np.where(none, 0.0, stretch) / grid.period)[()]
