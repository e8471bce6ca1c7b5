"""Couplings that are stable and keep what is displayed inside users' limits: for one environment, for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    BoolArray,
    FloatArray,
    complex_from,
    nonnegative_array,
    ordered_limits,
    ratio,
)
from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.envelope import magnitude_envelope
from percept.haptics.forms import Display
from percept.haptics.impedance import device_impedance, device_parts, environment_impedance, warp
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.limits import stable_stiffness
from percept.haptics.records import AnyDevice, Coupling, Environment, refuse_arrays
from percept.haptics.search import Gaps, search_grid, section_minimum, where_positive
from percept.haptics.stability import demands
from percept.html import NotebookRecord

# An edge of the map is pulled inside by this fraction, a single coupling by less; then both are checked.
_OUTLINE, _INSIDE = 1e-3, 1e-4
# Beyond the edge by this fraction a coupling shows what binds.
_BEYOND = 2e-3
# Of an interval of k_c both ends and the middle are checked.
_FRACTIONS = np.array([0.0, 0.5, 1.0])
_START = 41
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class EnvironmentBoundary:
    """What a coupled environment has to stay inside of: limits of k and b.

    Parameters
    ----------
    environment : Environment
        Z_e, one environment.
    stiffness, damping : pair of float
        (low, high) of k, N/m, and b, N·s/m, between which users feel the environment.

    Raises
    ------
    UsageError
        A lower limit above its upper one, arrays as limits or environment, a value that is not finite.
    """

    environment: Environment
    stiffness: tuple[float, float]
    damping: tuple[float, float]

    def __post_init__(self) -> None:
        for name, unit in (("stiffness", "N/m"), ("damping", "N·s/m")):
            low, high = ordered_limits(getattr(self, name), name, unit)
            if low.ndim or high.ndim:
                raise UsageError("an EnvironmentBoundary has two limits of k and two of b.", value=name)
            object.__setattr__(self, name, (float(low), float(high)))
        parts = (self.environment.stiffness, self.environment.damping, self.environment.mass)
        if any(np.ndim(part) for part in parts):
            raise UsageError(
                "an EnvironmentBoundary is for one environment, without arrays.", value=self.environment
            )


@dataclass(frozen=True)
class QualifyingCoupling(NotebookRecord):
    """A coupling that was checked at every ω of the range.

    Attributes
    ----------
    stiffness, damping : float
        k_c, N/m, and b_c, N·s/m.
    magnitude, plane : float
        Largest departure over the range and all boundaries, negative inside: of abs(Z_h_vc) as the logarithm
        of a ratio, of effective stiffness and damping in widths of their limits.
    magnitude_omega, plane_omega : float
        Where these are, rad/s.
    binds : tuple of str
        What a coupling 0.2 % beyond breaks: "stability", "magnitude", "plane".
    """

    stiffness: float
    damping: float
    magnitude: float
    magnitude_omega: float
    plane: float
    plane_omega: float
    binds: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class QualifyingRegion(NotebookRecord):
    """Every (k_c, b_c) that is stable and inside, one line of b_c at a time.

    Attributes
    ----------
    damping : ndarray, shape (n,)
        b_c of each line, N·s/m.
    intervals : tuple of ndarray, each of shape (m, 2)
        The k_c that qualify on each line, (low, high) in N/m, to 0.1 %.
    largest, softest : QualifyingCoupling or None
        The qualifying coupling with the largest and with the smallest k_c, searched between the lines too;
        None where nothing qualifies.
    """

    damping: FloatArray = field(repr=False)
    intervals: tuple[FloatArray, ...] = field(repr=False)
    largest: QualifyingCoupling | None
    softest: QualifyingCoupling | None


@dataclass(frozen=True, eq=False)
class CouplingDesign(NotebookRecord):
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
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    frequencies: tuple[float, float],
    period: float,
    *,
    hold: str = "average",
    damping: ArrayLike | None = None,
) -> CouplingDesign:
    """Return the couplings that are stable (Eq. 6) and keep each environment, and all, inside (Eq. 12).

    Inside is meant at every ω of a range and in two ways. abs(Z_h_vc) lies between the smallest and the
    largest abs(Z_h) over the limits; effective stiffness and damping lie within them. At one ω and fixed b_c
    each limit is a quadratic inequality in k_c, and stability an upper limit. What these leave at a few ω is
    checked at all, and each ω that shows a coupling outside joins them.

    Parameters
    ----------
    device : Device or TabulatedDevice
        The device, Z_d.
    boundaries : sequence of EnvironmentBoundary
        At least one.
    frequencies : pair of float
        The range of ω, rad/s; above 0 and below π/T.
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
        No boundary, a range that is not strictly between 0 and Nyquist or outside a device's table, a device
        with arrays as parameters, T not positive, an unknown hold; a damping that is negative or no list.
    """
    walls, lines = _checked(device, boundaries, frequencies, period, hold, damping)
    each = tuple(_region(device, [wall], lines, period, hold) for wall in walls)
    common = each[0] if len(each) == 1 else _region(device, walls, lines, period, hold)
    return CouplingDesign(each=each, common=common)


def _checked(
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    frequencies: tuple[float, float],
    period: float,
    hold: str,
    damping: ArrayLike | None,
) -> tuple[list[_Wall], FloatArray]:
    """Return what each boundary asks for, and the lines of b_c."""
    if not boundaries:
        raise UsageError("a coupling needs at least one boundary to stay inside of.")
    lower, upper = frequencies
    if not 0 < lower < upper < np.pi / period * (1 - 1e-9):
        raise UsageError("frequencies must increase, strictly between 0 and Nyquist.", value=frequencies)
    refuse_arrays(device, Coupling(0.0, 0.0))
    b_c = (
        _usual_lines(device, period, hold)
        if damping is None
        else nonnegative_array(damping, "damping", "N·s/m")
    )
    if b_c.ndim != 1 or not b_c.size:
        raise UsageError("damping must be a list of one value or more.", value=b_c.shape)
    walls = [_Wall(device, boundary, (lower, upper), period, hold) for boundary in boundaries]
    return walls, np.unique(b_c)


def _usual_lines(device: AnyDevice, period: float, hold: str) -> FloatArray:
    """Return b_c from 0 to the largest that is stable at all."""
    everywhere = warp(search_grid(device, period), period)
    available, _ = device_parts(everywhere, device)
    viscous, _ = demands(everywhere, hold)
    largest = float(np.maximum(ratio(available, viscous, empty=np.inf), 0.0).min())
    return np.concatenate([largest * np.linspace(0, 1, 81), largest * np.geomspace(1e-4, 1, 81)])


def _region(
    device: AnyDevice, walls: Sequence[_Wall], lines: FloatArray, period: float, hold: str
) -> QualifyingRegion:
    """Cut away at the walls' ω until a check at all ω finds nothing outside."""
    for _ in range(_ROUNDS):
        found = _gaps(device, walls, lines, period, hold).inset(_OUTLINE)
        line, column = np.nonzero(found.kept)
        if not line.size:
            break
        low, high = found.low[line, column, None], found.high[line, column, None]
        k_c = low + _FRACTIONS * (high - low)
        good = _passing(walls, Coupling(k_c.ravel(), np.repeat(lines[line], _FRACTIONS.size)))
        found.kept[line, column] = good.reshape(k_c.shape).all(axis=1)
        if good.all():
            break
    largest, softest = (_end(device, walls, lines, side, period, hold) for side in (0, 1))
    return QualifyingRegion(lines, found.lines(), largest, softest)


def _gaps(device: AnyDevice, walls: Sequence[_Wall], damping: FloatArray, period: float, hold: str) -> Gaps:
    """Return the k_c that stability and the walls' ω leave on lines of b_c."""
    cuts = np.concatenate([wall.forbidden(damping) for wall in walls], axis=1)
    return Gaps.of(stable_stiffness(device, damping, period, hold), cuts)


def _passing(walls: Sequence[_Wall], couplings: Coupling) -> BoolArray:
    return np.logical_and.reduce([wall.passes(couplings) for wall in walls])


def _end(
    device: AnyDevice, walls: Sequence[_Wall], lines: FloatArray, side: int, period: float, hold: str
) -> QualifyingCoupling | None:
    """Return the coupling with the largest k_c, or on side 1 the smallest, that passes; None without any."""

    def gaps(damping: FloatArray) -> Gaps:
        return _gaps(device, walls, damping, period, hold)

    for _ in range(_ROUNDS):
        best = _extreme(gaps, lines, side)
        if best is None:
            return None
        if _passing(walls, best)[0]:
            return _described(device, walls, best, side, period, hold)
    return None


def _described(
    device: AnyDevice, walls: Sequence[_Wall], best: Coupling, side: int, period: float, hold: str
) -> QualifyingCoupling:
    """Say how deep inside a coupling is, and what binds it."""
    here, damping = np.asarray(best.stiffness), np.asarray(best.damping)
    stiffness = here * np.array([1.0, 1.0 - _BEYOND if side else 1.0 + _BEYOND])
    both = [wall.departures(Coupling(stiffness, np.repeat(damping, 2))) for wall in walls]
    binds = ["stability"] if stiffness[1] > stable_stiffness(device, damping, period, hold) else []
    worst = [max((float(one[way][0][0]), float(one[way][1][0])) for one in both) for way in (0, 1)]
    for way, name in enumerate(("magnitude", "plane")):
        binds += [name] * any(one[way][0][1] > ON_LIMIT for one in both)
    return QualifyingCoupling(float(here[0]), float(damping[0]), *worst[0], *worst[1], tuple(binds))


class _Wall:
    """What one boundary asks of couplings: at some ω by quadratics in k_c, at all ω by a check.

    With Z_c = b_c + k_c·ζ, Z_h_vc = (Z_dZ_e + Z_cZ_h)/(Z_e + Z_c): both are linear in k_c.
    """

    def __init__(
        self,
        device: AnyDevice,
        boundary: EnvironmentBoundary,
        frequencies: tuple[float, float],
        period: float,
        hold: str,
    ) -> None:
        self._device, self._boundary, self._ends = device, boundary, frequencies
        self._period, self._hold = period, hold
        # Without a mass effective stiffness and damping are monotone in ω: both ends tell all.
        self._omega = [np.geomspace(*frequencies, _START), np.array(frequencies)]

    def departures(
        self, couplings: Coupling, *, throughout: bool = False
    ) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Return the largest departure and its ω, of couplings (n,): of abs(Z_h_vc), of k and b."""
        limits = self._boundary.stiffness, self._boundary.damping
        size = np.size(couplings.stiffness)
        k, b = ((np.full(size, low), np.full(size, high)) for low, high in limits)
        display = Display(self._device, self._boundary.environment, self._period, couplings, self._hold)
        magnitude = departures(display, Boxes(k, b), *self._ends, throughout=throughout)
        return (magnitude.largest, magnitude.omega), plane_departures(display, limits, *self._ends)

    def passes(self, couplings: Coupling) -> BoolArray:
        """Say which couplings stay inside at all ω; where others leave is cut from now on."""
        good: BoolArray = np.ones(np.size(couplings.stiffness), dtype=np.bool_)
        for way, (largest, omega) in enumerate(self.departures(couplings, throughout=True)):
            outside = largest > (0.0 if way else ON_LIMIT)
            good &= ~outside
            self._omega[way] = np.union1d(self._omega[way], _apart(omega[outside]))
        return good

    def forbidden(self, lines: FloatArray) -> FloatArray:
        """Return the open intervals of k_c that leave the boundary, shape (lines, cuts, 2)."""
        cuts = [*self._by_magnitude(lines[:, None]), *self._by_plane(lines[:, None])]
        return np.concatenate(cuts, axis=1).reshape(lines.size, -1, 2)

    def _by_magnitude(self, b_c: FloatArray) -> Iterator[FloatArray]:
        grid, own = warp(self._omega[0], self._period), self._boundary.environment
        limits = self._boundary.stiffness, self._boundary.damping
        lower, upper = magnitude_envelope(
            grid.omega, self._device, *limits, self._period, mass=own.mass, hold=self._hold
        )
        z_e = environment_impedance(grid.omega, own, self._period)
        z_d = device_impedance(grid.omega, self._device, self._period)
        z_h = z_d + zero_order_hold(grid.omega, self._period, kind=self._hold) * z_e
        zeta = complex_from(0.0, -grid.inverse_rate)
        top0, top1 = z_d * z_e + b_c * z_h, zeta * z_h
        over, under = np.abs(top0), np.abs(z_e + b_c)
        along, across = (top0 * np.conj(top1)).real, ((z_e + b_c) * np.conj(zeta)).real
        for u, side in ((upper, 1.0), (lower, -1.0)):
            # Products of sum and difference, where squares of near numbers would cancel.
            a = np.abs(zeta) ** 2 * (np.abs(z_h) - u) * (np.abs(z_h) + u)
            c = (over - u * under) * (over + u * under)
            yield where_positive(side * np.broadcast_to(a, c.shape), side * (along - u**2 * across), side * c)

    def _by_plane(self, b_c: FloatArray) -> Iterator[FloatArray]:
        grid, own = warp(self._omega[1], self._period), self._boundary.environment
        z_e = environment_impedance(grid.omega, own, self._period)
        compliance = grid.inverse_rate**2
        size, under, across = np.abs(z_e) ** 2, np.abs(z_e + b_c) ** 2, -z_e.imag * grid.inverse_rate
        spring = -z_e.imag / grid.inverse_rate
        for values, pull, high_low in (
            ((own.damping, 0.0, size * b_c + own.damping * b_c**2), 0.0, self._boundary.damping),
            ((spring, size / 2, spring * b_c**2), own.mass / compliance, self._boundary.stiffness),
        ):
            a, half_b, c = values
            for side, end in zip((-1.0, 1.0), high_low, strict=True):
                # The limit of stiffness is meant with the environment's mass apart.
                limit = end - pull
                quadratic = (a - limit) * compliance, half_b - limit * across, c - limit * under
                yield where_positive(*(side * np.broadcast_to(part, under.shape) for part in quadratic))


def _apart(omega: FloatArray) -> FloatArray:
    """Thin frequencies to one in each thousandth."""
    _, first = np.unique(np.round(np.log(omega) * 1e3), return_index=True)
    return omega[first]


def _extreme(gaps: Callable[[FloatArray], Gaps], lines: FloatArray, side: int) -> Coupling | None:
    """Return the coupling at the largest k_c, or on side 1 the smallest, searched between the lines too."""

    def cost(damping: FloatArray) -> FloatArray:
        return gaps(damping.ravel()).costs()[side].reshape(damping.shape)

    costs = cost(lines)
    best = int(costs.argmin())
    if not np.isfinite(costs[best]):
        return None
    low, high = lines[[max(best - 1, 0)]], lines[[min(best + 1, lines.size - 1)]]
    # Of equals the line counts: at the end of the range a section stops a hair's breadth short of it.
    candidates = np.stack([lines[[best]], section_minimum(cost, low, high)])
    damping = candidates[int(cost(candidates).argmin())]
    low_k, high_k = gaps(damping).lines()[0][-1 if side == 0 else 0]
    half = (high_k - low_k) / 2
    k_c = low_k + min(half, _INSIDE * low_k) if side else high_k - min(half, _INSIDE * high_k)
    return Coupling(np.array([k_c]), damping)
