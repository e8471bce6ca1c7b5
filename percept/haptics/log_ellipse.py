"""Range of abs(Z_h) over an ellipse of (log k, log b): a curve without closed form, searched by angle."""

from __future__ import annotations

import dataclasses
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.haptics._arrays import LARGEST, BoolArray, FloatArray, ratio, real_array, times
from percept.haptics._search import stationary_points
from percept.haptics._warp import warp
from percept.haptics.ellipse import checked_centre, checked_factor
from percept.haptics.parameters import AnyDevice
from percept.haptics.perceived import distance_axes

IntArray: TypeAlias = NDArray[np.intp]

_CELLS, _PER_CELL = 72, 5
_STEP = 2 * np.pi / (_CELLS * _PER_CELL)
_ANGLES = np.asarray(_STEP * np.arange(_CELLS * _PER_CELL), dtype=np.float64)
# The first angle of every cell, the last one's before and the first one's after.
_COARSE = _PER_CELL * np.r_[-1, :_CELLS, 0]
_PAIR = "(log k, log b)"


def magnitude_envelope_log_ellipse(
    omega: ArrayLike,
    device: AnyDevice,
    centre: tuple[float, float],
    shape: ArrayLike,
    radius: float,
    period: float,
    *,
    mass: float = 0.0,
    hold: str = "average",
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest abs(Z_h) over an ellipse of (log k, log b).

    abs(Z_h) is a distance in the plane of (g·b, g·k/Ω), so over any region its extremes lie on the edge,
    except the value 0 where the region holds the point it is measured from.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d; its parameters broadcast against ω.
    centre : pair of float
        Natural logarithms of k in N/m and b in N·s/m.
    shape : array_like, shape (2, 2)
        Symmetric, positive semidefinite, such as a covariance of (log k, log b).
    radius : float
        Dimensionless, zero or more.
    period : float
        Sampling period T, s.
    mass : float, optional
        m_e, kg.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    lower, upper : ndarray
        N·s/m, of the broadcast shape of ω and the device's parameters. Every extreme seen on a grid of one
        degree is refined to the precision of a double.

    Raises
    ------
    UsageError
        A shape that is not a covariance, a negative radius, an ellipse beyond 1e±100, ω above Nyquist or
        outside a device's table, T not positive, a value that is not finite, an unknown hold.
    """
    log_k, log_b = checked_centre(centre, _PAIR)
    factor = checked_factor(shape, radius, _PAIR)
    reach = max(abs(log_k) + abs(factor[0, 0]), abs(log_b) + float(np.hypot(*factor[1])))
    if reach > np.log(LARGEST):
        raise UsageError(
            f"the ellipse reaches beyond {LARGEST:g} or below its inverse.",
            value=reach,
            hint="centre and shape are of natural logarithms of k and b.",
        )
    grid = warp(omega, period)
    across, along, held = distance_axes(grid, device, real_array(mass, "mass", "kg"), hold)
    outer = np.broadcast_shapes(across.shape, along.shape)
    gain, per_rate, across, along = (
        np.broadcast_to(part, outer).ravel() for part in (held.gain, held.per_rate, across, along)
    )
    curve = _Curve(log_k, log_b, factor)
    lower, upper = np.full((2, across.size), np.inf)
    finite = np.isfinite(per_rate) & np.isfinite(across) & np.isfinite(along)
    plane = gain[finite], per_rate[finite], across[finite], along[finite]
    lower[finite], upper[finite] = _extremes(curve, *plane)
    lower[_holds_origin(log_k, log_b, factor, gain, per_rate, across, along)] = 0.0
    return lower.reshape(outer)[()], upper.reshape(outer)[()]


@dataclasses.dataclass(frozen=True)
class _Curve:
    """Edge of the ellipse: k and b by angle."""

    log_k: float
    log_b: float
    factor: FloatArray

    def at(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return k and b."""
        along_k, along_b, cross = self.factor[0, 0], self.factor[1, 1], self.factor[1, 0]
        cos, sin = np.cos(angle), np.sin(angle)
        return np.exp(self.log_k + along_k * cos), np.exp(self.log_b + cross * cos + along_b * sin)

    def slopes(self, angle: FloatArray) -> tuple[FloatArray, ...]:
        """Return first and second derivative of log k, then of log b."""
        along_k, along_b, cross = self.factor[0, 0], self.factor[1, 1], self.factor[1, 0]
        cos, sin = np.cos(angle), np.sin(angle)
        return -along_k * sin, -along_k * cos, along_b * cos - cross * sin, -cross * cos - along_b * sin


def _extremes(
    curve: _Curve, gain: FloatArray, per_rate: FloatArray, across: FloatArray, along: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest distance along the curve, at every ω."""
    k, b = curve.at(_ANGLES)
    # Squares of numbers near one neither overflow nor vanish where they decide.
    size = np.max(
        [np.frexp(part)[1] for part in (gain * b.max(), across, along)]
        + [np.frexp(per_rate)[1] + np.frexp(k.max())[1]],
        axis=0,
    )
    g, r, p, q = (np.ldexp(part, -size) for part in (gain, per_rate, across, along))
    point, index, sign = _turning_points(g, r, p, q, k, b)

    def slopes(which: IntArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        place = point[which]
        k, b = curve.at(angle)
        k1, k2, b1, b2 = curve.slopes(angle)
        spring, damper = r[place] * k, g[place] * b
        x, y = damper + p[place], q[place] - spring
        b1, k1, b2, k2 = damper * b1, spring * k1, damper * (b2 + b1 * b1), spring * (k2 + k1 * k1)
        first = x * b1 - y * k1
        second = b1 * b1 + k1 * k1 + x * b2 - y * k2
        return sign[which] * first, sign[which] * second

    seen = _ANGLES[index]
    lower, upper = np.full(gain.size, np.inf), np.zeros(gain.size)
    # A place of the grid stays where its refinement is worse in the last digits.
    for angle in (seen, stationary_points(slopes, seen, _STEP)):
        k, b = curve.at(angle)
        with np.errstate(over="ignore"):
            distance = np.hypot(gain[point] * b + across[point], along[point] - per_rate[point] * k)
        np.minimum.at(lower, point, distance)
        np.maximum.at(upper, point, distance)
    return lower, upper


def _turning_points(
    gain: FloatArray,
    per_rate: FloatArray,
    across: FloatArray,
    along: FloatArray,
    k: FloatArray,
    b: FloatArray,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return where distances turn on the grid: which ω, which angle, and 1 for a dip or -1 for a peak.

    All are refined: on the grid the wrong one may look better. Cells of five angles are passed over where the
    square of the distance changes by more than its changes do.
    """

    def square(which: IntArray | slice, k: FloatArray, b: FloatArray) -> FloatArray:
        g, r, p, q = (part[which, None] for part in (gain, per_rate, across, along))
        x, y = g * b, r * k
        x += p
        np.subtract(q, y, out=y)
        x *= x
        y *= y
        x += y
        return x

    coarse = square(slice(None), k[_COARSE], b[_COARSE])
    change = np.diff(coarse, axis=1)  # over the last cell before zero, then from zero on
    bend = np.abs(np.diff(change, axis=1))
    bend = np.maximum(bend, np.roll(bend, -1, axis=1))
    # Half as much bend lets the slope vanish within a cell.
    cell = np.flatnonzero(np.abs(change[:, 1:]) <= bend)
    point, cell = np.divmod(cell, _CELLS)
    angles = (_PER_CELL * cell[:, None] + np.arange(-1, _PER_CELL + 1)) % _ANGLES.size
    fine = square(point, k[angles], b[angles])
    rises, falls = fine[:, 1:] >= fine[:, :-1], fine[:, 1:] <= fine[:, :-1]
    dips = np.flatnonzero(falls[:, :-1] & rises[:, 1:])
    peaks = np.flatnonzero(rises[:, :-1] & falls[:, 1:])
    row, index = np.divmod(np.concatenate([dips, peaks]), _PER_CELL)
    return point[row], _PER_CELL * cell[row] + index, np.repeat([1.0, -1.0], [dips.size, peaks.size])


def _holds_origin(
    log_k: float,
    log_b: float,
    factor: FloatArray,
    gain: FloatArray,
    per_rate: FloatArray,
    across: FloatArray,
    along: FloatArray,
) -> BoolArray:
    """Say where the region holds the (k, b) at which Z_h vanishes."""
    k, b = ratio(along, per_rate, empty=-1.0), ratio(-across, gain, empty=-1.0)
    positive = (k > 0) & (b > 0) & np.isfinite(k) & np.isfinite(b)
    d_k = np.log(np.where(positive, k, 1.0)) - log_k
    d_b = np.log(np.where(positive, b, 1.0)) - log_b
    u1 = ratio(d_k, factor[0, 0], empty=0.0)
    u2 = ratio(d_b - times(factor[1, 0], u1), factor[1, 1], empty=0.0)
    return positive & (np.hypot(u1, u2) <= 1)
