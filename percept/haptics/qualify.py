"""Couplings that are stable and keep Z_h_vc inside a boundary: for one environment, and for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import BoolArray, FloatArray, nonnegative_array, ratio
from percept.haptics._search import golden_section, wide_section
from percept.haptics._warp import Warp, warp
from percept.haptics.design import max_coupling_stiffness, max_coupling_stiffness_at
from percept.haptics.impedance import device_impedance, device_parts, environment_impedance
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.llewellyn import check_single, search_grid
from percept.haptics.parameters import AnyDevice, Coupling, Device, Environment
from percept.haptics.stability import demands

__all__ = [
    "CouplingDesign",
    "EnvironmentBoundary",
    "QualifyingRegion",
    "design_couplings",
    "qualifying_region",
]

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
        lower, upper = (np.array(limit, dtype=np.float64) for limit in (self.lower, self.upper))
        if lower.ndim != 1 or lower.shape != upper.shape:
            raise UsageError(
                "an EnvironmentBoundary needs two arrays of one length.",
                value=(lower.shape, upper.shape),
            )
        if not ((lower >= 0) & (lower <= upper)).all():
            where = int(np.flatnonzero(~((lower >= 0) & (lower <= upper)))[0])
            raise UsageError(
                f"a boundary must satisfy 0 <= lower <= upper; it does not at position {where}.",
                value=(float(lower[where]), float(upper[where])),
                hint="Corner curves cross; give the envelope.",
            )
        parts = (self.environment.stiffness, self.environment.damping, self.environment.mass)
        if any(np.ndim(part) for part in parts):
            raise UsageError(
                "a EnvironmentBoundary is for one environment, without arrays.", value=self.environment
            )
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)


@dataclass(frozen=True, eq=False)
class QualifyingRegion:
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
class CouplingDesign:
    """Couplings that qualify for each environment, and for all of them at once.

    Attributes
    ----------
    each : tuple of QualifyingRegion
        In the order of the boundaries.
    common : QualifyingRegion
        For all boundaries together.
    """

    each: tuple[QualifyingRegion, ...]
    common: QualifyingRegion


def design_couplings(
    omega: ArrayLike,
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    period: float,
    *,
    discretization: str | None = None,
    hold: str = "average",
    damping: ArrayLike | None = None,
) -> CouplingDesign:
    """Return the couplings that are stable and keep each environment, and all of them, inside.

    Parameters are those of `qualifying_region`.

    Returns
    -------
    CouplingDesign

    Raises
    ------
    UsageError
        As `qualifying_region`.
    """

    def region(chosen: Sequence[EnvironmentBoundary]) -> QualifyingRegion:
        return qualifying_region(
            omega, device, chosen, period, discretization=discretization, hold=hold, damping=damping
        )

    return CouplingDesign(
        each=tuple(region([boundary]) for boundary in boundaries), common=region(boundaries)
    )


def qualifying_region(
    omega: ArrayLike,
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    period: float,
    *,
    discretization: str | None = None,
    hold: str = "average",
    damping: ArrayLike | None = None,
) -> QualifyingRegion:
    """Return every coupling that is stable and keeps Z_h_vc inside all boundaries at every ω given.

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
    discretization : {"backward", "tustin"}, optional
        Of the coupling; by default each equation's own: Eq. 6 for stability, Eq. 12 for Z_h_vc.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.
    damping : array_like, shape (m,), optional
        The lines of b_c, N·s/m; by default 161 of them up to the largest that is stable.

    Returns
    -------
    QualifyingRegion

    Raises
    ------
    UsageError
        No boundary, a boundary of another length than ω, ω not strictly between 0 and Nyquist or outside a
        device's table, a device with arrays as parameters, T not positive.
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
    check_single(device, Coupling(0.0, 0.0))
    judge = _Judge(grid, device, tuple(boundaries), discretization, hold)
    lines = judge.lines() if damping is None else nonnegative_array(damping, "damping", "N·s/m")
    lines = np.unique(lines)
    intervals = judge.intervals(lines)
    largest = _extreme(judge, lines, np.array([-part.max(initial=-np.inf) for part in intervals]), last=True)
    softest = _extreme(judge, lines, np.array([part.min(initial=np.inf) for part in intervals]), last=False)
    return QualifyingRegion(damping=lines, intervals=tuple(intervals), largest=largest, softest=softest)


@dataclass(frozen=True)
class _Judge:
    """The question put to each line of b_c."""

    grid: Warp
    device: AnyDevice
    boundaries: tuple[EnvironmentBoundary, ...]
    discretization: str | None
    hold: str

    def lines(self) -> FloatArray:
        """Return b_c from 0 to the largest that is stable at all."""
        omega = search_grid(self.device, self.grid.period)
        everywhere = warp(omega, self.grid.period)
        available, _ = device_parts(everywhere, self.device)
        viscous, _ = demands(everywhere, self.hold)
        largest = float(np.maximum(ratio(available, viscous, empty=np.inf), 0.0).min())
        return np.concatenate([largest * np.linspace(0, 1, 81), largest * np.geomspace(1e-4, 1, 81)])

    def intervals(self, lines: FloatArray) -> list[FloatArray]:
        """Return the qualifying k_c of each line, shape (m, 2)."""
        ceiling = self._stable_stiffness(lines)
        forbidden = np.concatenate([self._forbidden(boundary, lines) for boundary in self.boundaries], axis=1)
        return [_gaps(high, cuts) for high, cuts in zip(ceiling, forbidden, strict=True)]

    def _stable_stiffness(self, lines: FloatArray) -> FloatArray:
        discretization, period = self.discretization or "backward", self.grid.period
        if isinstance(self.device, Device) and not self.device.modes:
            return np.asarray(
                max_coupling_stiffness(
                    self.device.damping, lines, period, discretization=discretization, hold=self.hold
                )
            )

        def limit(omega: FloatArray) -> FloatArray:
            return np.asarray(
                max_coupling_stiffness_at(
                    omega, self.device, lines, period, discretization=discretization, hold=self.hold
                )
            )

        omega = search_grid(self.device, period)
        seen = limit(omega[:, None])
        least = seen.argmin(axis=0)
        low, high = omega[np.maximum(least - 1, 0)], omega[np.minimum(least + 1, omega.size - 1)]
        return np.minimum(seen.min(axis=0), limit(golden_section(limit, low, high)))

    def _forbidden(self, boundary: EnvironmentBoundary, lines: FloatArray) -> FloatArray:
        """Return the open intervals of k_c that leave a boundary, shape (lines, cuts, 2).

        With Z_c = b_c + k_c·ζ, Z_h_vc = (Z_dZ_e + Z_cZ_h)/(Z_e + Z_c): both are linear in k_c.
        """
        period, omega = self.grid.period, self.grid.omega
        z_e = environment_impedance(omega, boundary.environment, period)
        z_d = device_impedance(omega, self.device, period)
        z_h = z_d + zero_order_hold(omega, period, kind=self.hold) * z_e
        zeta = (period / 2 if self.discretization == "backward" else 0.0) - 1j * self.grid.inverse_rate
        b_c = lines[:, None]
        top0, top1 = z_d * z_e + b_c * z_h, zeta * z_h
        under0, under1 = z_e + b_c, zeta
        cuts = []
        for limit, side in ((boundary.upper, 1.0), (boundary.lower, -1.0)):
            bounded = np.isfinite(limit)
            u = np.where(bounded, limit, 0.0)
            # Products of sum and difference, where squares of near numbers would cancel.
            a = np.abs(zeta) ** 2 * (np.abs(z_h) - u) * (np.abs(z_h) + u)
            half_b = (top0 * np.conj(top1)).real - u**2 * (under0 * np.conj(under1)).real
            c = (np.abs(top0) - u * np.abs(under0)) * (np.abs(top0) + u * np.abs(under0))
            cut = _where_positive(side * np.broadcast_to(a, c.shape), side * half_b, side * c)
            cuts.append(np.where(bounded[:, None], cut, np.nan))
        return np.concatenate(cuts, axis=1).reshape(lines.size, -1, 2)


def _where_positive(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return where a·k² + 2·half_b·k + c > 0: two open intervals, NaN where absent; shape (..., 4)."""
    discriminant = half_b**2 - a * c
    real = discriminant > 0
    root = half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b)
    # Divisions by zero leave inf for the root that is not there, and NaN for none.
    one, other = ratio(-root, a, empty=np.nan), ratio(-c, root, empty=np.nan)
    low, high = np.fmin(one, other), np.fmax(one, other)
    nothing = np.full_like(low, np.nan)
    linear = a == 0
    single = -c / np.where(half_b == 0, 1.0, 2 * half_b)
    below, above = np.full_like(low, -np.inf), np.full_like(low, np.inf)
    outside = np.stack([below, low, high, above], axis=-1)
    inside = np.stack([low, high, nothing, nothing], axis=-1)
    everywhere = np.stack([below, above, nothing, nothing], axis=-1)
    nowhere = np.stack([nothing] * 4, axis=-1)
    rising = np.stack([single, above, nothing, nothing], axis=-1)
    falling = np.stack([below, single, nothing, nothing], axis=-1)

    def pick(condition: BoolArray, yes: FloatArray, no: FloatArray) -> FloatArray:
        return np.where(np.asarray(condition)[..., None], yes, no)

    curved = pick(a > 0, pick(real, outside, everywhere), pick(real, inside, nowhere))
    straight = pick(half_b > 0, rising, pick(half_b < 0, falling, pick(c > 0, everywhere, nowhere)))
    return pick(linear, straight, curved)


def _gaps(ceiling: float, forbidden: FloatArray) -> FloatArray:
    """Return what is left of [0, ceiling] without the forbidden intervals, shape (m, 2)."""
    if ceiling <= 0:
        return np.empty((0, 2))
    cuts = forbidden[~np.isnan(forbidden).any(axis=1)]
    cuts = cuts[np.argsort(cuts[:, 0])]
    starts = np.minimum(np.append(cuts[:, 0], np.inf), ceiling)
    ends = np.maximum.accumulate(np.concatenate([[0.0], cuts[:, 1]]))
    left = np.stack([ends, starts], axis=1)
    return left[left[:, 1] > left[:, 0]]


def _extreme(judge: _Judge, lines: FloatArray, cost: FloatArray, *, last: bool) -> Coupling | None:
    """Return the coupling at the largest or smallest k_c, looking between the lines beside the best one."""
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return None

    def between(damping: FloatArray) -> FloatArray:
        sets = judge.intervals(damping)
        return np.array([-part.max(initial=-np.inf) if last else part.min(initial=np.inf) for part in sets])

    low, high = lines[[max(best - 1, 0)]], lines[[min(best + 1, lines.size - 1)]]
    found = wide_section(lambda places: between(places[:, 0])[:, None], low, high)
    candidates = np.append(found, lines[best])
    damping = candidates[int(np.argmin(between(candidates)))]
    intervals = judge.intervals(np.array([damping]))[0]
    low_k, high_k = intervals[-1] if last else intervals[0]
    inset = min(_INSIDE * high_k, (high_k - low_k) / 2)
    # k_c = 0 and the origin of the interval need no inset: nothing is cut there.
    stiffness = high_k - inset if last else (low_k + inset if low_k else 0.0)
    return Coupling(float(stiffness), float(damping))
