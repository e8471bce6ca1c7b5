"""Whether biases are smaller than one JND: three outcomes, by both methods."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from percept.inference.classical.contrasts import tost
from percept.inference.record import FloatOrArray, Method
from percept.results import Equivalence, EquivalenceRow, Skipped
from percept.sessions.quantities import amount_in
from percept.study.basics import Array
from percept.study.data import Cell, Data

# The classical method does without the model.
if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Monte Carlo errors by which a probability must pass the one that decides.
_SURE = 2.0


def classical_equivalence(data: Data) -> Iterator[EquivalenceRow | Skipped]:
    """Yield whether biases are within one JND, by two one-sided tests of size 1 - decision."""
    for cell in data.cells[data.asked.family]:
        if cell.parameter in data.scene.study.jnd:
            yield _tested(data, cell)


def _tested(data: Data, cell: Cell) -> EquivalenceRow | Skipped:
    """Judge a cell by the classical method."""
    what = f"classical verdict whether {cell.quantity.label} is within one JND"
    if data.scene.study.jnd[cell.parameter] == "trials":
        return Skipped(what, "a JND from trials has an error that the tests do not know")
    if cell.moments is None:
        return Skipped(f"{what} in {cell.environment}", cell.why)
    where = (cell.parameter, cell.environment)
    jnd = _jnd_in_unit(data, where)
    if isinstance(jnd, Skipped):
        return jnd
    family = data.asked.family
    ends = _ends_of_jnd(data.reference[where], jnd, log=family == "lognormal")
    tests = tost(cell.moments.on_scale(family), *ends.tolist())
    size = 1.0 - data.asked.decision
    return _row(
        data,
        where,
        "classical",
        jnd,
        is_within=bool(tests.p_within <= size),
        is_beyond=bool(tests.p_beyond <= size),
        p_within=float(tests.p_within),
        p_beyond=float(tests.p_beyond),
    )


def _jnd_in_unit(data: Data, where: tuple[str, str]) -> float | Skipped:
    """Return the JND of a cell in the quantity's unit, or why there is none; not of trials."""
    parameter, environment = where
    quantity = data.quantities[parameter]
    jnd = data.scene.study.jnd[parameter]
    reference = data.reference[where]
    what = f"whether {quantity.label} of {environment} is within one JND"
    if math.isnan(reference):
        return Skipped(what, "there is no reference")
    if isinstance(jnd, str):
        return amount_in(quantity, jnd)
    if reference == 0.0:
        return Skipped(what, "a fraction of a reference of zero is zero; give the JND in its unit")
    return jnd * abs(reference)


def _ends_of_jnd(reference: float, jnd: FloatOrArray, *, log: bool) -> Array:
    """Return the values one JND below and above a reference, or their logarithms."""
    ends = np.stack([reference - np.asarray(jnd), reference + np.asarray(jnd)])
    if not log:
        return ends
    with np.errstate(divide="ignore"):
        # No positive value lies a whole reference below it.
        return np.log(np.maximum(ends, 0.0))


def _row(
    data: Data,
    where: tuple[str, str],
    method: Method,
    jnd: float | None,
    *,
    is_within: bool,
    is_beyond: bool,
    **evidence: float,
) -> EquivalenceRow:
    """Make the row of a verdict; `evidence` are p-values, or a probability and its error."""
    parameter, environment = where
    outcome: Equivalence = "beyond" if is_beyond else "too little data"
    return EquivalenceRow(
        environment=environment,
        parameter=parameter,
        method=method,
        family=data.asked.family,
        outcome="within" if is_within else outcome,
        jnd=jnd,
        unit=data.quantities[parameter].unit,
        reference=data.reference[where],
        decision=data.asked.decision,
        **evidence,
    )


def posterior_equivalence(fit: Fit) -> Iterator[EquivalenceRow | Skipped]:
    """Yield whether biases are smaller than one JND, by their posterior probability."""
    for parameter, environment in fit.model.cells:
        if parameter in fit.data.scene.study.jnd:
            yield _judged(fit, parameter, environment)


def _judged(fit: Fit, parameter: str, environment: str) -> EquivalenceRow | Skipped:
    """Judge a cell of a fit that passed."""
    data = fit.data
    where = (parameter, environment)
    c = fit.column[where]
    scale = fit.scale.at(c)
    size: float | None = None
    jnd: FloatOrArray
    if data.scene.study.jnd[parameter] == "trials":
        if where not in fit.trial_sds:
            what = f"whether {data.quantities[parameter].label} of {environment} is within one JND"
            return Skipped(f"{what} from trials", "without repeated trials there is none")
        jnd = scale.native(fit.trial_sds[where]) - scale.origin
    else:
        found = _jnd_in_unit(data, where)
        if isinstance(found, Skipped):
            return found
        jnd = size = found
    ends = (_ends_of_jnd(data.reference[where], jnd, log=scale.log) - scale.centre) / scale.unit
    mean = fit.moments.mean[:, c]
    sd = fit.moments.sd[:, c]
    below, up_to_above = special.ndtr((ends.reshape(2, -1) - mean) / sd)
    inside = up_to_above - below
    probability = float(inside.mean())
    error = float(inside.std()) / math.sqrt(len(fit.points))
    decisive = data.asked.decision + _SURE * error
    return _row(
        data,
        where,
        "bayesian",
        size,
        is_within=probability >= decisive,
        is_beyond=1.0 - probability >= decisive,
        probability=probability,
        error=error,
    )
