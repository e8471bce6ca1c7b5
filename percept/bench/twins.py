"""Slow twins: the model's log density and the haptics formulas, plainly, for numbers of any precision."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
# mpmath numbers and matrices have no types.
Number: TypeAlias = Any
Formula: TypeAlias = Callable[[Any], Number]

DIGITS = 120
_ALPHA_SD, _GAMMA_SD = 1.0, 0.25
_STEP = "1e-30"
_NYQUIST_GAP = "1e-80"
_NOTHING, _EVERYTHING = 1e-50, 1e50


# The density. Every subject sees every environment equally often. Two parameters; a subject's
# values are stacked by environment, then trial, then parameter.


@dataclasses.dataclass(frozen=True)
class Levels:
    """SDs of the model's levels, equal for both parameters and all environments, on the response scale."""

    between: float
    shared: float
    trial: float
    tau: float
    rest: float  # 1 - rho, rho the correlation of both parameters at every level


def exact(response: Array, x: Array, levels: Levels) -> Number:
    """Evaluate the log density in `DIGITS` digits."""
    import mpmath

    with mpmath.workdps(DIGITS):
        subjects, environments, trials, _ = response.shape
        covariance, design = _model(environments, trials, x, levels)
        columns = [
            [mpmath.mpf(value) for value in row]
            for row in response.reshape(subjects, -1).T.tolist()
        ]
        size = len(columns)
        total = mpmath.matrix([mpmath.fsum(column) for column in columns])
        squares = mpmath.matrix(size, size)
        for i in range(size):
            for j in range(i + 1):
                squares[i, j] = squares[j, i] = mpmath.fdot(columns[i], columns[j])
        inverse = covariance**-1
        pull = design.T * inverse
        inner = mpmath.eye(design.cols) + subjects * pull * design
        right = pull * total
        distance = mpmath.fsum(
            inverse[i, j] * squares[i, j] for i in range(size) for j in range(size)
        )
        distance -= (right.T * inner**-1 * right)[0]
        log_determinant = subjects * mpmath.log(mpmath.det(covariance)) + mpmath.log(
            mpmath.det(inner)
        )
        return -(distance + log_determinant + subjects * size * mpmath.log(2 * mpmath.pi)) / 2


def _model(environments: int, trials: int, x: Array, levels: Levels) -> tuple[Number, Number]:
    """Covariance of one subject's values about the locations, and the columns of the locations' factor."""
    import mpmath

    between, shared, trial, tau, rest = (mpmath.mpf(value) for value in dataclasses.astuple(levels))
    rows = [(j, r, p) for j in range(environments) for r in range(trials) for p in range(2)]
    covariance = [
        [
            (1 if p == q else 1 - rest)
            * (shared**2 + (j == h) * between**2 + ((j, r) == (h, s)) * trial**2)
            for h, s, q in rows
        ]
        for j, r, p in rows
    ]
    design = [
        [
            *((p == q) * mpmath.mpf(_ALPHA_SD) for q in range(2)),
            *((p == q) * mpmath.mpf(_GAMMA_SD) * mpmath.mpf(float(x[p, j])) for q in range(2)),
            *(((j, p) == (h, q)) * tau for h in range(environments) for q in range(2)),
        ]
        for j, _, p in rows
    ]
    return mpmath.matrix(covariance), mpmath.matrix(design)


# The haptics formulas


def is_nyquist(theta: float) -> bool:
    """Say whether ωT counts as π."""
    return abs(theta - np.pi) <= 4 * np.spacing(np.pi)


def error_over_condition(
    computed: complex, exact: Formula, inputs: Mapping[str, float], *, at_nyquist: bool = False
) -> float:
    """Return the relative error over max(1, condition of `exact` in its inputs)."""
    import mpmath

    with mpmath.workdps(DIGITS):
        precise = {key: mpmath.mpf(value) for key, value in inputs.items()}
        if at_nyquist:
            precise["omega"] = (mpmath.pi - mpmath.mpf(_NYQUIST_GAP)) / precise["period"]
        value = exact(_point(precise, mpmath))
        size = mpmath.mpf(abs(value))
        if size > _EVERYTHING:
            return 0.0 if np.isinf(computed) else float("inf")
        if size < _NOTHING:
            return 0.0 if abs(computed) < _NOTHING else float("inf")
        if not np.isfinite(computed):
            return float("inf")
        total = mpmath.mpf(0)
        for key, number in precise.items():
            if number == 0 or (at_nyquist and key in ("omega", "period")):
                continue
            moved = exact(_point({**precise, key: number * (1 + mpmath.mpf(_STEP))}, mpmath))
            total += abs(moved - value) / mpmath.mpf(_STEP)
        return float(abs(mpmath.mpmathify(computed) - value) / max(size, total))


def limit_error_over_condition(
    stiffness: float, device: float, coupling: float, period: float
) -> float:
    """Return the same for the largest k_c of a device and coupling damping, from the damping it needs.

    The error in k_c is the misfit of the required damping over its slope; so is what each input
    contributes.
    """
    import mpmath

    with mpmath.workdps(DIGITS):
        b_d, b_c, t, k = (mpmath.mpf(value) for value in (device, coupling, period, stiffness))
        if np.isnan(stiffness):
            return float("inf")
        if k == 0:
            enough = largest_required(mpmath, k, b_c) >= b_d * (1 - mpmath.mpf("1e-15"))
            return 0.0 if enough else float("inf")
        step = 1 + mpmath.mpf(_STEP)

        def needed(k: Number, b_c: Number, t: Number) -> Number:
            return largest_required(mpmath, k * t, b_c + k * t / 2)

        base = needed(k, b_c, t)
        slopes = [
            abs(needed(*moved) - base)
            for moved in ((k * step, b_c, t), (k, b_c * step, t), (k, b_c, t * step))
        ]
        by_k = slopes[0] / mpmath.mpf(_STEP)
        condition = (b_d + (slopes[1] + slopes[2]) / mpmath.mpf(_STEP)) / by_k
        return float(abs(base - b_d) / by_k / max(mpmath.mpf(1), condition))


def _point(inputs: Mapping[str, Number], mp: Any) -> SimpleNamespace:
    """Add z = exp(jωT), Tustin's s and θ to the inputs, in the arithmetic of an mpmath context."""
    theta = inputs["omega"] * inputs["period"]
    z = mp.expj(theta)
    # On the unit circle s is imaginary; a real part is rounding, and would count where nothing else
    # is real.
    s = mp.mpc(0, (2 / inputs["period"] * (z - 1) / (z + 1)).imag)
    return SimpleNamespace(**inputs, theta=theta, z=z, s=s, mp=mp)


def series(a: Number, b: Number) -> Number:
    """Two elements in series; nothing passes an absent one."""
    return 0 if a == 0 or b == 0 else a * b / (a + b)


def rigid(p: Any) -> Number:
    """Eq. 5."""
    return p.m * p.s + p.b_d


def flexible(p: Any) -> Number:
    """Eq. 5 with one mode added."""
    return rigid(p) + series(p.m_i * p.s, p.b_i + p.k_i / p.s)


def environment(p: Any) -> Number:
    """Eq. 7."""
    return p.m_e * p.s + p.b_e + p.k_e / p.s


def coupling_backward(p: Any) -> Number:
    """Eq. 6."""
    return p.b_c + p.k_c * p.period * p.z / (p.z - 1)


def coupling_tustin(p: Any) -> Number:
    """Tustin's coupling (Eq. 12)."""
    return p.b_c + p.k_c / p.s


def admittance_backward(p: Any) -> Number:
    """1/Z_c, or p22 (Eq. 4)."""
    z_c = coupling_backward(p)
    return p.mp.inf if z_c == 0 else 1 / z_c


def hold_average(p: Any) -> Number:
    """Eq. 8."""
    return (p.z + 1) / (2 * p.z)


def hold_true(p: Any) -> Number:
    """(1 − e^{−jθ})/(jθ)."""
    return (1 - 1 / p.z) / (p.mp.j * p.theta)


def effective(p: Any) -> Number:
    """Environment seen through its coupling."""
    return series(environment(p), coupling_tustin(p))


def perceived(device: Formula, zoh: Formula, shown: Formula) -> Formula:
    """Eqs 11 and 13: a device, and what the hold shows of the rest."""
    return lambda p: device(p) + zoh(p) * shown(p)


direct = perceived(rigid, hold_average, environment)
direct_flexible_true = perceived(flexible, hold_true, environment)
coupled = perceived(rigid, hold_average, effective)
coupled_backward = perceived(
    rigid, hold_average, lambda p: series(environment(p), coupling_backward(p))
)


def magnitude(p: Any) -> Number:
    """abs(Z_h) with a negative stiffness and a negative damping, as limits may be."""
    return abs(rigid(p) + hold_average(p) * (p.m_e * p.s - p.b_e - p.k_e / p.s))


def box_lower(p: Any) -> Number:
    """Lowest abs(Z_h) over k in [−k_e, k_c], b in [−b_e, b_c]: zero inside, else on an edge or a corner."""
    zoh = hold_average(p)
    base = rigid(p) / zoh + p.m_e * p.s
    rate = p.s.imag
    near_b = min(max(-base.real, -p.b_e), p.b_c)
    near_k = min(max(base.imag * rate, -p.k_e), p.k_c)
    return abs(zoh * (base + near_b - p.mp.j * near_k / rate))


def box_upper(p: Any) -> Number:
    """Highest abs(Z_h) over the same box."""
    return max(
        abs(rigid(p) + hold_average(p) * (p.m_e * p.s + b + k / p.s))
        for b in (-p.b_e, p.b_c)
        for k in (-p.k_e, p.k_c)
    )


def required_at(coupling: Formula, zoh: Formula) -> Formula:
    """Eq. 10 solved for Re Z_d."""

    def formula(p: Any) -> Number:
        z_c = coupling(p)
        if z_c == 0:
            return p.mp.mpf(0)
        admittance = (1 / z_c).real
        needed = abs(zoh(p)) - zoh(p).real
        return p.mp.inf if admittance == 0 else needed / (2 * admittance)

    return formula


def margin(p: Any) -> Number:
    """Re Z_d of a device with a mode over what Eq. 10 asks for."""
    required = required_at(coupling_backward, hold_average)(p)
    return p.mp.inf if required == 0 else flexible(p).real / required


def required(p: Any) -> Number:
    """Largest of βy(1 − y)/2 + K²y³/(8β(1 + y)) over y, its slope set to zero by bisection."""
    stretch = p.k_c * p.period
    return largest_required(p.mp, stretch, p.b_c + stretch / 2)


def largest_required(mp: Any, stretch: Number, beta: Number) -> Number:
    """Return the maximum over y in [0, 1]."""
    if beta == 0:
        return mp.inf if stretch else mp.mpf(0)

    def value(y: Number) -> Number:
        return beta * y * (1 - y) / 2 + stretch**2 * y**3 / (8 * beta * (1 + y))

    def slope(y: Number) -> Number:
        return beta * (1 - 2 * y) / 2 + stretch**2 * (3 * y**2 + 2 * y**3) / (
            8 * beta * (1 + y) ** 2
        )

    if slope(mp.mpf(1)) >= 0:
        return value(mp.mpf(1))
    # An error in y enters the maximum squared.
    return value(
        mp.findroot(
            slope, (mp.mpf("0.5") - mp.mpf("1e-9"), mp.mpf(1)), solver="anderson", tol=1e-90
        )
    )
