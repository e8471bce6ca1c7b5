"""Digits the haptics formulas keep, against their textbook forms in 120-digit arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np

from percept.bench import twins as twin
from percept.bench.digits import Digits, digits_row
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Mode,
    coupling_impedance,
    device_impedance,
    effective_impedance,
    environment_impedance,
    hold,
    magnitude_envelope,
    max_coupling_stiffness,
    perceived_impedance,
    required_damping,
    required_damping_at,
    stability_margin,
)
from percept.haptics.arrays import complex_from
from percept.haptics.impedance import coupling_admittance, warp
from percept.haptics.perceived import perceived_magnitude

PROMISE = 1e-13  # largest relative error per unit of the formula's condition
_NAMES = ("m", "b_d", "k_e", "b_e", "m_e", "k_c", "b_c", "m_i", "b_i", "k_i")

Values: TypeAlias = Mapping[str, float]
Computed: TypeAlias = Callable[[Values], Any]
#: Error over condition, given the values and whether ωT is π.
Check: TypeAlias = Callable[[Values, bool], float]


def haptics_digits(
    cases: int = 2000, *, seed: int = 20_240_501, quantities: tuple[str, ...] = ()
) -> list[Digits]:
    """Compare every quantity with 120-digit arithmetic on random cases, by decade of ωT.

    ω runs from 1e-9 rad/s to Nyquist (included, and approached to within 1e-15), T from 1e-6 to 1
    s, parameters over thirty decades, now and then zero.
    """
    errors: dict[tuple[str, int], list[float]] = {}
    for values in _cases(cases, np.random.default_rng(seed)):
        theta = values["omega"] * values["period"]
        at_nyquist = twin.is_nyquist(theta)
        decade = 1 if at_nyquist else int(np.floor(np.log10(theta)))
        for name in quantities or QUANTITIES:
            errors.setdefault((name, decade), []).append(QUANTITIES[name](values, at_nyquist))
    return [
        digits_row(name, "decade of ωT", decade, found, PROMISE)
        for (name, decade), found in sorted(errors.items())
    ]


def _cases(count: int, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    """Yield sets of parameters, all drawn on the log scale."""
    for _ in range(count):
        period = 10 ** rng.uniform(-6, 0)
        nyquist = np.pi / period
        way = rng.integers(5)
        if way == 0:
            omega = nyquist * (1 - 10 ** rng.uniform(-15, 0))
        elif way == 1:
            omega = nyquist * rng.uniform(0, 1)
        else:
            omega = float(np.exp(rng.uniform(np.log(1e-9), np.log(nyquist))))
        if rng.uniform() < 0.02:
            omega = nyquist
        # Half of the cases are of a size met in practice, so that terms of one impedance meet and
        # cancel.
        decades = 15 if rng.uniform() < 0.5 else 2
        values = {name: float(10 ** rng.uniform(-decades, decades)) for name in _NAMES}
        values |= {name: 0.0 for name in _NAMES if rng.uniform() < 0.03}
        yield {"omega": max(omega, 1e-9), "period": period, **values}


def _device(v: Values) -> Device:
    return Device(v["m"], v["b_d"])


def _flexible(v: Values) -> Device:
    return Device(v["m"], v["b_d"], (Mode(v["m_i"], v["k_i"], v["b_i"]),))


def _environment(v: Values) -> Environment:
    return Environment(v["k_e"], v["b_e"], v["m_e"])


def _coupling(v: Values) -> Coupling:
    return Coupling(v["k_c"], v["b_c"])


def _at(function: Callable[..., Any], *makes: Callable[[Values], Any], **options: Any) -> Computed:
    """Call a function of ω, of what `makes` makes of the values, and of T."""
    return lambda v: function(v["omega"], *(make(v) for make in makes), v["period"], **options)


def _coupled(discretization: str) -> Computed:
    return lambda v: perceived_impedance(
        v["omega"], _device(v), _environment(v), v["period"],
        coupling=_coupling(v), discretization=discretization,
    )  # fmt: skip


def _magnitude(v: Values) -> Any:
    return perceived_magnitude(
        v["omega"], _device(v), -v["k_e"], -v["b_e"], v["period"], mass=v["m_e"]
    )


def _box(v: Values) -> tuple[Any, Any]:
    k, b = (-v["k_e"], v["k_c"]), (-v["b_e"], v["b_c"])
    return magnitude_envelope(v["omega"], _device(v), k, b, v["period"], mass=v["m_e"])


def _check(ours: Computed, exact: twin.Formula, inputs: tuple[str, ...]) -> Check:
    def error(v: Values, at_nyquist: bool) -> float:
        own = {key: v[key] for key in inputs}
        return twin.error_over_condition(ours(v), exact, own, at_nyquist=at_nyquist)

    return error


def _stiffness_limit(v: Values, at_nyquist: bool) -> float:
    limit = max_coupling_stiffness(v["b_d"], v["b_c"], v["period"])
    return twin.limit_error_over_condition(float(limit), v["b_d"], v["b_c"], v["period"])


_W = ("omega", "period")
_RIGID, _FLEXIBLE = (*_W, "m", "b_d"), (*_W, "m", "b_d", "m_i", "b_i", "k_i")
_ENV, _VC = ("k_e", "b_e", "m_e"), ("k_c", "b_c")
_COUPLED, _DIRECT, _ALL = (*_W, *_VC), (*_RIGID, *_ENV), (*_RIGID, *_ENV, *_VC)
_EFFECTIVE = _at(effective_impedance, _environment, _coupling)


def _effective(v: Values) -> Any:
    stiffness, damping = _EFFECTIVE(v)
    return complex_from(damping, warp(v["omega"], v["period"]).spring(stiffness))


QUANTITIES: dict[str, Check] = {
    "Z_d": _check(_at(device_impedance, _device), twin.rigid, _RIGID),
    "Z_d, flexible": _check(_at(device_impedance, _flexible), twin.flexible, _FLEXIBLE),
    "Z_e": _check(_at(environment_impedance, _environment), twin.environment, (*_W, *_ENV)),
    "Z_c, Eq. 6": _check(_at(coupling_impedance, _coupling), twin.coupling_backward, _COUPLED),
    "1/Z_c, Eq. 6": _check(_at(coupling_admittance, _coupling), twin.admittance_backward, _COUPLED),
    "ZOH, Eq. 8": _check(_at(hold), twin.hold_average, _W),
    "ZOH, true": _check(_at(hold, kind="true"), twin.hold_true, _W),
    "Z_eff": _check(_effective, twin.effective, (*_W, *_ENV, *_VC)),
    "Re Z_eff": _check(
        lambda v: _EFFECTIVE(v)[1], lambda p: p.mp.mpc(twin.effective(p)).real, (*_W, *_ENV, *_VC)
    ),
    "Z_h": _check(_at(perceived_impedance, _device, _environment), twin.direct, _DIRECT),
    "Z_h, flexible, true hold": _check(
        _at(perceived_impedance, _flexible, _environment, hold="true"),
        twin.direct_flexible_true,
        (*_FLEXIBLE, *_ENV),
    ),
    "Z_h_vc, Eq. 12": _check(_coupled("tustin"), twin.coupled, _ALL),
    "Z_h_vc, Eq. 6": _check(_coupled("backward"), twin.coupled_backward, _ALL),
    "abs(Z_h), k and b negative": _check(_magnitude, twin.magnitude, _DIRECT),
    "box, upper": _check(lambda v: _box(v)[1], twin.box_upper, _ALL),
    "box, lower": _check(lambda v: _box(v)[0], twin.box_lower, _ALL),
    "required damping at ω": _check(
        _at(required_damping_at, _coupling, discretization="backward", hold="average"),
        twin.required_at(twin.coupling_backward, twin.hold_average),
        _COUPLED,
    ),
    "required damping at ω, true hold": _check(
        _at(required_damping_at, _coupling, discretization="tustin", hold="true"),
        twin.required_at(twin.coupling_tustin, twin.hold_true),
        _COUPLED,
    ),
    "stability margin": _check(
        _at(stability_margin, _flexible, _coupling), twin.margin, (*_FLEXIBLE, *_VC)
    ),
    "required damping": _check(
        lambda v: required_damping(_coupling(v), v["period"]).damping, twin.required, _COUPLED
    ),
    "largest stiffness": _stiffness_limit,
}
