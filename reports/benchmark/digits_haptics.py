"""Digits the haptics formulas keep, against their textbook forms in 120-digit arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
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
from percept.haptics.impedance import coupling_admittance
from percept.haptics.perceived import perceived_magnitude
from reports.benchmark import twins as twin
from reports.benchmark.digits import Digits, digits_row

PROMISE = 1e-13  # Largest relative error per unit of the formula's condition

_SLOWEST = 1e-9  # rad/s
_WIDE = 15  # Decades on either side of 1 that parameters are drawn from
_USUAL = 2  # The same for sizes met in practice, whose terms meet and cancel
_ABSENT = 0.03  # Probability that a parameter is zero
_AT_NYQUIST = 0.02  # Probability that ωT is π
_LONGEST_DELAY = 8.0  # Samples


@dataclass(frozen=True)
class Inputs:
    """Values that formulas take, in SI units."""

    omega: float
    period: float
    m: float
    b_d: float
    k_e: float
    b_e: float
    m_e: float
    k_c: float
    b_c: float
    m_i: float
    b_i: float
    k_i: float
    delay: float = 0.0  # Samples
    k_d: float = 0.0  # Of the device's spring

    def loop(self, hold: str = "average", *, late: bool = False) -> Loop:
        """Return a rigid device in a loop, delayed or not."""
        delay = self.delay if late else 0.0
        return Loop(Device(self.m, self.b_d), self.period, hold, delay=delay)

    def flexible(self, hold: str = "average") -> Loop:
        """Return the same device with one mode and a spring."""
        mode = Mode(self.m_i, self.k_i, self.b_i)
        device = Device(self.m, self.b_d, (mode,), self.k_d)
        return replace(self.loop(hold), device=device)

    @property
    def environment(self) -> Environment:
        """What is shown."""
        return Environment(self.k_e, self.b_e, self.m_e)

    @property
    def coupling(self) -> Coupling:
        """Between device and environment."""
        return Coupling(self.k_c, self.b_c)

    @property
    def at_nyquist(self) -> bool:
        """Whether ωT is π."""
        return twin.is_nyquist(self.omega * self.period)


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
    # Delays and the device's spring have a stream of their own: all else is drawn as without them.
    delays = np.random.default_rng([seed, 1])
    for inputs in _cases(cases, np.random.default_rng(seed), delays):
        decade = int(np.floor(np.log10(inputs.omega * inputs.period)))
        if inputs.at_nyquist:
            decade = 1
        for name in quantities or QUANTITIES:
            error = error_of(name, inputs)
            errors.setdefault((name, decade), []).append(error)
    rows = []
    for (name, decade), of_cases in sorted(errors.items()):
        rows.append(digits_row(name, "decade of ωT", decade, of_cases, PROMISE))
    return rows


def _cases(count: int, rng: np.random.Generator, delays: np.random.Generator) -> Iterator[Inputs]:
    """Yield sets of parameters, all drawn on the log scale."""
    by_delays = ("delay", "k_d")
    names = [field.name for field in fields(Inputs)[2:] if field.name not in by_delays]
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
        values = {name: float(10 ** rng.uniform(-decades, decades)) for name in names}
        for name in names:
            if rng.uniform() < _ABSENT:
                values[name] = 0.0
        delay = delays.uniform(0, _LONGEST_DELAY)
        k_d = float(10 ** delays.uniform(-decades, decades))
        yield Inputs(max(omega, _SLOWEST), period, **values, delay=delay, k_d=k_d)


def _z_h(v: Inputs, loop: Loop) -> Any:
    return perceived_impedance(loop, v.omega, v.environment)


def _coupled(v: Inputs, loop: Loop, discretization: str = "tustin") -> Any:
    return perceived_impedance(
        loop, v.omega, v.environment, coupling=v.coupling, discretization=discretization
    )


def _effective(v: Inputs) -> Any:
    stiffness, damping = effective_impedance(v.loop(), v.omega, v.environment, v.coupling)
    return complex_from(damping, v.loop().at(v.omega).spring(stiffness))


def _box(v: Inputs) -> tuple[Any, Any]:
    k = (-v.k_e, v.k_c)
    b = (-v.b_e, v.b_c)
    return magnitude_envelope(v.loop(), v.omega, k, b, mass=v.m_e)


def _required_at(v: Inputs, loop: Loop, discretization: str = "backward") -> Any:
    return required_damping_at(loop, v.omega, v.coupling, discretization=discretization)


def _stiffness_limit(v: Inputs) -> float:
    """Return the error of the damping that the largest k_c needs, over its condition."""
    limit = float(max_coupling_stiffness(v.loop(), v.b_c))
    if np.isnan(limit):
        return float("inf")
    if limit == 0.0:
        # A coupling without a spring needs an eighth of its damping.
        return 0.0 if v.b_c / 8 >= v.b_d * (1 - 1e-15) else float("inf")
    inputs = vars(replace(v, k_c=limit))
    return twin.error_over_condition(v.b_d, twin.required, inputs)


Computed = Callable[[Inputs], Any]

_LIMIT = "largest stiffness"
_PAIRS: dict[str, tuple[Computed, twin.Formula]] = {
    "Z_d": (lambda v: device_impedance(v.loop(), v.omega), twin.rigid),
    "Z_d, flexible": (lambda v: device_impedance(v.flexible(), v.omega), twin.flexible),
    "Z_e": (lambda v: environment_impedance(v.loop(), v.omega, v.environment), twin.environment),
    "Z_c, Eq. 6": (
        lambda v: coupling_impedance(v.loop(), v.omega, v.coupling),
        twin.coupling_backward,
    ),
    "1/Z_c, Eq. 6": (
        lambda v: coupling_admittance(v.loop(), v.omega, v.coupling),
        twin.admittance_backward,
    ),
    "ZOH, Eq. 8": (lambda v: hold(v.loop(), v.omega), twin.hold_average),
    "ZOH, true": (lambda v: hold(v.loop("true"), v.omega), twin.hold_true),
    "Z_eff": (_effective, twin.effective),
    "Re Z_eff": (
        lambda v: effective_impedance(v.loop(), v.omega, v.environment, v.coupling).damping,
        twin.effective_damping,
    ),
    "Z_h": (lambda v: _z_h(v, v.loop()), twin.direct),
    "Z_h, flexible, true hold": (
        lambda v: _z_h(v, v.flexible("true")),
        twin.direct_flexible_true,
    ),
    "Z_h_vc, Eq. 12": (lambda v: _coupled(v, v.loop()), twin.coupled),
    "Z_h_vc, Eq. 6": (lambda v: _coupled(v, v.loop(), "backward"), twin.coupled_backward),
    "abs(Z_h), k and b negative": (
        lambda v: perceived_magnitude(v.loop(), v.omega, -v.k_e, -v.b_e, mass=v.m_e),
        twin.magnitude,
    ),
    "ZOH, delayed": (lambda v: hold(v.loop(late=True), v.omega), twin.late(twin.hold_average)),
    "box, upper": (lambda v: _box(v)[1], twin.box_upper),
    "box, lower": (lambda v: _box(v)[0], twin.box_lower),
    "required damping at ω": (
        lambda v: _required_at(v, v.loop()),
        twin.required_at(twin.coupling_backward, twin.hold_average),
    ),
    "required damping at ω, true hold": (
        lambda v: _required_at(v, v.loop("true"), "tustin"),
        twin.required_at(twin.coupling_tustin, twin.hold_true),
    ),
    "stability margin": (
        lambda v: stability_margin(v.flexible(), v.omega, v.coupling),
        twin.margin,
    ),
    "required damping": (
        lambda v: required_damping(v.loop(), v.coupling).damping,
        twin.required,
    ),
}
#: What is compared.
QUANTITIES = (*_PAIRS, _LIMIT)


def error_of(name: str, v: Inputs) -> float:
    """Return the error of a quantity over its condition."""
    if name == _LIMIT:
        return _stiffness_limit(v)
    ours, exact = _PAIRS[name]
    return twin.error_over_condition(ours(v), exact, vars(v), at_nyquist=v.at_nyquist)
