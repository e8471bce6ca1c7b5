"""Couplings that are stable and keep displayed environments inside users' limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import BoolArray, FloatArray, complex_from
from percept.haptics.axis import warp
from percept.haptics.containment import (
    ON_LIMIT,
    Boxes,
    departures,
    plane_departures,
)
from percept.haptics.envelope import magnitude_envelope
from percept.haptics.impedance import device_impedance, environment_impedance
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.limits import largest_coupling_damping, stable_stiffness
from percept.haptics.loop import AnyHold
from percept.haptics.records import AnyDevice, Coupling, Display, Environment
from percept.haptics.search import Intervals, section_minimum, where_positive
from percept.html import NotebookRecord

__all__ = [
    "CouplingDesign",
    "EnvironmentBoundary",
    "QualifyingRegion",
    "design_couplings",
]

# An edge of the map is pulled inside by this fraction of k_c, and then checked.
_OUTLINE = 1e-3
# A single coupling is pulled inside by less, and then checked.
_INSIDE = 1e-4
# Of an interval of k_c both ends and the middle are checked.
_FRACTIONS = np.array([0.0, 0.5, 1.0])
# Below a lower limit a difference from it is negative, beyond an upper limit positive.
_SIDES = (-1.0, 1.0)
# Frequencies at which abs(Z_h_vc) is asked for at first.
_START = 41
# Checks that cut k_c away before a search gives up.
_ROUNDS = 20
# Lines of b_c, evenly spaced and as many evenly in the logarithm.
_LINES = 81


@dataclass(frozen=True, eq=False)
class EnvironmentBoundary:
    """An environment, and the limits it has to stay inside of when it is coupled."""

    environment: Environment
    stiffness: tuple[float, float]  # Lower and upper limit of k, N/m
    damping: tuple[float, float]  # Of b, N·s/m


@dataclass(frozen=True, eq=False)
class QualifyingRegion(NotebookRecord):
    """Every (k_c, b_c) that is stable and inside, one line of b_c at a time."""

    damping: FloatArray = field(repr=False)  # (n,) b_c of each line, N·s/m
    intervals: tuple[FloatArray, ...] = field(repr=False)  # Per line (m, 2), low and high k_c, N/m
    # By k_c, searched between the lines too; None where nothing qualifies.
    largest: Coupling | None
    softest: Coupling | None


@dataclass(frozen=True, eq=False)
class CouplingDesign(NotebookRecord):
    """Couplings that qualify for each environment, and for all of them."""

    each: tuple[QualifyingRegion, ...]  # In the order of the boundaries
    common: QualifyingRegion


def design_couplings(
    device: AnyDevice,
    boundaries: Sequence[EnvironmentBoundary],
    frequencies: tuple[float, float],
    period: float,
    *,
    hold: AnyHold = "average",
    damping: ArrayLike | None = None,
) -> CouplingDesign:
    """Return the couplings that are stable (Eq. 6) and keep environments inside (Eq. 12).

    Inside is meant at every ω of a range, and in two ways. abs(Z_h_vc) lies between the smallest
    and the largest abs(Z_h) over the limits; effective stiffness and damping lie within them.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Known from DC to Nyquist.
    boundaries : sequence of EnvironmentBoundary
        Environments and the limits they have to stay inside of; one or more.
    frequencies : pair of float
        Ends of the range of ω, rad/s.
    period : float
        Sampling period T, s.
    hold : {"average", "true"} or Hold
        Eq. 8, or the true zero-order hold; with a delay, a `Hold`.
    damping : array_like, optional
        Lines of b_c, N·s/m; by default some 160 of them up to the largest that is stable.

    Returns
    -------
    CouplingDesign
        A region for each boundary, in their order, and one for all.

    Raises
    ------
    UsageError
        The range passes Nyquist or leaves the device's table; T not positive; an unknown hold.

    Notes
    -----
    At one ω and fixed b_c each limit is a quadratic inequality in k_c, and stability an upper
    limit. What these leave at a few ω is checked at all, and each ω that shows a coupling outside
    joins them.
    """
    lines = _usual_lines(device, period, hold)
    if damping is not None:
        lines = np.asarray(damping, dtype=np.float64)
    lines = np.unique(lines)
    walls = [_Wall(device, boundary, frequencies, period, hold) for boundary in boundaries]
    each = tuple(_CouplingSearch(device, [wall], period, hold).region(lines) for wall in walls)
    common = each[0]
    if len(walls) > 1:
        common = _CouplingSearch(device, walls, period, hold).region(lines)
    return CouplingDesign(each, common)


def _usual_lines(device: AnyDevice, period: float, hold: AnyHold) -> FloatArray:
    """Return b_c from 0 to the largest that is stable at all."""
    even = np.linspace(0, 1, _LINES)
    by_logarithm = np.geomspace(1e-4, 1, _LINES)
    largest = largest_coupling_damping(device, period, hold)
    return largest * np.concatenate([even, by_logarithm])


@dataclass(frozen=True)
class _CouplingSearch:
    """Cuts k_c away at the walls' ω until a check at all ω finds nothing outside."""

    device: AnyDevice
    walls: Sequence[_Wall]
    period: float
    hold: AnyHold

    def region(self, lines: FloatArray) -> QualifyingRegion:
        """Return what is left on lines of b_c, with the ends of all."""
        for _ in range(_ROUNDS):
            intervals = self._intervals(lines).inset(_OUTLINE)
            line, column = np.nonzero(intervals.kept)
            if not line.size:
                break
            low = intervals.low[line, column, None]
            high = intervals.high[line, column, None]
            k_c = low + _FRACTIONS * (high - low)
            b_c = np.repeat(lines[line], _FRACTIONS.size)
            passing = self._passing(Coupling(k_c.ravel(), b_c))
            passing = passing.reshape(k_c.shape)
            intervals.kept[line, column] = passing.all(axis=1)
            if passing.all():
                break
        largest = self._end(lines, softest=False)
        softest = self._end(lines, softest=True)
        return QualifyingRegion(lines, intervals.lines(), largest, softest)

    def _intervals(self, damping: FloatArray) -> Intervals:
        """Return the k_c that stability and the walls' ω leave on lines of b_c."""
        forbidden = [wall.forbidden(damping) for wall in self.walls]
        ceiling = stable_stiffness(self.device, damping, self.period, self.hold)
        return Intervals.left_by(ceiling, np.concatenate(forbidden, axis=1))

    def _passing(self, couplings: Coupling) -> BoolArray:
        return np.logical_and.reduce([wall.passes(couplings) for wall in self.walls])

    def _end(self, lines: FloatArray, *, softest: bool) -> Coupling | None:
        """Return the coupling with the largest k_c, or the softest, that passes."""
        for _ in range(_ROUNDS):
            best = self._extreme(lines, softest=softest)
            if best is None:
                return None
            if self._passing(best)[0]:
                stiffness = np.asarray(best.stiffness).item()
                return Coupling(stiffness, np.asarray(best.damping).item())
        return None

    def _extreme(self, lines: FloatArray, *, softest: bool) -> Coupling | None:
        """Return the coupling at an end of what the walls' ω leave, also between the lines."""

        def cost(damping: FloatArray) -> FloatArray:
            intervals = self._intervals(damping.ravel())
            costs = intervals.smallest() if softest else -intervals.largest()
            return costs.reshape(damping.shape)

        costs = cost(lines)
        best = int(costs.argmin())
        if not np.isfinite(costs[best]):
            return None
        low = lines[[max(best - 1, 0)]]
        high = lines[[min(best + 1, lines.size - 1)]]
        between = section_minimum(cost, low, high)
        # Of equals the line counts: a section stops a hair's breadth short of the range's end.
        candidates = np.stack([lines[[best]], between])
        damping = candidates[int(cost(candidates).argmin())]
        intervals = self._intervals(damping).inset(_INSIDE)
        return Coupling(intervals.smallest() if softest else intervals.largest(), damping)


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
        hold: AnyHold,
    ) -> None:
        self._display = Display(device, boundary.environment, period, None, hold)
        self._boundary = boundary
        self._frequencies = frequencies
        # The ω at which quadratics cut k_c: more join with each coupling found outside.
        self._magnitude_omega = np.geomspace(*frequencies, _START)
        # Without a mass effective stiffness and damping are monotone in ω: both ends tell all.
        self._plane_omega = np.array(frequencies)

    def passes(self, couplings: Coupling) -> BoolArray:
        """Say which couplings stay inside at all ω; where others leave is cut from now on."""
        limits = self._boundary.stiffness, self._boundary.damping
        boxes = Boxes.of(*limits, count=np.size(couplings.stiffness))
        display = replace(self._display, coupling=couplings)
        magnitude = departures(display, boxes, *self._frequencies, throughout=True)
        plane = plane_departures(display, boxes, *self._frequencies)
        leaves_magnitude = magnitude.largest > ON_LIMIT
        leaves_plane = plane.largest > 0.0
        omega = _thinned(magnitude.omega[leaves_magnitude])
        self._magnitude_omega = np.union1d(self._magnitude_omega, omega)
        omega = _thinned(plane.omega[leaves_plane])
        self._plane_omega = np.union1d(self._plane_omega, omega)
        return ~(leaves_magnitude | leaves_plane)

    def forbidden(self, lines: FloatArray) -> FloatArray:
        """Return the open intervals of k_c that leave the boundary, shape (lines, cuts, 2)."""
        b_c = lines[:, None]
        cuts = [*self._by_magnitude(b_c), *self._by_plane(b_c)]
        flat = [cut.reshape(lines.size, -1, 2) for cut in cuts]
        return np.concatenate(flat, axis=1)

    def _by_magnitude(self, b_c: FloatArray) -> Iterator[FloatArray]:
        """Yield where abs(Z_h_vc) passes the upper or lower limit of abs(Z_h), per line and ω."""
        device = self._display.device
        environment = self._display.environment
        period = self._display.period
        hold = self._display.hold
        omega = self._magnitude_omega
        limits = self._boundary.stiffness, self._boundary.damping
        envelope = magnitude_envelope(
            omega, device, *limits, period, mass=environment.mass, hold=hold
        )
        z_e = environment_impedance(omega, environment, period)
        z_d = device_impedance(omega, device, period)
        z_h = z_d + zero_order_hold(omega, period, kind=hold) * z_e
        zeta = complex_from(0.0, -warp(omega, period).inverse_rate)
        # Z_h_vc is (top + k_c·ζ·Z_h)/(bottom + k_c·ζ).
        top = z_d * z_e + b_c * z_h
        bottom = z_e + b_c
        size = np.abs(z_h)
        top_size = np.abs(top)
        bottom_size = np.abs(bottom)
        top_slope = (top * np.conj(zeta * z_h)).real
        bottom_slope = (bottom * np.conj(zeta)).real
        for limit, side in zip(envelope, _SIDES, strict=True):
            # Products of sum and difference, where squares of near numbers would cancel.
            bottom_limit = limit * bottom_size
            a = np.abs(zeta) ** 2 * (size - limit) * (size + limit)
            half_b = top_slope - limit**2 * bottom_slope
            c = (top_size - bottom_limit) * (top_size + bottom_limit)
            yield where_positive(*np.broadcast_arrays(side * a, side * half_b, side * c))

    def _by_plane(self, b_c: FloatArray) -> Iterator[FloatArray]:
        """Yield where effective stiffness or damping passes either of its limits, per line and ω.

        Both are quadratics in k_c over abs(Z_e + Z_c)².
        """
        environment = self._display.environment
        grid = warp(self._plane_omega, self._display.period)
        z_e = environment_impedance(grid.omega, environment, grid.period)
        # Coefficients of abs(Z_e + Z_c)² go with k_c², 2k_c and 1.
        square = grid.inverse_rate**2
        linear = -z_e.imag * grid.inverse_rate
        constant = np.abs(z_e + b_c) ** 2
        size = np.abs(z_e) ** 2
        damping = environment.damping
        for b, side in zip(self._boundary.damping, _SIDES, strict=True):
            a = (damping - b) * square
            half_b = -b * linear
            c = size * b_c + damping * b_c**2 - b * constant
            yield where_positive(*np.broadcast_arrays(side * a, side * half_b, side * c))
        spring = -z_e.imag / grid.inverse_rate
        # The limits of stiffness are meant with the environment's mass apart.
        inertia = environment.mass / square
        for limit, side in zip(self._boundary.stiffness, _SIDES, strict=True):
            k = limit - inertia
            a = (spring - k) * square
            half_b = size / 2 - k * linear
            c = spring * b_c**2 - k * constant
            yield where_positive(*np.broadcast_arrays(side * a, side * half_b, side * c))


def _thinned(omega: FloatArray) -> FloatArray:
    """Thin frequencies to one in each thousandth."""
    thousandths = np.round(np.log(omega) * 1e3)
    _, first = np.unique(thousandths, return_index=True)
    return omega[first]
