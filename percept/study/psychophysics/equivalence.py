"""Whether a bias is smaller than one JND: what a JND is, and the classical verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from percept.inference.classical.equivalence import tost
from percept.results import EquivalenceRow
from percept.results.psychophysics import Equivalence
from percept.sessions.quantities import Quantity, amount_in
from percept.study.basics import Skipped
from percept.study.data import Data

__all__ = ["Limits", "classical_equivalence", "limits_of", "outcome_of"]


@dataclass(frozen=True)
class Limits:
    """Values one JND below and above a reference."""

    reference: float  # In the quantity's unit
    jnd: float  # In the quantity's unit, above zero

    @property
    def native(self) -> tuple[float, float]:
        """Both limits, in the quantity's unit."""
        lower = self.reference - self.jnd
        upper = self.reference + self.jnd
        return lower, upper

    @property
    def log(self) -> tuple[float, float]:
        """Logarithms of both; no positive value lies a whole reference below it."""
        lower, upper = self.native
        if lower <= 0.0:
            return -math.inf, math.log(upper)
        return math.log(lower), math.log(upper)


def limits_of(
    quantity: Quantity,
    environment: str,
    jnd: float | str,
    reference: float,
) -> Limits | Skipped:
    """Return the limits in an environment, or why there are none."""
    what = f"whether {quantity.label} of {environment} is within one JND"
    if math.isnan(reference):
        return Skipped(what, "there is no reference")
    if isinstance(jnd, str):
        return Limits(reference, amount_in(quantity, jnd))
    if reference == 0.0:
        return Skipped(what, "a fraction of a reference of zero is zero; give the JND in its unit")
    return Limits(reference, jnd * abs(reference))


def outcome_of(*, within: bool, beyond: bool) -> Equivalence:
    """Name what is shown, if anything is."""
    if within:
        return "within"
    return "beyond" if beyond else "too little data"


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
        reference_here = data.reference[cell.parameter, cell.environment]
        limits = limits_of(cell.quantity, cell.environment, jnd, reference_here)
        if isinstance(limits, Skipped):
            yield limits
            continue
        moments = cell.moments.on_scale(asked.family)
        lower, upper = limits.log if asked.family == "lognormal" else limits.native
        tests = tost(moments, lower, upper)
        p_within = float(tests.p_within)
        p_beyond = float(tests.p_beyond)
        size = 1.0 - asked.decision
        yield EquivalenceRow(
            environment=cell.environment,
            parameter=cell.parameter,
            method="classical",
            family=asked.family,
            outcome=outcome_of(within=p_within <= size, beyond=p_beyond <= size),
            jnd=limits.jnd,
            unit=cell.quantity.unit,
            reference=limits.reference,
            decision=asked.decision,
            probability=None,
            error=None,
            p_within=p_within,
            p_beyond=p_beyond,
        )
