"""Polynomials on pieces of a range of ω, and abs(Z_h)² written as such polynomials.

On a piece a polynomial of degree n is the form Σ cᵢ(1 − t)^(n−i)tⁱ, with t from 0 to 1 along the
piece. Its Bernstein coefficients are cᵢ/binom(n, i), and the least of them is a lower bound: where
all are positive, so is the polynomial on the whole piece. The variable that is linear in t is Ω²,
or Ω itself for a device known by a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars
from percept.haptics.impedance import Warp, omega_of_rate, warp
from percept.haptics.perceived import Extremes, Point
from percept.haptics.records import Coupling, Device, Display, Environment, Mode, TabulatedDevice

__all__ = ["Form", "Shown", "Squares", "shown_through"]

# Rounding of a coefficient, as a fraction of the sizes of its terms.
_ROUNDING = 64 * float(np.finfo(np.float64).eps)


class Form:
    """A polynomial on each of many pieces; a number, or one per piece, acts as a constant."""

    # An array to the left of an operator leaves the operation to this class.
    __array_ufunc__ = None

    def __init__(self, coefficients: FloatArray) -> None:
        #: (degree + 1, pieces), or (degree + 1, 1) where all pieces have the same.
        self.coefficients = coefficients

    @property
    def size(self) -> int:
        """Number of coefficients, one more than the degree."""
        return len(self.coefficients)

    def __add__(self, other: Form | Scalars) -> Form:
        other = _as_form(other)
        size = max(self.size, other.size)
        return Form(self.elevated(size) + other.elevated(size))

    def __mul__(self, other: Form | Scalars) -> Form:
        if not isinstance(other, Form):
            return Form(self.coefficients * other)
        if self.size < other.size:
            return other * self
        pieces = max(self.coefficients.shape[1], other.coefficients.shape[1])
        product = np.zeros((self.size + other.size - 1, pieces))
        for i, coefficient in enumerate(other.coefficients):
            product[i : i + self.size] += coefficient * self.coefficients
        return Form(product)

    def __sub__(self, other: Form | Scalars) -> Form:
        return self + -1.0 * other

    def __rsub__(self, other: Scalars) -> Form:
        return -1.0 * self + other

    def __truediv__(self, divisor: FloatArray) -> Form:
        return Form(self.coefficients / divisor)

    __radd__ = __add__
    __rmul__ = __mul__

    def elevated(self, size: int) -> FloatArray:
        """Return the same polynomial in `size` coefficients: a factor (1 − t) + t is one."""
        if size == self.size:
            return self.coefficients
        unit = Form(_binomials(size - self.size))
        return (self * unit).coefficients

    def bernstein(self, size: int) -> FloatArray:
        """Return `size` Bernstein coefficients."""
        return self.elevated(size) / _binomials(size - 1)


def _as_form(value: Form | Scalars) -> Form:
    if isinstance(value, Form):
        return value
    return Form(np.atleast_1d(value)[None])


@cache
def _binomials(degree: int) -> FloatArray:
    """Return binom(degree, i) as a column."""
    row = [float(comb(degree, i)) for i in range(degree + 1)]
    return np.array(row)[:, None]


class _Impedance(NamedTuple):
    """(real + jΩ·imaginary)/denominator, N·s/m; the denominator is positive."""

    real: Form
    imaginary: Form
    denominator: Form


def _device_ends(display: Display, grid: Warp, square: Form) -> list[_Impedance]:
    """Return Z_d·e^{jh}/g + jΩm_e, or several between which it lies; `square` is Ω².

    g is the hold's gain, m_e the environment's mass. All have one denominator.
    """
    device = display.device
    if isinstance(device, TabulatedDevice):
        ends = _tabulated(grid, device)
    else:
        ends = [_modal(square, device, grid.period / 2)]
    gains = [1.0]
    if display.hold == "true":
        # h·cot h is the averaging hold's gain over the true one's, and falls with ω.
        gains = list(grid.half * grid.cos / grid.sin)
    mass = display.environment.mass
    scaled = []
    for real, imaginary, denominator in ends:
        for gain in gains:
            with_mass = gain * imaginary + mass * denominator
            scaled.append(_Impedance(gain * real, with_mass, denominator))
    return scaled


def _modal(square: Form, device: Device, half: float) -> _Impedance:
    """Return Z_d·e^{jh}/cos h of a rigid device with its modes; `half` is T/2.

    e^{jh}/cos h is 1 + jΩT/2.
    """
    real = device.damping - np.multiply(device.mass, half) * square
    imaginary = _as_form(device.mass + np.multiply(device.damping, half))
    denominator = _as_form(1.0)
    for mode in device.modes:
        if not mode.mass or not (mode.stiffness or mode.damping):
            continue
        added = _mode(square, mode, half)
        real = real * added.denominator + added.real * denominator
        imaginary = imaginary * added.denominator + added.imaginary * denominator
        denominator = denominator * added.denominator
    largest = np.abs(denominator.coefficients).max(axis=0)
    return _Impedance(real / largest, imaginary / largest, denominator / largest)


def _mode(square: Form, mode: Mode, half: float) -> _Impedance:
    """Return what a flexible mode adds to that, Z·(1 + jΩT/2)."""
    m = mode.mass
    k = mode.stiffness
    b = mode.damping
    spring = k - m * square
    damper = b * b * square
    inertia = m * (k * spring + damper)
    damping = m * m * b * (square * square)
    real = damping - half * (square * inertia)
    return _Impedance(real, inertia + half * damping, spring * spring + damper)


def _tabulated(grid: Warp, device: TabulatedDevice) -> list[_Impedance]:
    """Bound Z_d·(1 + jΩT/2) of a measured device: linear in ω between rows, and ω is concave in Ω.

    So Z_d lies between the chord of ω over Ω and the parallel that touches ω from above.
    """
    rate = grid.rate
    omega = grid.omega
    half = grid.period / 2
    impedance = device.at(omega)
    rise = np.diff(omega, axis=0)
    slope = rise / np.diff(rate, axis=0)
    # Where the tangent of ω = atan(ΩT/2)/(T/2) is parallel to the chord.
    touching = np.sqrt(np.maximum(1 / slope - 1, 0.0)) / half
    touching = np.clip(touching, *rate)
    chord = omega[:1] + slope * (touching - rate[:1])
    above_chord = omega_of_rate(touching, grid.period) - chord
    most_above = np.maximum(above_chord, 0.0) + _ROUNDING * omega[1:]
    per_omega = np.diff(impedance, axis=0) / rise
    by_rate = Form(rate)
    ends = []
    for shift in (0.0, most_above):
        shifted = impedance + shift * per_omega
        real = Form(shifted.real)
        imaginary = Form(shifted.imag)
        turned_real = real - half * (imaginary * by_rate)
        turned_imaginary = imaginary + half * (real * by_rate)
        # Over Ω, so that the imaginary part is a multiple of Ω as well.
        ends.append(_Impedance(turned_real * by_rate, turned_imaginary, by_rate))
    return ends


# A polynomial in Ω², of either kind.
Curve = TypeVar("Curve", Form, Polynomial)


class Shown(NamedTuple, Generic[Curve]):
    """Stiffness and damping that a display shows, both over one positive denominator."""

    stiffness: Curve
    damping: Curve
    denominator: Curve


def shown_through(coupling: Coupling, environment: Environment, square: Curve) -> Shown[Curve]:
    """Return what an environment shows through a coupling, as polynomials in Ω².

    Parameters
    ----------
    coupling : Coupling
        In Tustin's form; with a `Form` for Ω² its parameters may hold one number per piece.
    environment : Environment
        Its mass counts with the device, and is not shown.
    square : Form or Polynomial
        Ω², rad²/s².

    Returns
    -------
    Shown
        Of the type of `square`.
    """
    k = environment.stiffness
    b = environment.damping
    m = environment.mass
    k_c = coupling.stiffness
    b_c = coupling.damping
    # Without a mass the spring stays a number, which keeps all degrees low.
    spring: Curve | Scalars = k - m * square if m else k
    # Ω²·abs(Z)² of environment, coupling and their sum.
    of_environment = b**2 * square + spring * spring
    of_coupling = b_c**2 * square + np.square(k_c)
    joined = spring + k_c
    of_sum = (b + b_c) ** 2 * square + joined * joined
    stiffness = k_c * of_environment + of_coupling * spring
    if m:
        stiffness = stiffness + m * square * of_sum
    return Shown(stiffness, b_c * of_environment + b * of_coupling, of_sum)


def _shown(display: Display, square: Form) -> Shown[Form]:
    """Return what a display shows, over a denominator of size one."""
    environment = display.environment
    if display.coupling is None:
        stiffness = _as_form(environment.stiffness)
        return Shown(stiffness, _as_form(environment.damping), _as_form(1.0))
    stiffness, damping, denominator = shown_through(display.coupling, environment, square)
    largest = np.abs(denominator.coefficients).max(axis=0)
    return Shown(stiffness / largest, damping / largest, denominator / largest)


@dataclass(frozen=True)
class Squares:
    """abs(Z_h)² on pieces, times a positive polynomial: as displayed, and of any (k, b).

    Each field holds Bernstein coefficients, shape (ends, coefficients, pieces). There are several
    ends where the device is no polynomial: it then lies between them.
    """

    shown: FloatArray  # As displayed, without `device`
    device: FloatArray  # Of k = b = 0
    b_square: FloatArray  # Coefficient of b²
    b_linear: FloatArray  # Of b
    k_square: FloatArray  # Of k²
    k_linear: FloatArray  # Of k
    size: FloatArray  # Of the terms whose rounding `shown` and `device` have
    slack: FloatArray  # Bound of what the ends leave out of `device`

    @classmethod
    def of(cls, display: Display, omega: FloatArray) -> Squares:
        """Take pieces by their ends, shape (2, pieces), rad/s."""
        grid = warp(omega, display.period)
        square = Form(grid.rate**2)
        if isinstance(display.device, TabulatedDevice):
            square = Form(grid.rate) * Form(grid.rate)
        shown = _shown(display, square)
        devices = _device_ends(display, grid, square)
        ends = [_terms(square, shown, device, devices[0]) for device in devices]
        size = max(form.size for terms in ends for form in terms.values())
        every_piece = np.zeros(omega.shape[1])
        fields = {}
        for name in ends[0]:
            tables = [terms[name].bernstein(size) + every_piece for terms in ends]
            fields[name] = np.array(tables)
        # All ends together, for each of them.
        slack = fields["slack"]
        fields["slack"] = np.broadcast_to(slack.sum(axis=0), slack.shape)
        return cls(**fields)

    def surely_between(
        self, piece: IntArray, extremes: Extremes, allowance: FloatArray
    ) -> BoolArray:
        """Say where abs(Z_h) as displayed surely lies between its extremes over a region.

        All arguments have shape (n,). The allowance is how much the display may lie beyond, as a
        fraction of the square.
        """
        decided: BoolArray = np.ones(allowance.shape, dtype=np.bool_)
        rounding = _ROUNDING * (1 + np.abs(allowance))
        for end in range(len(self.shown)):
            of_piece = [field[end][:, piece] for field in vars(self).values()]
            terms = Squares(*of_piece)
            least = np.abs(allowance) * terms.slack + rounding * terms.size

            far, far_size = terms._at(extremes.farthest)
            below = far - terms.shown + allowance * (terms.device + far)
            decided &= (below >= least + rounding * far_size).all(axis=0)

            near, near_size = terms._at(extremes.nearest)
            above = terms.shown - near + allowance * (terms.device + terms.shown)
            decided &= (above >= least + rounding * near_size).all(axis=0)
        return decided

    def _at(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Return abs(Z_h)² of (k, b), without `device`, and the size of its terms."""
        k, b = point
        dampers = b * b * self.b_square
        springs = k * k * self.k_square
        square = dampers + b * self.b_linear + springs + k * self.k_linear
        return square, np.abs(dampers) + np.abs(springs)


def _terms(
    square: Form, shown: Shown[Form], device: _Impedance, first_end: _Impedance
) -> dict[str, Form]:
    """Return the fields of `Squares` for one end of the device.

    With x = Ω², the device (R + jΩI)/w and (k, b)/v shown, all are parts of x·w²v²·abs(Z_h)²/g².
    """
    real, imaginary, w = device
    k, b, v = shown
    wv = w * v
    xwv = square * wv
    xwvv = xwv * v
    wk = w * k
    wb = w * b
    springs_and_dampers = wk * wk + square * (wb * wb)
    mixed = xwv * (b * real - k * imaginary)
    xvv = square * (v * v)
    alone = xvv * (real * real + square * (imaginary * imaginary))
    real_off = real - first_end.real
    imaginary_off = imaginary - first_end.imaginary
    off = xvv * (real_off * real_off + square * (imaginary_off * imaginary_off))
    return {
        "shown": springs_and_dampers + 2.0 * mixed,
        "device": alone,
        "b_square": xwv * wv,
        "b_linear": 2.0 * (xwvv * real),
        "k_square": wv * wv,
        "k_linear": -2.0 * (xwvv * imaginary),
        "size": Form(np.abs((springs_and_dampers + alone).coefficients)),
        "slack": 4.0 * off,
    }
