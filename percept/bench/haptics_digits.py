"""Digits the haptics formulas keep, against their textbook forms in 120-digit arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from percept.bench import _haptics_reference as reference
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Mode,
    coupling_admittance,
    coupling_impedance,
    device_impedance,
    effective_impedance,
    environment_impedance,
    hold,
    magnitude_envelope,
    max_coupling_stiffness,
    perceived_impedance,
    perceived_magnitude,
    required_damping,
    required_damping_at,
    stability_margin,
    velocity_ratio,
)

PROMISE = 1e-13
"""Largest relative error promised, per unit of the formula's condition."""

Values: TypeAlias = Mapping[str, float]


@dataclass(frozen=True)
class Digits:
    """The worst case of one quantity in one decade of ωT."""

    quantity: str  # What was computed
    decade: int  # floor(log10(ωT))
    cases: int  # How many were compared
    worst: float  # Largest relative error over `PROMISE`·max(1, condition)
    digits: float
    direct: float | None
    typical: float | None  # Median over the cases of the digits that formula keeps


def digits_kept(
    cases: int = 20_000, *, seed: int = 20_240_501, quantities: tuple[str, ...] = ()
) -> tuple[Digits, ...]:
    """Compare every quantity with 120-digit arithmetic on random cases.

    ω runs from 1e-9 rad/s to Nyquist (included, and approached to within 1e-15), T from 1e-6 to 1 s,
    parameters over thirty decades, now and then zero. Needs mpmath.
    """
    found: dict[tuple[str, int], list[list[float]]] = {}
    chosen = {name: QUANTITIES[name] for name in quantities or QUANTITIES}
    for values in _cases(cases, np.random.default_rng(seed)):
        theta = values["omega"] * values["period"]
        at_nyquist = reference.is_nyquist(theta)
        decade = 1 if at_nyquist else int(np.floor(np.log10(theta)))
        for name, check in chosen.items():
            found.setdefault((name, decade), []).append(check(values, at_nyquist))
    rows = []
    for (name, decade), errors in sorted(found.items()):
        ours, *direct = zip(*errors, strict=True)
        rows.append(
            Digits(
                quantity=name,
                decade=decade,
                cases=len(errors),
                worst=max(ours) / PROMISE,
                digits=_digits(max(ours)),
                direct=_digits(max(direct[0])) if direct else None,
                typical=_digits(float(np.median(direct[0]))) if direct else None,
            )
        )
    return tuple(rows)


def _digits(error: float) -> float:
    return float(np.clip(-np.log10(max(error, 1e-300)), 0.0, 16.0))


def _cases(count: int, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    """Yield sets of parameters, all drawn on the log scale."""
    names = ("m", "b_d", "k_e", "b_e", "m_e", "k_c", "b_c", "m_i", "b_i", "k_i")
    for _ in range(count):
        period = 10 ** rng.uniform(-6, 0)
        nyquist = np.pi / period
        where = rng.integers(5)
        if where == 0:
            omega = nyquist * (1 - 10 ** rng.uniform(-15, 0))
        elif where == 1:
            omega = nyquist * rng.uniform(0, 1)
        else:
            omega = float(np.exp(rng.uniform(np.log(1e-9), np.log(nyquist))))
        if rng.uniform() < 0.02:
            omega = nyquist
        # Half of the cases are of a size met in practice, so that terms of one impedance meet and cancel.
        spread = 15 if rng.uniform() < 0.5 else 2
        values = {name: float(10 ** rng.uniform(-spread, spread)) for name in names}
        for name in names:
            if rng.uniform() < 0.03:
                values[name] = 0.0
        yield {"omega": max(omega, 1e-9), "period": period, **values}


def _device(v: Values) -> Device:
    return Device(v["m"], v["b_d"])


def _flexible(v: Values) -> Device:
    return Device(v["m"], v["b_d"], (Mode(v["m_i"], v["k_i"], v["b_i"]),))


def _environment(v: Values) -> Environment:
    return Environment(v["k_e"], v["b_e"], v["m_e"])


def _coupling(v: Values) -> Coupling:
    return Coupling(v["k_c"], v["b_c"])


def _at(v: Values) -> tuple[float, float]:
    return v["omega"], v["period"]


def _direct(v: Values) -> Any:
    return perceived_impedance(v["omega"], _device(v), _environment(v), v["period"])


def _direct_flexible_true(v: Values) -> Any:
    return perceived_impedance(v["omega"], _flexible(v), _environment(v), v["period"], hold="true")


def _coupled(discretization: str) -> Callable[[Values], Any]:
    def ours(v: Values) -> Any:
        return perceived_impedance(
            v["omega"],
            _device(v),
            _environment(v),
            v["period"],
            coupling=_coupling(v),
            discretization=discretization,
        )

    return ours


def _magnitude(v: Values) -> Any:
    return perceived_magnitude(v["omega"], _device(v), -v["k_e"], -v["b_e"], v["period"], mass=v["m_e"])


def _box(v: Values) -> tuple[Any, Any]:
    limits = (-v["k_e"], v["k_c"]), (-v["b_e"], v["b_c"])
    return magnitude_envelope(v["omega"], _device(v), *limits, v["period"], mass=v["m_e"])


def _required_at(discretization: str, kind: str) -> Callable[[Values], Any]:
    def ours(v: Values) -> Any:
        omega, period = _at(v)
        return required_damping_at(omega, _coupling(v), period, discretization=discretization, hold=kind)

    return ours


_RIGID = ("omega", "period", "m", "b_d")
_FLEXIBLE = (*_RIGID, "m_i", "b_i", "k_i")
_ENVIRONMENT = ("k_e", "b_e", "m_e")
_COUPLING = ("k_c", "b_c")
_W = ("omega", "period")

#: Errors of percept and, but for quantities that are searched for, of the textbook's formula in doubles.
Check: TypeAlias = Callable[[Values, bool], list[float]]


def _check(
    ours: Callable[[Values], Any],
    exact: reference.Formula,
    inputs: tuple[str, ...],
    *,
    searched: bool = False,
) -> Check:
    def errors(v: Values, at_nyquist: bool) -> list[float]:
        own = {key: v[key] for key in inputs}
        computed = [ours(v)] if searched else [ours(v), reference.in_doubles(exact, own)]
        return reference.errors_over_condition(computed, exact, own, at_nyquist=at_nyquist)

    return errors


def _stiffness_limit(v: Values, at_nyquist: bool) -> list[float]:
    limit = max_coupling_stiffness(v["b_d"], v["b_c"], v["period"])
    return [reference.limit_error_over_condition(float(limit), v["b_d"], v["b_c"], v["period"])]


QUANTITIES: dict[str, Check] = {
    "Z_d": _check(lambda v: device_impedance(v["omega"], _device(v), v["period"]), reference.rigid, _RIGID),
    "Z_d, flexible": _check(
        lambda v: device_impedance(v["omega"], _flexible(v), v["period"]),
        reference.flexible,
        _FLEXIBLE,
    ),
    "Z_e": _check(
        lambda v: environment_impedance(v["omega"], _environment(v), v["period"]),
        reference.environment,
        (*_W, *_ENVIRONMENT),
    ),
    "Z_c, Eq. 6": _check(
        lambda v: coupling_impedance(v["omega"], _coupling(v), v["period"]),
        reference.coupling_backward,
        (*_W, *_COUPLING),
    ),
    "1/Z_c, Eq. 6": _check(
        lambda v: coupling_admittance(v["omega"], _coupling(v), v["period"]),
        reference.admittance_backward,
        (*_W, *_COUPLING),
    ),
    "ZOH, Eq. 8": _check(lambda v: hold(*_at(v)), reference.hold_average, _W),
    "ZOH, true": _check(lambda v: hold(*_at(v), kind="true"), reference.hold_true, _W),
    "v_e/v_h": _check(
        lambda v: velocity_ratio(v["omega"], _environment(v), _coupling(v), v["period"]),
        reference.velocity_ratio,
        (*_W, *_ENVIRONMENT, *_COUPLING),
    ),
    "Z_eff": _check(
        lambda v: effective_impedance(v["omega"], _environment(v), _coupling(v), v["period"]).value,
        reference.effective,
        (*_W, *_ENVIRONMENT, *_COUPLING),
    ),
    "Re Z_eff": _check(
        lambda v: effective_impedance(v["omega"], _environment(v), _coupling(v), v["period"]).damping,
        lambda p: p.mp.mpc(reference.effective(p)).real,
        (*_W, *_ENVIRONMENT, *_COUPLING),
    ),
    "Z_h": _check(_direct, reference.direct, (*_RIGID, *_ENVIRONMENT)),
    "Z_h, flexible, true hold": _check(
        _direct_flexible_true,
        reference.direct_flexible_true,
        (*_FLEXIBLE, *_ENVIRONMENT),
    ),
    "Z_h_vc, Eq. 12": _check(_coupled("tustin"), reference.coupled, (*_RIGID, *_ENVIRONMENT, *_COUPLING)),
    "Z_h_vc, Eq. 6": _check(
        _coupled("backward"), reference.coupled_backward, (*_RIGID, *_ENVIRONMENT, *_COUPLING)
    ),
    "abs(Z_h), k and b negative": _check(_magnitude, reference.magnitude, (*_RIGID, *_ENVIRONMENT)),
    "box, upper": _check(
        lambda v: _box(v)[1],
        reference.box_upper,
        (*_RIGID, *_ENVIRONMENT, *_COUPLING),
    ),
    "box, lower": _check(
        lambda v: _box(v)[0],
        reference.box_lower,
        (*_RIGID, *_ENVIRONMENT, *_COUPLING),
    ),
    "required damping at ω": _check(
        _required_at("backward", "average"),
        reference.required_at(reference.coupling_backward, reference.hold_average),
        (*_W, *_COUPLING),
    ),
    "required damping at ω, true hold": _check(
        _required_at("tustin", "true"),
        reference.required_at(reference.coupling_tustin, reference.hold_true),
        (*_W, *_COUPLING),
    ),
    "stability margin": _check(
        lambda v: stability_margin(v["omega"], _flexible(v), _coupling(v), v["period"]),
        reference.margin,
        (*_FLEXIBLE, *_COUPLING),
    ),
    "required damping": _check(
        lambda v: required_damping(_coupling(v), v["period"]).damping,
        reference.required,
        (*_W, *_COUPLING),
        searched=True,
    ),
    "largest stiffness": _stiffness_limit,
}
