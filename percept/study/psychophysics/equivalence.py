"""Whether a bias is smaller than one JND: what a JND is, and the verdict of both methods."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from percept.inference.classical.contrasts import tost
from percept.inference.record import FloatOrArray, Method
from percept.results import EquivalenceRow, Skipped
from percept.results.psychophysics import Equivalence
from percept.sessions.quantities import amount_in
from percept.study.basics import Array
from percept.study.data import Data

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Monte Carlo errors by which a probability must pass the one that decides.
_SURE = 2.0


@dataclass(frozen=True)
class Limits:
    """Values one JND below and above a reference."""

    reference: float  # In the quantity's unit
    jnd: float  # In the quantity's unit, above zero

    def ends(self, *, log: bool) -> tuple[float, float]:
        """Both limits in the quantity's unit, or their logarithms."""
        lower = self.reference - self.jnd
        upper = self.reference + self.jnd
        if not log:
            return lower, upper
        # No positive value lies a whole reference below it.
        return math.log(lower) if lower > 0.0 else -math.inf, math.log(upper)


def limits_of(data: Data, parameter: str, environment: str) -> Limits | Skipped:
    """Return the limits in an environment, or why there are none; not of a JND from trials."""
    quantity = data.quantities[parameter]
    jnd = data.scene.study.jnd[parameter]
    reference = data.reference[parameter, environment]
    what = f"whether {quantity.label} of {environment} is within one JND"
    if math.isnan(reference):
        return Skipped(what, "there is no reference")
    if isinstance(jnd, str):
        return Limits(reference, amount_in(quantity, jnd))
    if reference == 0.0:
        return Skipped(what, "a fraction of a reference of zero is zero; give the JND in its unit")
    return Limits(reference, jnd * abs(reference))


def classical_equivalence(data: Data) -> Iterator[EquivalenceRow | Skipped]:
    """Yield two one-sided tests of size 1 - decision, environment by environment."""
    asked = data.asked
    for cell in data.cells[asked.family]:
        jnd = data.scene.study.jnd.get(cell.parameter)
        if jnd is None:
            continue
        what = f"classical verdict whether {cell.quantity.label} is within one JND"
        if jnd == "trials":
            yield Skipped(what, "a JND from trials has an error that the tests do not know")
            continue
        if cell.moments is None:
            yield Skipped(f"{what} in {cell.environment}", cell.why)
            continue
        limits = limits_of(data, cell.parameter, cell.environment)
        if isinstance(limits, Skipped):
            yield limits
            continue
        ends = limits.ends(log=asked.family == "lognormal")
        tests = tost(cell.moments.on_scale(asked.family), *ends)
        p_values = float(tests.p_within), float(tests.p_beyond)
        size = 1.0 - asked.decision
        outcome = _outcome(within=p_values[0] <= size, beyond=p_values[1] <= size)
        where = cell.parameter, cell.environment
        yield _row(data, where, "classical", outcome, limits.jnd, p_values=p_values)


def posterior_equivalence(fit: Fit, data: Data) -> Iterator[EquivalenceRow | Skipped]:
    """Yield the verdict on every cell of a fit that passed."""
    trial_sds = _trial_sds(fit)
    for cell, c in fit.column.items():
        parameter, environment = cell
        jnd = data.scene.study.jnd.get(parameter)
        if jnd is None:
            continue
        size: float | None = None
        ends: tuple[FloatOrArray, FloatOrArray]
        if jnd != "trials":
            limits = limits_of(data, parameter, environment)
            if isinstance(limits, Skipped):
                yield limits
                continue
            size = limits.jnd
            ends = _responses(fit, limits, c)
        elif cell in trial_sds:
            ends = _trial_ends(trial_sds[cell], log=fit.scale.log)
        else:
            label = data.quantities[parameter].label
            what = f"whether {label} of {environment} is within one JND from trials"
            yield Skipped(what, "without repeated trials there is none")
            continue
        mean = fit.moments.mean[:, c]
        sd = fit.moments.sd[:, c]
        inside = special.ndtr((ends[1] - mean) / sd) - special.ndtr((ends[0] - mean) / sd)
        probability = float(inside.mean())
        error = float(inside.std()) / math.sqrt(len(fit.points))
        decisive = data.asked.decision + _SURE * error
        outcome = _outcome(within=probability >= decisive, beyond=1.0 - probability >= decisive)
        yield _row(data, cell, "bayesian", outcome, size, probability=(probability, error))


def _outcome(*, within: bool, beyond: bool) -> Equivalence:
    """Name what is shown, if anything is."""
    if within:
        return "within"
    return "beyond" if beyond else "too little data"


def _row(
    data: Data,
    cell: tuple[str, str],
    method: Method,
    outcome: Equivalence,
    jnd: float | None,
    *,
    probability: tuple[float | None, float | None] = (None, None),
    p_values: tuple[float | None, float | None] = (None, None),
) -> EquivalenceRow:
    """Make a row of a probability with its error, or of both p-values."""
    parameter, environment = cell
    return EquivalenceRow(
        environment=environment,
        parameter=parameter,
        method=method,
        family=data.asked.family,
        outcome=outcome,
        jnd=jnd,
        unit=data.quantities[parameter].unit,
        reference=data.reference[cell],
        decision=data.asked.decision,
        probability=probability[0],
        error=probability[1],
        p_within=p_values[0],
        p_beyond=p_values[1],
    )


def _responses(fit: Fit, limits: Limits, c: int) -> tuple[float, float]:
    """Return the limits of a cell on the response scale."""
    origin = float(fit.scale.origin[c])
    unit = float(fit.scale.unit[c])
    lower, upper = limits.ends(log=fit.scale.log)
    if fit.scale.log:
        origin = math.log(origin)
    return (lower - origin) / unit, (upper - origin) / unit


def _trial_ends(sd: Array, *, log: bool) -> tuple[Array, Array]:
    """Return each draw's limits on the response scale, one SD between trials (S,) off."""
    if not log:
        return -sd, sd
    # As far below the reference as above it, in the quantity's unit.
    below = np.maximum(2.0 - np.exp(sd), 0.0)
    with np.errstate(divide="ignore"):
        return np.log(below), sd


def _trial_sds(fit: Fit) -> dict[tuple[str, str], Array]:
    """Return every cell's draws of the SD between trials; empty without repeats."""
    points = fit.run.points.reshape(len(fit.moments.mean), -1)
    sds: dict[tuple[str, str], Array] = {}
    for density, coordinates in fit.model.split(points):
        named = density.scales(coordinates)
        if "sigma_e" in named:
            _, draws = named["sigma_e"]
            sds |= dict(zip(density.cells, draws.reshape(len(draws), -1).T, strict=True))
    return sds
