"""Couplings a rigid device can carry: the stiffest, the cheapest, and the whole stable region (Eq. 10).

With b the device's damping, β the coupling's in Tustin's form, K = k_c·T and ρ = b/β, Eq. 10 over all ω
reads K ≤ 2βκ(ρ), where κ² = (8ρ − 1)(1 + ρ)²/(27ρ²) for 1/8 ≤ ρ ≤ 1/5 and κ² = 4ρ above; below 1/8 nothing
is stable.
Under the true hold it is K² ≤ 16bβ and β ≤ πb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import FloatArray, Scalars, nonnegative_array, one_of, ratio, stored, times
from percept.haptics._warp import HOLDS, checked_period, warp
from percept.haptics.impedance import DISCRETIZATIONS, device_parts
from percept.haptics.parameters import AnyDevice
from percept.haptics.stability import demands
from percept.notebook import NotebookRecord

# β/b of the cheapest coupling: where ∂K/∂β = 0, β² − 5.5·bβ − 2b² = 0.
_CHEAPEST = (11 + np.sqrt(153)) / 4
# b_c/b up to which the limit is set at DC under the backward difference (β = 5b there).
_DC_LIMIT = 5 - 2 * np.sqrt(5)


def max_coupling_stiffness(
    device_damping: ArrayLike,
    coupling_damping: ArrayLike,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> FloatArray:
    """Return the largest k_c with which a rigid device is stable.

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
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    ndarray
        N/m, of the broadcast shape; 0 where no positive stiffness is stable.

    Raises
    ------
    UsageError
        A negative damping, T not positive, a value that is not finite, an unknown discretization or hold.
    """
    period = checked_period(period)
    one_of(discretization, "discretization", DISCRETIZATIONS)
    one_of(hold, "hold", HOLDS)
    b, b_c = np.broadcast_arrays(
        nonnegative_array(device_damping, "device damping", "N·s/m"),
        nonnegative_array(coupling_damping, "coupling damping", "N·s/m"),
    )
    if discretization == "tustin":
        return (_stretch(b, b_c, hold) / period)[()]
    at_dc = 4 * np.sqrt(b) * (np.sqrt(b) + np.sqrt(b + b_c))
    if hold == "true":
        stretch = np.minimum(at_dc, np.maximum(0.0, 2 * (np.pi * b - b_c)))
    else:
        c = ratio(b_c, b, empty=np.inf)
        interior = (c > _DC_LIMIT) & (c < 8)
        stretch = np.where(c > _DC_LIMIT, 0.0, at_dc)
        room = np.where(interior, ratio(8 * b - b_c, b, empty=0.0), 1.0)
        stretch = np.where(interior, 2 * b * _interior_root(np.where(interior, c, 7.0), room), stretch)
    return (stretch / period)[()]


def _stretch(b: FloatArray, beta: FloatArray, hold: str) -> FloatArray:
    """Return the largest K = k_c·T at a damping β in Tustin's form, N·s/m; 0 where there is none."""
    if hold == "true":
        return np.where(beta <= np.pi * b, 4 * np.sqrt(b) * np.sqrt(beta), 0.0)
    rho = ratio(b, beta, empty=0.0)
    inner = np.clip(rho, 0.125, 0.2)
    # 8ρ − 1 as (8b − β)/β, which keeps its digits next to the limit.
    left = np.where(rho > 0.2, 0.6, np.maximum(0.0, ratio(8 * b - beta, beta, empty=0.0)))
    kappa = np.sqrt(left / 27) * (1 + inner) / inner
    return np.where(rho > 0.2, 4 * np.sqrt(b) * np.sqrt(beta), 2 * beta * kappa)


def _interior_root(c: FloatArray, room: FloatArray) -> FloatArray:
    """Return δ = K/2b of the backward difference: 27δ² = (c + δ)(e − δ)(1 + c + δ)², e = `room` = 8 − c.

    The difference of the two sides is convex between the root and e: Newton from e falls onto the root
    without overshooting.
    """
    delta = room.copy()
    for _ in range(60):
        beta, left = c + delta, room - delta
        value = 27 * delta**2 - beta * left * (1 + beta) ** 2
        slope = 54 * delta - (1 + beta) ** 2 * (left - beta) - 2 * beta * left * (1 + beta)
        step = value / slope
        delta = delta - step
        if (np.abs(step) <= 2e-16 * delta).all():
            break
    return delta


def max_coupling_stiffness_at(
    omega: ArrayLike,
    device: AnyDevice,
    coupling_damping: ArrayLike,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> FloatArray:
    """Return the largest k_c that Eq. 10 allows at each ω, for any device: a quadratic in k_c.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    coupling_damping : array_like
        b_c, N·s/m, zero or more; broadcasts against ω.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    ndarray
        N/m; 0 where no positive stiffness is allowed, inf where any is. The smallest over all ω is the limit.

    Raises
    ------
    UsageError
        ω above Nyquist or outside a device's table, a negative damping, T not positive, a value that is not
        finite, an unknown discretization or hold.
    """
    one_of(discretization, "discretization", DISCRETIZATIONS)
    grid = warp(omega, period)
    b_c = nonnegative_array(coupling_damping, "coupling damping", "N·s/m")
    available, _ = device_parts(grid, device)
    # Eq. 10 is viscous·β² + elastic·K² ≤ available·β.
    viscous, elastic = demands(grid, hold)
    spare = available - viscous * b_c
    if discretization == "tustin":
        stretch = times(np.sqrt(b_c), np.sqrt(ratio(np.maximum(spare, 0.0), elastic, empty=np.inf)))
        return (np.where(spare < 0, 0.0, stretch) / grid.period)[()]
    a, half_b = viscous / 4 + elastic, (viscous * b_c - available / 2) / 2
    # a·K² + 2·half_b·K − b_c·spare = 0, in the form that adds terms of one sign.
    root = np.hypot(half_b, np.sqrt(a) * np.sqrt(b_c) * np.sqrt(np.maximum(spare, 0.0)))
    falling = ratio(root - half_b, a, empty=np.inf)
    rising = ratio(b_c * spare, root + half_b, empty=0.0)
    stretch = np.where(half_b <= 0, falling, rising)
    return (np.where((spare < 0) | (available < 0), 0.0, stretch) / grid.period)[()]


@dataclass(frozen=True)
class BestDamping(NotebookRecord):
    """The coupling damping with which a stiffness asks least of the device.

    Attributes
    ----------
    coupling_damping : float or ndarray
        b_c, N·s/m.
    device_damping : float or ndarray
        The b_d a rigid device then needs, N·s/m.
    """

    coupling_damping: Scalars
    device_damping: Scalars


def best_coupling_damping(
    stiffness: ArrayLike, period: float, *, discretization: str = "backward", hold: str = "average"
) -> BestDamping:
    """Return the b_c with which a coupling of given stiffness needs the least device damping.

    Parameters
    ----------
    stiffness : array_like
        k_c, N/m, zero or more.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    BestDamping
        For Eq. 8 with the backward difference about 0.1248·k_cT, needing 0.10695·k_cT.

    Raises
    ------
    UsageError
        A negative stiffness, T not positive, a value that is not finite, an unknown discretization or hold.
    """
    period = checked_period(period)
    one_of(discretization, "discretization", DISCRETIZATIONS)
    one_of(hold, "hold", HOLDS)
    stretch = nonnegative_array(stiffness, "stiffness", "N/m") * period
    least = 0.5 if discretization == "backward" else 0.0
    if hold == "true":
        # K²/16β falls and β/π rises: best where they meet, if the discretization lets β be that small.
        beta = max(np.sqrt(np.pi) / 4, least)
        needed = max(1 / (16 * beta), beta / np.pi)
    else:
        needed = 1 / (_CHEAPEST * 2 * np.sqrt((8 / _CHEAPEST - 1) / 27) * (1 + _CHEAPEST))
        beta = _CHEAPEST * needed
    return BestDamping(
        coupling_damping=stored((beta - least) * stretch), device_damping=stored(needed * stretch)
    )


@dataclass(frozen=True, eq=False)
class StableRegion(NotebookRecord):
    """Every coupling a rigid device can carry, as a polygon in the plane of (k_c, b_c).

    Attributes
    ----------
    stiffness, damping : ndarray, shape (n,)
        Vertices, N/m and N·s/m, in order around the region; the last joins the first. All but the corner at
        the origin lie exactly on the region's edge.
    device_damping : float
        b_d, N·s/m.
    """

    stiffness: FloatArray
    damping: FloatArray
    device_damping: float


def stable_region(
    device_damping: float,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
    points: int = 257,
) -> StableRegion:
    """Return the region of (k_c, b_c) that Eq. 10 allows a rigid device.

    Parameters
    ----------
    device_damping : float
        b_d, N·s/m, zero or more.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.
    points : int
        Vertices along the curved edge, at least 2.

    Returns
    -------
    StableRegion

    Raises
    ------
    UsageError
        A damping that is negative or not one number, T not positive, fewer than 2 points, an unknown
        discretization or hold.
    """
    period = checked_period(period)
    one_of(discretization, "discretization", DISCRETIZATIONS)
    one_of(hold, "hold", HOLDS)
    b = nonnegative_array(device_damping, "device damping", "N·s/m")
    if b.ndim:
        raise UsageError("a stable region is for one device damping.", value=device_damping)
    if points < 2 or points != int(points):
        raise UsageError("points must be a whole number of at least 2.", value=points)
    points = int(points)
    backward = discretization == "backward"
    largest = np.pi if hold == "true" else 8.0
    # Half-cosine spacing: the edge leaves both ends like a square root.
    share = np.sin(np.linspace(0, np.pi / 2, points)) ** 2
    if hold == "true" and backward:
        # The DC limit meets the axis b_c = 0 at β = 4b, beyond β = πb: the Nyquist limit is the whole edge.
        damping = np.pi * b * share
        stretch = 2 * np.pi * b * (1 - share)
    else:
        beta = b * (4.0 + (largest - 4.0) * share if backward else largest * share)
        stretch = _stretch(np.broadcast_to(b, beta.shape), beta, hold)
        damping = np.maximum(beta - stretch / 2, 0.0) if backward else beta
    if backward:
        stretch, damping = np.append(stretch, 0.0), np.append(damping, 0.0)
    elif stretch[-1]:
        # Tustin's edge starts at the origin; under the true hold it ends beside the axis of b_c.
        stretch, damping = np.append(stretch, 0.0), np.append(damping, damping[-1])
    stiffness = stretch / period
    stiffness.flags.writeable = damping.flags.writeable = False
    return StableRegion(stiffness=stiffness, damping=damping, device_damping=float(b))
