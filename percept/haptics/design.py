"""Couplings that are stable and keep what is displayed inside users' limits: for one environment, for all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import (
    BoolArray,
    FloatArray,
    complex_from,
    ratio,
)
from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.envelope import magnitude_envelope
from percept.haptics.forms import Display
from percept.haptics.impedance import device_impedance, device_parts, environment_impedance, warp
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.limits import stable_stiffness
from percept.haptics.records import AnyDevice, Coupling, Environment
from percept.haptics.search import Gaps, search_grid, section_minimum, where_positive
from percept.haptics.stability import demands
from percept.html import NotebookRecord

# An edge of the map is pulled inside by this fraction, a single coupling by less; then both are
# checked.
_OUTLINE, _INSIDE = 1e-3, 1e-4
# Beyond the edge by this fraction a coupling shows what binds.
_BEYOND = 2e-3
# Of an interval of k_c both ends and the middle are checked.
_FRACTIONS = np.array([0.0, 0.5, 1.0])
_START = 41
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class EnvironmentBoundary:
    """What a coupled environment has to stay inside of: limits between which users feel the environment."""

    environment: Environment
    stiffness: tuple[float, float]  # N/m
    damping: tuple[float, float]  # N·s/m


@dataclass(frozen=True)
class QualifyingCoupling(NotebookRecord):
    """A coupling that was checked at every ω of the range.

    Departures are the largest over the range and all boundaries, negative inside.
    """

    stiffness: float  # k_c, N/m
    damping: float  # b_c, N·s/m
    magnitude: float  # Departure of abs(Z_h_vc), the logarithm of a ratio
    magnitude_omega: float  # Where, rad/s
    plane: float  # Departure of effective stiffness and damping, in widths of their limits
    plane_omega: float
    binds: tuple[str, ...]  # What a coupling 0.2 % beyond breaks: "stability", "magnitude", "plane"


@dataclass(frozen=True, eq=False)
class QualifyingRegion(NotebookRecord):
    """Every (k_c, b_c) that is stable and inside, one line of b_c at a time."""

    damping: FloatArray = field(repr=False)  # (n,) b_c of each line, N·s/m
    intervals: tuple[FloatArray, ...] = field(repr=False)  # Per line (m, 2), low and high k_c, N/m
    largest: (
        QualifyingCoupling | None
    )  # By k_c, searched between the lines too; None where nothing qualifies
    softest: QualifyingCoupling | None


@dataclass(frozen=True, eq=False)
class CouplingDesign(NotebookRecord):
    """Couplings that qualify for each environment, in the order of the boundaries, and for all at once."""

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

    Inside is meant at every ω between two `frequencies`, rad/s, and in two ways. abs(Z_h_vc) lies
    between the smallest and the largest abs(Z_h) over the limits; effective stiffness and damping
    lie within them. At one ω and fixed b_c each limit is a quadratic inequality in k_c, and
    stability an upper limit. What these leave at a few ω is checked at all, and each ω that shows a
    coupling outside joins them. `damping` are the lines of b_c, N·s/m, by default some 160 of them
    up to the largest that is stable.
    """
    lines = (
        _usual_lines(device, period, hold)
        if damping is None
        else np.asarray(damping, dtype=np.float64)
    )
    walls = [_Wall(device, boundary, frequencies, period, hold) for boundary in boundaries]
    groups = [[wall] for wall in walls] + ([walls] if len(walls) > 1 else [])
    regions = [_Search(device, group, period, hold).region(np.unique(lines)) for group in groups]
    return CouplingDesign(each=tuple(regions[: len(walls)]), common=regions[-1])


def _usual_lines(device: AnyDevice, period: float, hold: str) -> FloatArray:
    """Return b_c from 0 to the largest that is stable at all."""
    everywhere = warp(search_grid(device, period), period)
    available, _ = device_parts(everywhere, device)
    viscous, _ = demands(everywhere, hold)
    largest = float(np.maximum(ratio(available, viscous, empty=np.inf), 0.0).min())
    return np.concatenate([largest * np.linspace(0, 1, 81), largest * np.geomspace(1e-4, 1, 81)])


@dataclass(frozen=True)
class _Search:
    """Cuts k_c away at the walls' ω until a check at all ω finds nothing outside."""

    device: AnyDevice
    walls: Sequence[_Wall]
    period: float
    hold: str

    def region(self, lines: FloatArray) -> QualifyingRegion:
        """Return what is left on lines of b_c, with the ends of all."""
        for _ in range(_ROUNDS):
            found = self._gaps(lines).inset(_OUTLINE)
            line, column = np.nonzero(found.kept)
            if not line.size:
                break
            low, high = found.low[line, column, None], found.high[line, column, None]
            k_c = low + _FRACTIONS * (high - low)
            good = self._passing(Coupling(k_c.ravel(), np.repeat(lines[line], _FRACTIONS.size)))
            found.kept[line, column] = good.reshape(k_c.shape).all(axis=1)
            if good.all():
                break
        return QualifyingRegion(lines, found.lines(), self._end(lines, 0), self._end(lines, 1))

    def _gaps(self, damping: FloatArray) -> Gaps:
        """Return the k_c that stability and the walls' ω leave on lines of b_c."""
        cuts = np.concatenate([wall.forbidden(damping) for wall in self.walls], axis=1)
        return Gaps.of(stable_stiffness(self.device, damping, self.period, self.hold), cuts)

    def _passing(self, couplings: Coupling) -> BoolArray:
        return np.logical_and.reduce([wall.passes(couplings) for wall in self.walls])

    def _end(self, lines: FloatArray, side: int) -> QualifyingCoupling | None:
        """Return the coupling with the largest k_c, or on side 1 the smallest, that passes."""
        for _ in range(_ROUNDS):
            best = self._extreme(lines, side)
            if best is None:
                return None
            if self._passing(best)[0]:
                return self._described(best, side)
        return None

    def _extreme(self, lines: FloatArray, side: int) -> Coupling | None:
        """Return the coupling at an end of what the walls' ω leave, searched between the lines too."""

        def cost(damping: FloatArray) -> FloatArray:
            return self._gaps(damping.ravel()).costs()[side].reshape(damping.shape)

        costs = cost(lines)
        best = int(costs.argmin())
        if not np.isfinite(costs[best]):
            return None
        low, high = lines[[max(best - 1, 0)]], lines[[min(best + 1, lines.size - 1)]]
        # Of equals the line counts: at the end of the range a section stops a hair's breadth short
        # of it.
        candidates = np.stack([lines[[best]], section_minimum(cost, low, high)])
        damping = candidates[int(cost(candidates).argmin())]
        low_k, high_k = self._gaps(damping).inset(_INSIDE).lines()[0][-1 if side == 0 else 0]
        return Coupling(np.array([low_k if side else high_k]), damping)

    def _described(self, best: Coupling, side: int) -> QualifyingCoupling:
        """Say how deep inside a coupling is, and what binds it."""
        here, damping = np.asarray(best.stiffness), np.asarray(best.damping)
        stiffness = here * np.array([1.0, 1.0 - _BEYOND if side else 1.0 + _BEYOND])
        both = [wall.departures(Coupling(stiffness, np.repeat(damping, 2))) for wall in self.walls]
        stable = stable_stiffness(self.device, damping, self.period, self.hold)
        binds = ["stability"] if stiffness[1] > stable[0] else []
        worst = [
            max((float(one[way][0][0]), float(one[way][1][0])) for one in both) for way in (0, 1)
        ]
        for way, name in enumerate(("magnitude", "plane")):
            binds += [name] * any(one[way][0][1] > ON_LIMIT for one in both)
        return QualifyingCoupling(
            float(here[0]), float(damping[0]), *worst[0], *worst[1], tuple(binds)
        )


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
        self._display = Display(device, boundary.environment, period, None, hold)
        self._limits, self._ends = (boundary.stiffness, boundary.damping), frequencies
        # Without a mass effective stiffness and damping are monotone in ω: both ends tell all.
        self._omega = [np.geomspace(*frequencies, _START), np.array(frequencies)]

    def departures(
        self, couplings: Coupling, *, throughout: bool = False
    ) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Return the largest departure and its ω, of couplings (n,): of abs(Z_h_vc), of k and b."""
        size = np.size(couplings.stiffness)
        k, b = ((np.full(size, low), np.full(size, high)) for low, high in self._limits)
        display, boxes = replace(self._display, coupling=couplings), Boxes(k, b)
        magnitude = departures(display, boxes, *self._ends, throughout=throughout)
        return (magnitude.largest, magnitude.omega), plane_departures(display, boxes, *self._ends)

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
        shown, own = self._display, self._display.environment
        period, omega = shown.period, self._omega[0]
        lower, upper = magnitude_envelope(
            omega, shown.device, *self._limits, period, mass=own.mass, hold=shown.hold
        )
        z_e, z_d = (
            environment_impedance(omega, own, period),
            device_impedance(omega, shown.device, period),
        )
        z_h = z_d + zero_order_hold(omega, period, kind=shown.hold) * z_e
        zeta = complex_from(0.0, -warp(omega, period).inverse_rate)
        top0, top1 = z_d * z_e + b_c * z_h, zeta * z_h
        over, under = np.abs(top0), np.abs(z_e + b_c)
        along, across = (top0 * np.conj(top1)).real, ((z_e + b_c) * np.conj(zeta)).real
        for u, side in ((upper, 1.0), (lower, -1.0)):
            # Products of sum and difference, where squares of near numbers would cancel.
            a = np.abs(zeta) ** 2 * (np.abs(z_h) - u) * (np.abs(z_h) + u)
            c = (over - u * under) * (over + u * under)
            yield where_positive(
                side * np.broadcast_to(a, c.shape), side * (along - u**2 * across), side * c
            )

    def _by_plane(self, b_c: FloatArray) -> Iterator[FloatArray]:
        own, period = self._display.environment, self._display.period
        grid = warp(self._omega[1], period)
        z_e = environment_impedance(grid.omega, own, period)
        compliance = grid.inverse_rate**2
        size, under, across = (
            np.abs(z_e) ** 2,
            np.abs(z_e + b_c) ** 2,
            -z_e.imag * grid.inverse_rate,
        )
        spring = -z_e.imag / grid.inverse_rate
        for values, pull, high_low in (
            ((own.damping, 0.0, size * b_c + own.damping * b_c**2), 0.0, self._limits[1]),
            ((spring, size / 2, spring * b_c**2), own.mass / compliance, self._limits[0]),
        ):
            a, half_b, c = values
            for side, end in zip((-1.0, 1.0), high_low, strict=True):
                # The limit of stiffness is meant with the environment's mass apart.
                limit = end - pull
                quadratic = (a - limit) * compliance, half_b - limit * across, c - limit * under
                yield where_positive(
                    *(side * np.broadcast_to(part, under.shape) for part in quadratic)
                )


def _apart(omega: FloatArray) -> FloatArray:
    """Thin frequencies to one in each thousandth."""
    _, first = np.unique(np.round(np.log(omega) * 1e3), return_index=True)
    return omega[first]
