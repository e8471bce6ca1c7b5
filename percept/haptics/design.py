"""Couplings that are stable and keep Z_h_vc inside a boundary: for one environment, and for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    BoolArray,
    ComplexArray,
    FloatArray,
    complex_from,
    nonnegative_array,
    ratio,
)
from percept.haptics.impedance import (
    Warp,
    device_impedance,
    device_parts,
    environment_impedance,
    warp,
)
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.limits import stable_stiffness
from percept.haptics.records import AnyDevice, Coupling, Environment, refuse_arrays
from percept.haptics.search import search_grid, section_minimum
from percept.haptics.stability import demands
from percept.html import NotebookRecord

# An edge is pulled inside by this much, so that the coupling returned passes the test it came from.
_INSIDE = 1e-11


@dataclass(frozen=True, eq=False)
class EnvironmentBoundary:
    """What a coupled environment has to stay inside of.

    Parameters
    ----------
    environment : Environment
        Z_e, one environment.
    lower, upper : array_like, shape (n,)
        Limits of abs(Z_h_vc) at each ω of the analysis, N·s/m; inf in `upper` sets no limit.

    Raises
    ------
    UsageError
        Where a limit is NaN or negative, or lower is above upper; such a boundary can never be met.
    """

    environment: Environment
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        try:
            lower, upper = (np.array(limit, dtype=np.float64) for limit in (self.lower, self.upper))
        except (TypeError, ValueError) as error:
            raise UsageError("the limits of an EnvironmentBoundary are numbers.") from error
        if lower.ndim != 1 or lower.shape != upper.shape:
            raise UsageError(
                "an EnvironmentBoundary needs two arrays of one length.", value=(lower.shape, upper.shape)
            )
        wrong = np.flatnonzero(~((lower >= 0) & (lower <= upper)))
        if wrong.size:
            where = int(wrong[0])
            raise UsageError(
                f"a boundary must satisfy 0 <= lower <= upper; it does not at position {where}.",
                value=(float(lower[where]), float(upper[where])),
                hint="Corner curves cross; give the envelope.",
            )
        parts = (self.environment.stiffness, self.environment.damping, self.environment.mass)
        if any(np.ndim(part) for part in parts):
            raise UsageError(
                "an EnvironmentBoundary is for one environment, without arrays.", value=self.environment
            )
        for name, limit in (("lower", lower), ("upper", upper)):
            limit.flags.writeable = False
            object.__setattr__(self, name, limit)


@dataclass(frozen=True, eq=False)
class QualifyingRegion(NotebookRecord):
    """Every (k_c, b_c) that is stable and inside, one line of b_c at a time.

    Attributes
    ----------
    damping : ndarray, shape (n,)
        b_c of each line, N·s/m.
    intervals : tuple of ndarray, each of shape (m, 2)
        The k_c that qualify on each line, (low, high) in N/m; exact at the ω of the analysis.
    largest, softest : Coupling or None
        The qualifying coupling with the largest and with the smallest k_c, searched between the lines too;
        None where nothing qualifies.
    """

    damping: FloatArray = field(repr=False)
    intervals: tuple[FloatArray, ...] = field(repr=False)
    largest: Coupling | None
    softest: Coupling | None


@dataclass(frozen=True, eq=False)
class CouplingDesign(NotebookRecord):
    """Couplings that qualify for each environment, and for all of them at once.

    Attributes
    ----------
    each : tuple of QualifyingRegion
        In the order of the boundaries.
    common : QualifyingRegion
        For all boundaries together.
    frequencies : int
        At how many ω a coupling was checked; between them it may leave a boundary.
    """

    each: tuple[QualifyingRegion, ...]
    common: QualifyingRegion
    frequencies: int


def design_couplings(
    omega: ArrayLike,
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    period: float,
    *,
    hold: str = "average",
    damping: ArrayLike | None = None,
) -> CouplingDesign:
    """Return the couplings that are stable (Eq. 6) and keep each environment, and all, inside (Eq. 12).

    For a fixed b_c each limit of abs(Z_h_vc) is a quadratic inequality in k_c, and stability an upper limit
    of k_c: the qualifying k_c are intervals found without search.

    Parameters
    ----------
    omega : array_like, shape (n,)
        rad/s, where the boundaries are given; above 0 and below π/T.
    device : Device or TabulatedDevice
        The device, Z_d.
    boundaries : sequence of EnvironmentBoundary
        At least one.
    period : float
        Sampling period T, s.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.
    damping : array_like, shape (m,), optional
        The lines of b_c, N·s/m; by default some 160 of them up to the largest that is stable.

    Returns
    -------
    CouplingDesign

    Raises
    ------
    UsageError
        No boundary, a boundary of another length than ω, ω not strictly between 0 and Nyquist or outside a
        device's table, a device with arrays as parameters, T not positive, an unknown hold; a damping that
        is negative or no list.
    """
    if not boundaries:
        raise UsageError("a coupling needs at least one boundary to stay inside of.")
    grid = warp(omega, period)
    if grid.omega.ndim != 1 or (grid.sin <= 0).any() or (grid.cos <= 0).any():
        raise UsageError("omega must be a list strictly between 0 and Nyquist.", value=grid.omega.shape)
    for boundary in boundaries:
        if boundary.lower.shape != grid.omega.shape:
            raise UsageError(
                "a boundary and omega differ in length.", value=(boundary.lower.shape, grid.omega.shape)
            )
    refuse_arrays(device, Coupling(0.0, 0.0))
    b_c = (
        _usual_lines(device, period, hold)
        if damping is None
        else nonnegative_array(damping, "damping", "N·s/m")
    )
    if b_c.ndim != 1 or not b_c.size:
        raise UsageError("damping must be a list of one value or more.", value=b_c.shape)
    walls = tuple(_Walls.of(grid, device, boundary, hold) for boundary in boundaries)

    def region(walls: tuple[_Walls, ...]) -> QualifyingRegion:
        def gaps(damping: FloatArray) -> Gaps:
            cuts = np.concatenate([wall.forbidden(damping) for wall in walls], axis=1)
            return Gaps.of(stable_stiffness(device, damping, period, hold), cuts)

        lines = np.unique(b_c)
        on_lines = gaps(lines)
        largest, softest = _extremes(gaps, lines, on_lines.costs())
        return QualifyingRegion(lines, on_lines.lines(), largest, softest)

    each = tuple(region((wall,)) for wall in walls)
    common = each[0] if len(each) == 1 else region(walls)
    return CouplingDesign(each=each, common=common, frequencies=grid.omega.size)


def _usual_lines(device: AnyDevice, period: float, hold: str) -> FloatArray:
    """Return b_c from 0 to the largest that is stable at all."""
    everywhere = warp(search_grid(device, period), period)
    available, _ = device_parts(everywhere, device)
    viscous, _ = demands(everywhere, hold)
    largest = float(np.maximum(ratio(available, viscous, empty=np.inf), 0.0).min())
    return np.concatenate([largest * np.linspace(0, 1, 81), largest * np.geomspace(1e-4, 1, 81)])


@dataclass(frozen=True, eq=False)
class _Walls:
    """What one boundary asks at each ω.

    With Z_c = b_c + k_c·ζ, Z_h_vc = (Z_dZ_e + Z_cZ_h)/(Z_e + Z_c): both are linear in k_c.
    """

    z_e: ComplexArray  # (n,)
    z_h: ComplexArray  # (n,)
    uncoupled: ComplexArray  # (n,) Z_dZ_e
    zeta: ComplexArray  # (n,)
    boundary: EnvironmentBoundary

    @classmethod
    def of(cls, grid: Warp, device: AnyDevice, boundary: EnvironmentBoundary, hold: str) -> _Walls:
        z_e = environment_impedance(grid.omega, boundary.environment, grid.period)
        z_d = device_impedance(grid.omega, device, grid.period)
        z_h = z_d + zero_order_hold(grid.omega, grid.period, kind=hold) * z_e
        return cls(z_e, z_h, z_d * z_e, complex_from(0.0, -grid.inverse_rate), boundary)

    def forbidden(self, lines: FloatArray) -> FloatArray:
        """Return the open intervals of k_c that leave the boundary, shape (lines, cuts, 2)."""
        zeta, z_h, b_c = self.zeta, self.z_h, lines[:, None]
        top0, top1 = self.uncoupled + b_c * z_h, zeta * z_h
        under0, under1 = self.z_e + b_c, zeta
        over, under = np.abs(top0), np.abs(under0)
        along, across = (top0 * np.conj(top1)).real, (under0 * np.conj(under1)).real
        cuts = []
        for limit, side in ((self.boundary.upper, 1.0), (self.boundary.lower, -1.0)):
            bounded = np.isfinite(limit)
            u = np.where(bounded, limit, 0.0)
            # Products of sum and difference, where squares of near numbers would cancel.
            a = np.abs(zeta) ** 2 * (np.abs(z_h) - u) * (np.abs(z_h) + u)
            half_b = along - u**2 * across
            c = (over - u * under) * (over + u * under)
            cut = where_positive(side * np.broadcast_to(a, c.shape), side * half_b, side * c)
            cuts.append(np.where(bounded[:, None], cut, np.nan))
        return np.concatenate(cuts, axis=1).reshape(lines.size, -1, 2)


@dataclass(frozen=True, eq=False)
class Gaps:
    """Qualifying intervals of k_c on lines of b_c; where `kept`, `low` to `high`, increasing, N/m."""

    low: FloatArray
    high: FloatArray
    kept: BoolArray

    @classmethod
    def of(cls, ceiling: FloatArray, forbidden: FloatArray) -> Gaps:
        """Take open intervals (lines, cuts, 2) out of [0, ceiling] of each line; NaN forbids nothing."""
        absent = np.isnan(forbidden).any(axis=2)
        starts = np.where(absent, np.inf, forbidden[..., 0])
        ends = np.where(absent, -np.inf, forbidden[..., 1])
        order = starts.argsort(axis=1)
        starts, ends = np.take_along_axis(starts, order, axis=1), np.take_along_axis(ends, order, axis=1)
        none = np.zeros((ceiling.size, 1))
        high = np.minimum(np.concatenate([starts, none + np.inf], axis=1), ceiling[:, None])
        low = np.maximum.accumulate(np.concatenate([none, ends], axis=1), axis=1)
        # After an interval that forbids nothing the same gap would stand again.
        again = np.concatenate([none > 0, high[:, 1:] == high[:, :-1]], axis=1)
        return cls(low, high, (high > low) & ~again & (ceiling > 0)[:, None])

    def lines(self) -> tuple[FloatArray, ...]:
        """Return the intervals of each line, shape (m, 2)."""
        pairs = np.stack([self.low[self.kept], self.high[self.kept]], axis=1)
        return tuple(np.split(pairs, np.cumsum(self.kept.sum(axis=1))[:-1]))

    def costs(self) -> FloatArray:
        """Return −(largest k_c) and the smallest k_c of each line, shape (2, lines); inf without any."""
        largest = np.where(self.kept, -self.high, np.inf).min(axis=1)
        return np.stack([largest, np.where(self.kept, self.low, np.inf).min(axis=1)])


def where_positive(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where a·k² + 2·half_b·k + c > 0: two open intervals, NaN where absent; shape (..., 4)."""
    # A line counts as a parabola that bends down, with its other root at infinity.
    a = np.where(a == 0, -0.0, a)
    always = (a == 0) & (half_b == 0) & (c > 0)
    discriminant = half_b**2 - a * c
    real = discriminant > 0
    root = half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b)
    one, other = ratio(-root, a, empty=np.nan), ratio(-c, root, empty=np.nan)
    low, high = np.fmin(one, other), np.fmax(one, other)
    convex = a > 0
    outside, between = convex & real, ~convex & real
    ends = np.empty((*low.shape, 4))
    ends[..., 0] = np.where(convex | always, -np.inf, np.where(between, low, np.nan))
    ends[..., 1] = np.where(convex | always, np.inf, np.where(between, high, np.nan))
    ends[outside, 1] = low[outside]
    ends[..., 2] = np.where(outside, high, np.nan)
    ends[..., 3] = np.where(outside, np.inf, np.nan)
    return ends


def _extremes(
    gaps: Callable[[FloatArray], Gaps], lines: FloatArray, costs: FloatArray
) -> tuple[Coupling | None, Coupling | None]:
    """Return the couplings at the largest and the smallest k_c, also between the lines beside the best."""
    best = costs.argmin(axis=1)
    if not np.isfinite(costs.min()):
        return None, None

    def cost(damping: FloatArray) -> FloatArray:
        # Both searches in one call: the first column is the one for the largest k_c.
        both = gaps(damping.ravel()).costs().reshape(2, *damping.shape)
        return np.stack([both[0, :, 0], both[1, :, 1]], axis=1)

    low, high = lines[np.maximum(best - 1, 0)], lines[np.minimum(best + 1, lines.size - 1)]
    candidates = np.stack([section_minimum(cost, low, high), lines[best]])
    damping = candidates[cost(candidates).argmin(axis=0), [0, 1]]
    on_largest, on_softest = gaps(damping).lines()
    low_k, high_k = on_largest[-1]
    largest = Coupling(float(high_k - _inset(low_k, high_k)), float(damping[0]))
    low_k, high_k = on_softest[0]
    # k_c = 0 needs no inset: nothing is cut there.
    softest = low_k + _inset(low_k, high_k) if low_k else 0.0
    return largest, Coupling(float(softest), float(damping[1]))


def _inset(low: float, high: float) -> float:
    return min(_INSIDE * high, (high - low) / 2)
