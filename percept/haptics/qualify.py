"""Couplings that are stable and keep Z_h_vc inside a boundary: for one environment, and for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import (
    ComplexArray,
    FloatArray,
    complex_from,
    nonnegative_array,
    ratio,
)
from percept.haptics._gaps import Gaps, where_positive
from percept.haptics._search import golden_section, wide_section
from percept.haptics._warp import Warp, warp
from percept.haptics.design import max_coupling_stiffness, max_coupling_stiffness_at
from percept.haptics.frequencies import search_grid
from percept.haptics.impedance import device_impedance, device_parts, environment_impedance
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.parameters import AnyDevice, Coupling, Device, Environment, refuse_arrays
from percept.haptics.stability import demands
from percept.notebook import NotebookRecord

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
    judge = _judge(omega, device, boundaries, period, discretization, hold)
    seen = judge.seen(damping)
    return CouplingDesign(
        each=tuple(_region(judge.only(i), seen.only(i)) for i in range(len(boundaries))),
        common=_region(judge, seen),
        frequencies=judge.grid.omega.size,
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
        The lines of b_c, N·s/m; by default some 160 of them up to the largest that is stable.

    Returns
    -------
    QualifyingRegion

    Raises
    ------
    UsageError
        No boundary, a boundary of another length than ω, ω not strictly between 0 and Nyquist or outside a
        device's table, a device with arrays as parameters, T not positive, an unknown hold or discretization;
        a damping that is negative or no list.
    """
    judge = _judge(omega, device, boundaries, period, discretization, hold)
    return _region(judge, judge.seen(damping))


def _judge(
    omega: ArrayLike,
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    period: float,
    discretization: str | None,
    hold: str,
) -> _Judge:
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
    walls = tuple(_Walls.of(grid, device, boundary, discretization, hold) for boundary in boundaries)
    return _Judge(grid, device, walls, discretization, hold)


@dataclass(frozen=True, eq=False)
class _Walls:
    """What one boundary asks at each ω.

    With Z_c = b_c + k_c·ζ, Z_h_vc = (Z_dZ_e + Z_cZ_h)/(Z_e + Z_c): both are linear in k_c.
    """

    z_e: ComplexArray  # (n,)
    z_h: ComplexArray  # (n,)
    uncoupled: ComplexArray  # (n,)
    zeta: ComplexArray  # (n,)
    boundary: EnvironmentBoundary

    @classmethod
    def of(
        cls,
        grid: Warp,
        device: AnyDevice,
        boundary: EnvironmentBoundary,
        discretization: str | None,
        hold: str,
    ) -> _Walls:
        period, omega = grid.period, grid.omega
        z_e = environment_impedance(omega, boundary.environment, period)
        z_d = device_impedance(omega, device, period)
        z_h = z_d + zero_order_hold(omega, period, kind=hold) * z_e
        zeta = complex_from(period / 2 if discretization == "backward" else 0.0, -grid.inverse_rate)
        return cls(z_e, z_h, z_d * z_e, zeta, boundary)

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
class _Lines:
    """What is known of some lines of b_c: the stable k_c, and what each boundary forbids."""

    damping: FloatArray
    ceiling: FloatArray
    forbidden: tuple[FloatArray, ...]

    def only(self, boundary: int) -> _Lines:
        """Return the lines as one boundary alone leaves them."""
        return _Lines(self.damping, self.ceiling, (self.forbidden[boundary],))

    def gaps(self) -> Gaps:
        """Return what qualifies on each line."""
        return Gaps.of(self.ceiling, np.concatenate(self.forbidden, axis=1))


@dataclass(frozen=True, eq=False)
class _Judge:
    """The question put to each line of b_c."""

    grid: Warp
    device: AnyDevice
    walls: tuple[_Walls, ...]
    discretization: str | None
    hold: str

    def only(self, boundary: int) -> _Judge:
        """Ask for one boundary alone."""
        return replace(self, walls=(self.walls[boundary],))

    def seen(self, damping: ArrayLike | None) -> _Lines:
        """Look at the lines asked for, or at as many as show the whole region."""
        lines = self._usual() if damping is None else nonnegative_array(damping, "damping", "N·s/m")
        if lines.ndim != 1 or not lines.size:
            raise UsageError("damping must be a list of one value or more.", value=lines.shape)
        return self.at(np.unique(lines))

    def at(self, damping: FloatArray) -> _Lines:
        """Look at lines of b_c, shape (n,), N·s/m."""
        forbidden = tuple(wall.forbidden(damping) for wall in self.walls)
        return _Lines(damping, self._stable_stiffness(damping), forbidden)

    def _usual(self) -> FloatArray:
        """Return b_c from 0 to the largest that is stable at all."""
        omega = search_grid(self.device, self.grid.period)
        everywhere = warp(omega, self.grid.period)
        available, _ = device_parts(everywhere, self.device)
        viscous, _ = demands(everywhere, self.hold)
        largest = float(np.maximum(ratio(available, viscous, empty=np.inf), 0.0).min())
        return np.concatenate([largest * np.linspace(0, 1, 81), largest * np.geomspace(1e-4, 1, 81)])

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


def _region(judge: _Judge, seen: _Lines) -> QualifyingRegion:
    gaps = seen.gaps()
    largest, softest = _extremes(judge, seen.damping, gaps.costs())
    return QualifyingRegion(damping=seen.damping, intervals=gaps.lines(), largest=largest, softest=softest)


def _extremes(judge: _Judge, lines: FloatArray, costs: FloatArray) -> tuple[Coupling | None, Coupling | None]:
    """Return the couplings at the largest and the smallest k_c, also between the lines beside the best."""
    best = costs.argmin(axis=1)
    if not np.isfinite(costs.min()):
        return None, None

    def cost(damping: FloatArray) -> FloatArray:
        # Both searches in one call: the first column is the one for the largest k_c.
        found = judge.at(damping.ravel()).gaps().costs().reshape(2, *damping.shape)
        return np.stack([found[0, :, 0], found[1, :, 1]], axis=1)

    low, high = lines[np.maximum(best - 1, 0)], lines[np.minimum(best + 1, lines.size - 1)]
    candidates = np.stack([wide_section(cost, low, high), lines[best]])
    damping = candidates[cost(candidates).argmin(axis=0), [0, 1]]
    on_largest, on_softest = judge.at(damping).gaps().lines()
    low_k, high_k = on_largest[-1]
    largest = Coupling(float(high_k - _inset(low_k, high_k)), float(damping[0]))
    low_k, high_k = on_softest[0]
    # k_c = 0 needs no inset: nothing is cut there.
    softest = low_k + _inset(low_k, high_k) if low_k else 0.0
    return largest, Coupling(float(softest), float(damping[1]))


def _inset(low: float, high: float) -> float:
    return min(_INSIDE * high, (high - low) / 2)
