"""Slow twins: the model's log density and the haptics formulas, in any precision."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# mpmath numbers and matrices have no types.
Number: TypeAlias = Any
#: The inputs of a formula by name, with z, s, θ and the mpmath context `mp`.
Point: TypeAlias = Any
Formula: TypeAlias = Callable[[Point], Number]

DIGITS = 120
_ALPHA_SD = 1.0  # Priors of the model: of the level of a parameter
_GAMMA_SD = 0.25  # And of its trend, per decade
_STEP = "1e-30"  # Relative change of an input: its square is lost in 120 digits' last 60
_NYQUIST_GAP = "1e-80"  # π − ωT of a point that stands for Nyquist, where Tustin's s is infinite
# Exact values beyond these stand for 0 and inf, which 1e-80 from Nyquist are not reached.
_NOTHING = 1e-50
_EVERYTHING = 1e50


# The density. Subjects adjust two parameters.


@dataclass(frozen=True)
class Levels:
    """SDs of the model's levels, equal for both parameters and all environments."""

    between: float
    shared: float
    trial: float
    tau: float
    rest: float  # 1 - rho, rho the correlation of both parameters at every level


def exact(response: Array, x: Array, levels: Levels) -> Number:
    """Evaluate the log density in `DIGITS` digits, by one covariance of all responses but NaN."""
    import mpmath

    rows = np.argwhere(np.isfinite(response)).tolist()
    with mpmath.workdps(DIGITS):
        number = mpmath.mpf
        covariance = mpmath.matrix(len(rows), len(rows))
        for row, (i, j, r, p) in enumerate(rows):
            for column, (k, h, s, q) in enumerate(rows):
                value = number(0)
                if i == k:
                    value += number(levels.shared) ** 2
                if (i, j) == (k, h):
                    value += number(levels.between) ** 2
                if (i, j, r) == (k, h, s):
                    value += number(levels.trial) ** 2
                if p != q:
                    value *= 1 - number(levels.rest)
                else:
                    trend = number(x[p, j]) * number(x[p, h])
                    value += number(_ALPHA_SD) ** 2 + number(_GAMMA_SD) ** 2 * trend
                    value += number(levels.tau) ** 2 * (j == h)
                covariance[row, column] = value
        values = mpmath.matrix(response[np.isfinite(response)].tolist())
        distance = (values.T * mpmath.lu_solve(covariance, values))[0]
        constant = len(rows) * mpmath.log(2 * mpmath.pi)
        return -(distance + mpmath.log(mpmath.det(covariance)) + constant) / 2


# The haptics formulas


def is_nyquist(theta: float) -> bool:
    """Say whether ωT counts as π."""
    return abs(theta - np.pi) <= 4 * np.spacing(np.pi)


def error_over_condition(
    computed: complex, exact: Formula, inputs: Mapping[str, float], *, at_nyquist: bool = False
) -> float:
    """Return the relative error over max(1, condition of `exact` in its inputs).

    Parameters
    ----------
    computed : complex
        What percept gives.
    exact : Formula
        The same in any precision.
    inputs : mapping
        Values of the formula, ω in rad/s and T in s among them; it need not read all.
    at_nyquist : bool, optional
        Whether ωT stands for π.

    Returns
    -------
    float
        inf where `computed` is not finite and should be.
    """
    import mpmath

    with mpmath.workdps(DIGITS):
        precise = {key: mpmath.mpf(value) for key, value in inputs.items()}
        if at_nyquist:
            precise["omega"] = (mpmath.pi - mpmath.mpf(_NYQUIST_GAP)) / precise["period"]
        point = _point(precise, mpmath)
        value = exact(point)
        size = mpmath.mpf(abs(value))
        if size > _EVERYTHING:
            return 0.0 if np.isinf(computed) else float("inf")
        if size < _NOTHING:
            return 0.0 if abs(computed) < _NOTHING else float("inf")
        if not np.isfinite(computed):
            return float("inf")
        total = mpmath.mpf(0)
        for key, number in precise.items():
            of_point = key in ("omega", "period")
            if number == 0 or (at_nyquist if of_point else key not in point.read):
                continue
            step = 1 + mpmath.mpf(_STEP)
            moved = exact(_point({**precise, key: number * step}, mpmath))
            total += abs(moved - value) / mpmath.mpf(_STEP)
        return float(abs(mpmath.mpmathify(computed) - value) / max(size, total))


class _Point:
    """Inputs of a formula; it keeps which of them were read."""

    def __init__(self, inputs: Mapping[str, Number]) -> None:
        self._inputs = inputs
        self.read: set[str] = set()

    def __getattr__(self, name: str) -> Number:
        self.read.add(name)
        return self._inputs[name]


def _point(inputs: Mapping[str, Number], mp: Any) -> _Point:
    """Add z = exp(jωT), Tustin's s and θ to the inputs, in the arithmetic of an mpmath context."""
    theta = inputs["omega"] * inputs["period"]
    z = mp.expj(theta)
    # On the unit circle s is imaginary; a real part is rounding, and would count where nothing else
    # is real.
    tustin = 2 / inputs["period"] * (z - 1) / (z + 1)
    s = mp.mpc(0, tustin.imag)
    return _Point({**inputs, "theta": theta, "z": z, "s": s, "mp": mp})


def _series(a: Number, b: Number) -> Number:
    """Two elements in series; nothing passes an absent one."""
    return 0 if a == 0 or b == 0 else a * b / (a + b)


def rigid(p: Point) -> Number:
    """Eq. 5."""
    return p.m * p.s + p.b_d


def flexible(p: Point) -> Number:
    """Eq. 5 with a spring and one mode added."""
    joint = p.b_i + p.k_i / p.s
    return rigid(p) + p.k_d / p.s + _series(p.m_i * p.s, joint)


def environment(p: Point) -> Number:
    """Eq. 7."""
    return p.m_e * p.s + p.b_e + p.k_e / p.s


def coupling_backward(p: Point) -> Number:
    """Eq. 6."""
    return p.b_c + p.k_c * p.period * p.z / (p.z - 1)


def coupling_tustin(p: Point) -> Number:
    """Tustin's coupling (Eq. 12)."""
    return p.b_c + p.k_c / p.s


def admittance_backward(p: Point) -> Number:
    """1/Z_c, or p22 (Eq. 4)."""
    z_c = coupling_backward(p)
    return p.mp.inf if z_c == 0 else 1 / z_c


def hold_average(p: Point) -> Number:
    """Eq. 8."""
    return (p.z + 1) / (2 * p.z)


def hold_true(p: Point) -> Number:
    """(1 − e^{−jθ})/(jθ)."""
    return (1 - 1 / p.z) / (p.mp.j * p.theta)


def late(zoh: Formula) -> Formula:
    """Delay a hold by p.delay samples."""
    return lambda p: zoh(p) * p.mp.expj(-p.delay * p.theta)


def effective(p: Point) -> Number:
    """Environment seen through its coupling."""
    return _series(environment(p), coupling_tustin(p))


def effective_damping(p: Point) -> Number:
    """Its real part."""
    return p.mp.mpc(effective(p)).real


def _perceived(device: Formula, zoh: Formula, shown: Formula) -> Formula:
    """Eqs 11 and 13: a device, and what the hold shows of the rest."""
    return lambda p: device(p) + zoh(p) * shown(p)


def _effective_backward(p: Point) -> Number:
    return _series(environment(p), coupling_backward(p))


direct = _perceived(rigid, hold_average, environment)
direct_flexible_true = _perceived(flexible, hold_true, environment)
coupled = _perceived(rigid, hold_average, effective)
coupled_backward = _perceived(rigid, hold_average, _effective_backward)


def magnitude(p: Point) -> Number:
    """abs(Z_h) with a negative stiffness and a negative damping, as limits may be."""
    z_e = p.m_e * p.s - p.b_e - p.k_e / p.s
    return abs(rigid(p) + hold_average(p) * z_e)


def box_lower(p: Point) -> Number:
    """Lowest abs(Z_h) over k in [−k_e, k_c], b in [−b_e, b_c]: zero inside, or on the edge."""
    zoh = hold_average(p)
    base = rigid(p) / zoh + p.m_e * p.s
    rate = p.s.imag
    near_b = min(max(-base.real, -p.b_e), p.b_c)
    near_k = min(max(base.imag * rate, -p.k_e), p.k_c)
    return abs(zoh * (base + near_b - p.mp.j * near_k / rate))


def box_upper(p: Point) -> Number:
    """Highest abs(Z_h) over the same box."""
    corners = itertools.product((-p.b_e, p.b_c), (-p.k_e, p.k_c))
    magnitudes = []
    for b, k in corners:
        z_e = p.m_e * p.s + b + k / p.s
        magnitudes.append(abs(rigid(p) + hold_average(p) * z_e))
    return max(magnitudes)


def required_at(coupling: Formula, zoh: Formula) -> Formula:
    """Eq. 10 solved for Re Z_d."""

    def formula(p: Point) -> Number:
        z_c = coupling(p)
        if z_c == 0:
            return p.mp.mpf(0)
        admittance = (1 / z_c).real
        needed = abs(zoh(p)) - zoh(p).real
        return p.mp.inf if admittance == 0 else needed / (2 * admittance)

    return formula


def margin(p: Point) -> Number:
    """Re Z_d of a device with a mode over what Eq. 10 asks for."""
    required = required_at(coupling_backward, hold_average)(p)
    return p.mp.inf if required == 0 else flexible(p).real / required


def required(p: Point) -> Number:
    """Largest of βy(1 − y)/2 + K²y³/(8β(1 + y)) over y, its slope set to zero by bisection."""
    stretch = p.k_c * p.period
    return _largest_required(p.mp, stretch, p.b_c + stretch / 2)


def _largest_required(mp: Any, stretch: Number, beta: Number) -> Number:
    """Return the maximum over y in [0, 1]."""
    if beta == 0:
        return mp.inf if stretch else mp.mpf(0)

    def value(y: Number) -> Number:
        elastic = stretch**2 * y**3 / (8 * beta * (1 + y))
        return beta * y * (1 - y) / 2 + elastic

    def slope(y: Number) -> Number:
        elastic = stretch**2 * (3 * y**2 + 2 * y**3) / (8 * beta * (1 + y) ** 2)
        return beta * (1 - 2 * y) / 2 + elastic

    if slope(mp.mpf(1)) >= 0:
        return value(mp.mpf(1))
    # An error in y enters the maximum squared.
    ends = mp.mpf("0.5") - mp.mpf("1e-9"), mp.mpf(1)
    return value(mp.findroot(slope, ends, solver="anderson", tol=1e-90))
