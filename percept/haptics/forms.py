"""abs(Z_h)² as polynomials on pieces of a range of ω, whose signs decide verdicts.

The variable that is linear along a piece is Ω², or Ω itself for a device known by a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from percept.haptics.arrays import BoolArray, FloatArray, IntArray
from percept.haptics.axis import Warp, omega_of_rate, warp
from percept.haptics.loop import Hold, hold_of
from percept.haptics.perceived import Extremes, Point
from percept.haptics.polynomials import Form, as_form
from percept.haptics.records import Device, Display, Mode, TabulatedDevice
from percept.haptics.shown import Shown, shown_by

__all__ = ["Squares"]

# Rounding of a coefficient, as a fraction of the sizes of its terms.
_ROUNDING = 64 * float(np.finfo(np.float64).eps)


class _Impedance(NamedTuple):
    """(real + jΩ·imaginary)/denominator, N·s/m; the denominator is positive."""

    real: Form
    imaginary: Form
    denominator: Form


def _device_ends(display: Display, grid: Warp, square: Form) -> list[_Impedance]:
    """Return Z_d·e^{j(h + ψ)}/g + jΩm_e, or several between which it lies; `square` is Ω².

    g is the hold's gain, ψ the angle of its delay, m_e the environment's mass. All have one
    denominator.
    """
    device = display.device
    if isinstance(device, TabulatedDevice):
        ends = _tabulated(grid, device)
    else:
        ends = [_modal(square, device, grid.period / 2)]
    hold = hold_of(display.hold)
    if hold.delay:
        turns = _delay_ends(grid, square, hold.delay)
        ends = [_turned(end, turn, square) for end in ends for turn in turns]
    gains = [1.0]
    if hold.kind == "true":
        # h·cot h is the averaging hold's gain over the true one's, and falls with ω.
        gains = list(grid.half * grid.cos / grid.sin)
    mass = display.environment.mass
    scaled = []
    for real, imaginary, denominator in ends:
        for gain in gains:
            with_mass = gain * imaginary + mass * denominator
            scaled.append(_Impedance(gain * real, with_mass, denominator))
    return scaled


class _Turn(NamedTuple):
    """e^{jψ} as cosine + jΩ·sine, ψ = dωT."""

    cosine: Form
    sine: Form  # sin ψ/Ω, s/rad


def _delay_ends(grid: Warp, square: Form, delay: float) -> list[_Turn]:
    """Return four between which e^{jψ} of a delay lies, ψ = dωT.

    Its cosine and its sine over Ω are smooth in x = Ω². Each is within its chord over x and
    (x₁ − x₀)²/8 times a bound of its second derivative. With A = h/tan h = ∫du/(1 + u²xT²/4) over u
    from 0 to 1, and sin ψ/Ω = dT·A·∫cos(sψ)ds over s from 0 to 1, bounds by T and d alone follow.
    """
    lag = grid.lag(Hold(delay=delay))
    assert lag is not None
    slowest, fastest = grid.rate
    # (x − x₀)/(x₁ − x₀); for a table x is the square of the variable.
    along = np.array([np.zeros_like(slowest), np.ones_like(slowest)])
    if square.size == 3:
        along = np.insert(along, 1, 2 * slowest / (slowest + fastest), axis=0)
    weight = Form(along)
    period = grid.period
    quartic = period**4 * (delay**2 / 6 + delay**4 / 12)
    quintic = delay * period**5 * (1 / 40 + delay**2 / 12 + delay**4 / 60)
    sagitta = ((fastest - slowest) * (fastest + slowest)) ** 2 / 8
    sine = lag.sin_per_sin * grid.cos * (period / 2)
    cosines = _within(lag.cos, weight, quartic * sagitta)
    sines = _within(sine, weight, quintic * sagitta)
    return [_Turn(first, second) for first in cosines for second in sines]


def _within(values: FloatArray, weight: Form, farthest: FloatArray) -> list[Form]:
    """Return a chord between values at both ends of each piece, less and plus a distance."""
    first, last = values
    chord = first * (1.0 - weight) + last * weight
    return [chord - farthest, chord + farthest]


def _turned(end: _Impedance, turn: _Turn, square: Form) -> _Impedance:
    """Return the product of both."""
    real = end.real * turn.cosine - square * (end.imaginary * turn.sine)
    imaginary = end.imaginary * turn.cosine + end.real * turn.sine
    return _Impedance(real, imaginary, end.denominator)


def _modal(square: Form, device: Device, half: float) -> _Impedance:
    """Return Z_d·e^{jh}/cos h of a device with its spring and modes; `half` is T/2.

    e^{jh}/cos h is 1 + jΩT/2.
    """
    real = device.damping - np.multiply(device.mass, half) * square
    imaginary = as_form(device.mass + np.multiply(device.damping, half))
    denominator = as_form(1.0)
    parts = [
        _mode(square, mode, half)
        for mode in device.modes
        if mode.mass and (mode.stiffness or mode.damping)
    ]
    if device.stiffness:
        parts.append(_spring(square, float(device.stiffness), half))
    for added in parts:
        real = real * added.denominator + added.real * denominator
        imaginary = imaginary * added.denominator + added.imaginary * denominator
        denominator = denominator * added.denominator
    largest = np.abs(denominator.coefficients).max(axis=0)
    return _Impedance(real / largest, imaginary / largest, denominator / largest)


def _spring(square: Form, stiffness: float, half: float) -> _Impedance:
    """Return what a spring to ground adds to that, −jk/Ω·(1 + jΩT/2)."""
    return _Impedance(stiffness * half * square, as_form(-stiffness), square)


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


def _shown(display: Display, square: Form) -> Shown[Form]:
    """Return what a display shows, over a denominator of size one."""
    environment = display.environment
    if display.coupling is None and environment.velocity_filter is None:
        stiffness = as_form(environment.stiffness)
        return Shown(stiffness, as_form(environment.damping), as_form(1.0))
    stiffness, damping, denominator = shown_by(display, square)
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
