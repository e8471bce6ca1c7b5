"""Z_h on pieces of a range of ω as polynomials, by Bernstein coefficients that bound them from below.

A polynomial of degree n on a piece is a form Σ cᵢ(1 − t)^(n−i)tⁱ, an array (n + 1, pieces). Its
Bernstein coefficients are cᵢ/binom(n, i), and the least of them is a lower bound. Values at both
ends of pieces are a form of degree one. The variable is x = Ω², or Ω itself for a device known by a
table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb
from typing import Any, TypeAlias

import numpy as np

from percept.haptics.arrays import BoolArray, FloatArray, IntArray
from percept.haptics.impedance import Warp, warp
from percept.haptics.records import AnyDevice, Coupling, Device, Environment, TabulatedDevice

#: A pair of arrays of one shape, such as k and b.
Points: TypeAlias = tuple[FloatArray, FloatArray]
# Rounding of a coefficient, as a fraction of the sizes of its terms.
_ROUNDING = 64 * float(np.finfo(np.float64).eps)


def product(*forms: FloatArray) -> FloatArray:
    """Multiply forms."""
    first, *rest = forms
    for second in rest:
        if len(first) < len(second):
            first, second = second, first
        found = np.zeros((len(first) + len(second) - 1, max(first.shape[1], second.shape[1])))
        for i, row in enumerate(second):
            found[i : i + len(first)] += row * first
        first = found
    return first


def total(*forms: FloatArray) -> FloatArray:
    """Add forms, which takes them to the highest degree among them."""
    highest = max(len(form) for form in forms)
    found: Any = 0.0
    for form in forms:
        found = found + elevated(form, highest)
    return np.asarray(found)


def elevated(form: FloatArray, size: int) -> FloatArray:
    """Write a form in `size` coefficients: (1 − t) + t is one."""
    missing = size - len(form)
    return product(form, _binomials(missing)) if missing else form


def _binomials(degree: int) -> FloatArray:
    return np.array([[float(comb(degree, i))] for i in range(degree + 1)])


@dataclass(frozen=True)
class Display:
    """An environment displayed directly or through a coupling; device and coupling may hold arrays (n,)."""

    device: AnyDevice
    environment: Environment
    period: float
    coupling: Coupling | None = None
    hold: str = "average"

    @property
    def size(self) -> int | None:
        """How many displays the arrays make, None for one."""
        parts = [self.device.mass, self.device.damping] if isinstance(self.device, Device) else []
        parts += [] if self.coupling is None else [self.coupling.stiffness, self.coupling.damping]
        return max((np.size(part) for part in parts if np.ndim(part)), default=None)

    def at(self, which: Any) -> Display:
        """Return some of the displays."""

        def some(value: Any) -> Any:
            return value[which] if np.ndim(value) else value

        device, coupling = self.device, self.coupling
        if isinstance(device, Device):
            device = replace(device, mass=some(device.mass), damping=some(device.damping))
        if coupling is not None:
            coupling = Coupling(some(coupling.stiffness), some(coupling.damping))
        return replace(self, device=device, coupling=coupling)


def _shown_forms(display: Display, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return forms of k·V, b·V and V > 0 of what is shown; the environment's mass counts with the device."""
    own = display.environment
    k, b, m = (np.array([[float(v)]]) for v in (own.stiffness, own.damping, own.mass))
    if display.coupling is None:
        return k, b, np.ones((1, 1))
    k_c, b_c = (
        np.atleast_1d(v)[None] for v in (display.coupling.stiffness, display.coupling.damping)
    )
    spring = total(k, -m * x) if m[0, 0] else k
    near = total(b**2 * x, product(spring, spring))
    beyond = total(b_c**2 * x, k_c**2)
    joined = total(spring, k_c)
    under = total((b + b_c) ** 2 * x, product(joined, joined))
    stiffness = total(product(near, k_c), product(beyond, spring))
    if m[0, 0]:
        stiffness = total(stiffness, product(m * x, under))
    return stiffness, total(product(near, b_c), product(beyond, b)), under


@dataclass(frozen=True)
class Squares:
    """abs(Z_h)² on pieces, times a positive polynomial: as displayed and for any (k, b) of a region.

    Each is an array (ends, coefficients, pieces). The device lies between several ends where it is
    no polynomial: the table's ω in Ω, and the true hold.
    """

    shown: FloatArray  # As displayed, less `device`
    device: FloatArray  # Of k = b = 0
    damping: FloatArray  # Coefficient of b²
    across: FloatArray  # Of b
    stiffness: FloatArray  # Of k²
    along: FloatArray  # Of −k
    size: FloatArray  # What `shown` and `device` round from
    slack: FloatArray  # Bound of what the ends leave out of `device`

    @classmethod
    def of(cls, display: Display, omega: FloatArray) -> Squares:
        """Take pieces by their ends, shape (2, pieces)."""
        grid = warp(omega, display.period)
        x, under, ends = _device_forms(grid, display)
        felt = _shown_forms(display, x)
        k, b, v = (form / np.abs(felt[2]).max(axis=0) for form in felt)
        w2, v2, vw = product(under, under), product(v, v), product(v, under)
        own = total(product(x, b, b, w2), product(k, k, w2))
        rows, first = [], ends[0]
        for real, imaginary in ends:
            apart = (
                total(part, -start) for part, start in zip((real, imaginary), first, strict=True)
            )
            real_apart, imaginary_apart = apart
            mixed = product(x, vw, total(product(b, real), -product(k, imaginary)))
            alone = _square(x, real, imaginary, v2)
            rows.append(
                [
                    total(own, 2 * mixed),
                    alone,
                    product(x, w2, v2),
                    2 * product(x, real, under, v2),
                    product(w2, v2),
                    2 * product(x, imaginary, under, v2),
                    np.abs(total(own, alone)),
                    4 * _square(x, real_apart, imaginary_apart, v2),
                ]
            )
        highest = max(len(form) for row in rows for form in row)
        scale = _binomials(highest - 1)
        shape = (highest, omega.shape[1])
        tables = [
            [np.broadcast_to(elevated(form, highest) / scale, shape) for form in row]
            for row in rows
        ]
        found = [np.array(part) for part in zip(*tables, strict=True)]
        found[-1] = np.broadcast_to(found[-1].sum(axis=0), found[-1].shape)
        return cls(*found)

    def within(self, piece: IntArray, far: Points, near: Points, by: FloatArray) -> BoolArray:
        """Say where abs(Z_h) as displayed surely lies below `far` and above `near`, (k, b) of shape (n,).

        `by` is how much it may lie beyond, as a fraction of the square.
        """
        good: BoolArray = np.ones(by.shape, dtype=np.bool_)
        for end in range(len(self.shown)):
            shown, device, damping, across, stiffness, along, size, slack = (
                part[end][:, piece] for part in vars(self).values()
            )
            for (k, b), side in ((far, 1.0), (near, -1.0)):
                own, springs = b * b * damping, k * k * stiffness
                rest = own + b * across + springs - k * along
                beyond = side * (rest - shown) + by * (device + (rest if side > 0 else shown))
                lost = np.abs(by) * slack + _ROUNDING * (1 + np.abs(by)) * (
                    size + np.abs(own) + np.abs(springs)
                )
                good &= (beyond >= lost).all(axis=0)
        return good


def _square(x: FloatArray, real: FloatArray, imaginary: FloatArray, v2: FloatArray) -> FloatArray:
    return product(x, v2, total(product(real, real), product(x, imaginary, imaginary)))


def _device_forms(grid: Warp, display: Display) -> tuple[FloatArray, FloatArray, list[Points]]:
    """Return x, W > 0 and pairs (R, I), with (R + jΩI)/W = Z_d·e^{jh}/g + jΩm of one pair or between them."""
    device, rate, half = display.device, grid.rate, grid.period / 2
    if isinstance(device, TabulatedDevice):
        x, under, ends = _table_forms(grid, device, half)
    else:
        x = rate**2
        d, m = (np.atleast_1d(v)[None] for v in (device.damping, device.mass))
        real, imaginary, under = d - m * half * x, m + d * half, np.ones((1, 1))
        for mode in device.modes:
            light, k, b = (float(v) for v in (mode.mass, mode.stiffness, mode.damping))
            if not light or not (k or b):
                continue
            spring = k - light * x
            below = total(product(spring, spring), b * b * x)
            swing, lossy = light * (k * spring + b * b * x), light * light * b * product(x, x)
            own = total(lossy, -half * product(x, swing)), total(swing, half * lossy)
            real = total(product(real, below), product(own[0], under))
            imaginary = total(product(imaginary, below), product(own[1], under))
            under = product(under, below)
        largest = np.abs(under).max(axis=0)
        under, ends = under / largest, [(real / largest, imaginary / largest)]
    if display.hold == "true":
        # Beside the averaging hold the device counts h·cot h times, which falls with ω.
        factor = grid.half * grid.cos / grid.sin
        ends = [(r * real, r * imaginary) for real, imaginary in ends for r in factor]
    mass = float(display.environment.mass)
    if mass:
        ends = [(real, total(imaginary, mass * under)) for real, imaginary in ends]
    return x, under, ends


def _table_forms(
    grid: Warp, device: TabulatedDevice, half: float
) -> tuple[FloatArray, FloatArray, list[Points]]:
    """Bound Z_d, linear in ω between rows, and ω, concave in Ω: between its chord and a parallel above."""
    rate, omega = grid.rate, grid.omega
    value = device.at(omega)
    slope = np.diff(omega, axis=0) / np.diff(rate, axis=0)
    # Where the tangent of atan(ΩT/2) is parallel to the chord.
    turn = np.clip(np.sqrt(np.maximum(1 / slope - 1, 0.0)) / half, *rate)
    above = np.arctan(turn * half) / half - omega[:1] - slope * (turn - rate[:1])
    above = np.maximum(above, 0.0) + _ROUNDING * omega[1:]
    along = np.diff(value, axis=0) / np.diff(omega, axis=0)
    ends = []
    for more in (0.0 * above, above):
        real, imaginary = value.real + more * along.real, value.imag + more * along.imag
        turned = (
            total(real, -half * product(imaginary, rate)),
            total(imaginary, half * product(real, rate)),
        )
        ends.append((product(turned[0], rate), turned[1]))
    return product(rate, rate), rate, ends
