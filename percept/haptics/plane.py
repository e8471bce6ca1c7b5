"""The plane in which abs(Z_h) is the distance from one point, and boxes of (k, b) in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars, ratio, times
from percept.haptics.impedance import rotated_device
from percept.haptics.loop import Warp

__all__ = ["Boxes", "DistancePlane", "Extremes", "Point", "Range", "Term"]


class Point(NamedTuple):
    """Stiffness and damping, numbers or arrays of one shape; of either sign."""

    stiffness: Scalars  # N/m
    damping: Scalars  # N·s/m


class Term(NamedTuple):
    """A term of stiffness or damping, gain·value + offset, N·s/m."""

    gain: FloatArray
    offset: FloatArray


class Extremes(NamedTuple):
    """The (k, b) of a region with the smallest and the largest abs(Z_h)."""

    nearest: Point
    farthest: Point


class DistancePlane(NamedTuple):
    """The plane of (g·b, g·k/Ω), in which abs(Z_h) is the distance from one point.

    The device sets that point. With g the hold's gain, h = ωT/2 and a delay of d samples,
    abs(Z_h) = abs(Z_d·e^{j(1 + 2d)h} + g·b + j·g·(m·Ω − k/Ω)).
    """

    gain: FloatArray  # g
    per_rate: FloatArray  # g/Ω, s/rad
    real: FloatArray  # Real part of Z_d·e^{j(1 + 2d)h} + j·g·m·Ω, N·s/m
    imaginary: FloatArray  # Its imaginary part, N·s/m

    @classmethod
    def of(cls, grid: Warp, mass: ArrayLike = 0.0) -> DistancePlane:
        """Take the loop's device with the environment's mass, kg, at each ω."""
        held = grid.held()
        real, imaginary = rotated_device(grid)
        return cls(held.gain, held.per_rate, real, imaginary + times(mass, held.rate))

    def flat(self) -> DistancePlane:
        """Return all fields in one shape (n,)."""
        return DistancePlane(*(field.ravel() for field in np.broadcast_arrays(*self)))

    def select(self, which: IntArray | BoolArray | slice) -> DistancePlane:
        """Return some of the n elements of a flat plane, or of the last axis of another."""
        return DistancePlane(*(field[..., which] for field in self))

    def terms(self) -> tuple[Term, Term]:
        """Return the terms of stiffness and of damping, whose squares add up to abs(Z_h)²."""
        return Term(self.per_rate, -self.imaginary), Term(self.gain, self.real)

    def column(self) -> DistancePlane:
        """Return the n elements of a flat plane as a column, which points broadcast against."""
        return DistancePlane(*(field[:, None] for field in self))

    def offsets(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Return real and imaginary part of Z_h·e^{j(1 + 2d)h}, N·s/m."""
        k, b = point
        return self.gain * b + self.real, self.imaginary - times(k, self.per_rate)

    def distance(self, point: Point) -> FloatArray:
        """Return abs(Z_h), N·s/m."""
        return np.hypot(*self.offsets(point))

    def square(self, point: Point) -> FloatArray:
        """Return abs(Z_h)², of use where neither overflows nor vanishes."""
        real, imaginary = self.offsets(point)
        return np.asarray(real**2 + imaginary**2)

    def origin(self) -> Point:
        """Return the (k, b) at which Z_h vanishes; infinite where there is none."""
        k = ratio(self.imaginary, self.per_rate, empty=np.inf)
        return Point(k, ratio(-self.real, self.gain, empty=np.inf))


class Range(NamedTuple):
    """N limits of one quantity, shape (N,) each."""

    low: FloatArray
    high: FloatArray

    def farther_end(self, value: Scalars) -> FloatArray:
        """Return the limit that lies farther from a value."""
        above_middle = np.multiply(2, value) > self.low + self.high
        return np.where(above_middle, self.low, self.high)

    def widths_off(self, value: Scalars) -> FloatArray:
        """Return how far a value lies beyond the nearer limit, in widths (in units if zero)."""
        width = self.high - self.low
        width = np.where(width > 0, width, 1.0)
        return np.maximum(self.low - value, value - self.high) / width


@dataclass(frozen=True)
class Boxes:
    """N limits of stiffness and damping."""

    stiffness: Range  # N/m
    damping: Range  # N·s/m

    @classmethod
    def of(
        cls,
        stiffness: tuple[ArrayLike, ArrayLike],
        damping: tuple[ArrayLike, ArrayLike],
    ) -> Boxes:
        """Take pairs (low, high) of N limits."""
        limits = np.broadcast_arrays(*stiffness, *damping)
        k_low, k_high, b_low, b_high = np.array(limits, dtype=float)
        return cls(Range(k_low, k_high), Range(b_low, b_high))

    def extremes(self, plane: DistancePlane) -> Extremes:
        """Return the nearest and the farthest (k, b) of each box at its own ω."""
        k, b = plane.origin()
        return Extremes(
            nearest=Point(np.clip(k, *self.stiffness), np.clip(b, *self.damping)),
            farthest=Point(self.stiffness.farther_end(k), self.damping.farther_end(b)),
        )
