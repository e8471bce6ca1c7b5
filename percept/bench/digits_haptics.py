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

__all__ = ["PROMISE", "QUANTITIES", "haptics_digits"]

PROMISE = 1e-13  # Largest relative error per unit of the formula's condition

_NAMES = ("m", "b_d", "k_e", "b_e", "m_e", "k_c", "b_c", "m_i", "b_i", "k_i")
_SLOWEST = 1e-9  # rad/s
_WIDE = 15  # Decades on either side of 1 that parameters are drawn from
_USUAL = 2  # The same for sizes met in practice, whose terms meet and cancel
_ABSENT = 0.03  # Probability that a parameter is zero
_AT_NYQUIST = 0.02  # Probability that ωT is π

Values: TypeAlias = Mapping[str, float]
Computed: TypeAlias = Callable[[Values], Any]
#: Error over condition, given the values and whether ωT is π.
Check: TypeAlias = Callable[[Values, bool], float]

#: What is compared, by name.
QUANTITIES: dict[str, Check] = {}


def haptics_digits(
    cases: int = 2000, *, seed: int = 20_240_501, quantities: tuple[str, ...] = ()
) -> list[Digits]:
    """Compare quantities with 120-digit arithmetic on random cases, by decade of ωT.

    ω runs from 1e-9 rad/s to Nyquist (included, and approached to within 1e-15), T from 1e-6 to 1
    s, parameters over thirty decades, now and then zero.

    Parameters
    ----------
    cases : int
        Sets of parameters.
    seed : int
        Of the sets.
    quantities : tuple of str, optional
        Of `QUANTITIES`; all of them by default.

    Returns
    -------
    list of Digits
        A row for each quantity and decade.
    """
    errors: dict[tuple[str, int], list[float]] = {}
    for values in _cases(cases, np.random.default_rng(seed)):
        theta = values["omega"] * values["period"]
        at_nyquist = twin.is_nyquist(theta)
        decade = 1 if at_nyquist else int(np.floor(np.log10(theta)))
        for name in quantities or QUANTITIES:
            error = QUANTITIES[name](values, at_nyquist)
            errors.setdefault((name, decade), []).append(error)
    rows = []
    for (name, decade), of_cases in sorted(errors.items()):
        rows.append(digits_row(name, "decade of ωT", decade, of_cases, PROMISE))
    return rows


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
            omega = float(np.exp(rng.uniform(np.log(_SLOWEST), np.log(nyquist))))
        if rng.uniform() < _AT_NYQUIST:
            omega = nyquist
        decades = _WIDE if rng.uniform() < 0.5 else _USUAL
        values = {name: float(10 ** rng.uniform(-decades, decades)) for name in _NAMES}
        for name in _NAMES:
            if rng.uniform() < _ABSENT:
                values[name] = 0.0
        yield {"omega": max(omega, _SLOWEST), "period": period, **values}


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


def _coupled(v: Values, discretization: str) -> Any:
    return perceived_impedance(
        v["omega"],
        _device(v),
        _environment(v),
        v["period"],
        coupling=_coupling(v),
        discretization=discretization,
    )


def _effective(v: Values) -> Any:
    stiffness, damping = _effective_parts(v)
    return complex_from(damping, warp(v["omega"], v["period"]).spring(stiffness))


def _effective_parts(v: Values) -> Any:
    return effective_impedance(v["omega"], _environment(v), _coupling(v), v["period"])


def _effective_damping(v: Values) -> Any:
    _, damping = _effective_parts(v)
    return damping


def _magnitude(v: Values) -> Any:
    k = -v["k_e"]
    b = -v["b_e"]
    return perceived_magnitude(v["omega"], _device(v), k, b, v["period"], mass=v["m_e"])


def _box(v: Values) -> tuple[Any, Any]:
    k = (-v["k_e"], v["k_c"])
    b = (-v["b_e"], v["b_c"])
    return magnitude_envelope(v["omega"], _device(v), k, b, v["period"], mass=v["m_e"])


def _damping_for_all(v: Values) -> Any:
    return required_damping(_coupling(v), v["period"]).damping


def _stiffness_limit(v: Values, at_nyquist: bool) -> float:
    limit = max_coupling_stiffness(v["b_d"], v["b_c"], v["period"])
    return twin.limit_error_over_condition(float(limit), v["b_d"], v["b_c"], v["period"])


def _compare(name: str, ours: Computed, exact: twin.Formula, inputs: tuple[str, ...]) -> None:
    """Put a quantity of ours beside its exact formula of some inputs."""

    def error(v: Values, at_nyquist: bool) -> float:
        own = {key: v[key] for key in inputs}
        return twin.error_over_condition(ours(v), exact, own, at_nyquist=at_nyquist)

    QUANTITIES[name] = error


_W = ("omega", "period")
_SHOWN = ("k_e", "b_e", "m_e")
_VC = ("k_c", "b_c")
_RIGID = (*_W, "m", "b_d")
_FLEXIBLE = (*_RIGID, "m_i", "b_i", "k_i")
_ENVIRONMENT = (*_W, *_SHOWN)
_COUPLING = (*_W, *_VC)
_DIRECT = (*_RIGID, *_SHOWN)
_EFFECTIVE = (*_W, *_SHOWN, *_VC)
_ALL = (*_DIRECT, *_VC)

_compare("Z_d", _at(device_impedance, _device), twin.rigid, _RIGID)
_compare("Z_d, flexible", _at(device_impedance, _flexible), twin.flexible, _FLEXIBLE)
_compare("Z_e", _at(environment_impedance, _environment), twin.environment, _ENVIRONMENT)
_compare("Z_c, Eq. 6", _at(coupling_impedance, _coupling), twin.coupling_backward, _COUPLING)
_compare("1/Z_c, Eq. 6", _at(coupling_admittance, _coupling), twin.admittance_backward, _COUPLING)
_compare("ZOH, Eq. 8", _at(hold), twin.hold_average, _W)
_compare("ZOH, true", _at(hold, kind="true"), twin.hold_true, _W)
_compare("Z_eff", _effective, twin.effective, _EFFECTIVE)
_compare("Re Z_eff", _effective_damping, twin.effective_damping, _EFFECTIVE)
_compare("Z_h", _at(perceived_impedance, _device, _environment), twin.direct, _DIRECT)
_compare(
    "Z_h, flexible, true hold",
    _at(perceived_impedance, _flexible, _environment, hold="true"),
    twin.direct_flexible_true,
    (*_FLEXIBLE, *_SHOWN),
)
_compare("Z_h_vc, Eq. 12", lambda v: _coupled(v, "tustin"), twin.coupled, _ALL)
_compare("Z_h_vc, Eq. 6", lambda v: _coupled(v, "backward"), twin.coupled_backward, _ALL)
_compare("abs(Z_h), k and b negative", _magnitude, twin.magnitude, _DIRECT)
_compare("box, upper", lambda v: _box(v)[1], twin.box_upper, _ALL)
_compare("box, lower", lambda v: _box(v)[0], twin.box_lower, _ALL)
_compare(
    "required damping at ω",
    _at(required_damping_at, _coupling, discretization="backward", hold="average"),
    twin.required_at(twin.coupling_backward, twin.hold_average),
    _COUPLING,
)
_compare(
    "required damping at ω, true hold",
    _at(required_damping_at, _coupling, discretization="tustin", hold="true"),
    twin.required_at(twin.coupling_tustin, twin.hold_true),
    _COUPLING,
)
_compare(
    "stability margin",
    _at(stability_margin, _flexible, _coupling),
    twin.margin,
    (*_FLEXIBLE, *_VC),
)
_compare("required damping", _damping_for_all, twin.required, _COUPLING)
QUANTITIES["largest stiffness"] = _stiffness_limit
