"""Rows of the psychophysics table: what an estimate of one kind says in the quantity's unit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np

from percept.inference.classical.variability import Bounded
from percept.inference.record import Method
from percept.results import Measure, PsychophysicsRow
from percept.sessions.quantities import Quantity
from percept.study.basics import Array
from percept.study.data import Data

#: The quartile of a standard normal: half of all adjustments lie within so many SDs.
_QUARTILE = 0.6744897501960817


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """A quantity in an environment, or over all, by one method: what its numbers say as rows."""

    data: Data
    method: Method
    parameter: str  # Of a correlation both, as "k, b"
    environment: str | None  # None over all environments
    n: int  # Subjects
    unit: float = 1.0  # Of the quantity, or of its logarithm, per unit of response
    subject: str | None = None  # None of all subjects together

    @property
    def quantity(self) -> Quantity:
        """The quantity."""
        return self.data.quantities[self.parameter]

    def rows(
        self,
        measure: Measure,
        bounded: Bounded,
        *,
        approximate: bool = False,
    ) -> Iterator[PsychophysicsRow]:
        """Yield what an estimate says: of SDs in the quantity's unit, of those of trials also JNDs.

        Points of equality are in that unit, SDs are of responses, and the rest are pure numbers.
        """
        unit = self.quantity.unit if measure == "sd_subjects" else ""
        if measure == "sd_subjects":
            if math.isnan(self._reference):
                return
            bounded = mapped(bounded, self._step)
        yield self._row(measure, bounded, unit, approximate=approximate)
        if measure == "sigma_e":
            yield from self._thresholds(bounded)

    def _thresholds(self, sd: Bounded) -> Iterator[PsychophysicsRow]:
        """Yield the thresholds made of the SD between trials."""
        if math.isnan(self._reference):
            if self.subject is not None and not self._by_difference:
                log = self.data.asked.family == "lognormal"
                yield self._row("weber", mapped(sd, np.expm1) if log else sd)
            return
        step = mapped(sd, self._step)
        yield self._row("jnd", step, self.quantity.unit)
        size = abs(self._reference)
        if size:
            yield self._row("weber", mapped(step, lambda values: values / size))
        quartile = mapped(sd, lambda values: self._step(_QUARTILE * values))
        yield self._row("jnd_quartile", quartile, self.quantity.unit)

    def _step(self, sd: Array) -> Array:
        """Return how far SDs of responses lead from the reference, in the quantity's unit."""
        size = sd * self.unit
        if self.data.asked.family == "lognormal":
            return np.asarray(self._reference * np.expm1(size))
        return size

    @property
    def _reference(self) -> float:
        """Reference in the quantity's unit; NaN over all environments."""
        return self.data.reference.get((self.parameter, self.environment or ""), math.nan)

    @property
    def _by_difference(self) -> bool:
        """Whether the quantity has a reference that is not positive."""
        return self.data.sessions.form == "trials" and self.data.by_difference(self.parameter)

    def _row(
        self,
        measure: Measure,
        bounded: Bounded,
        unit: str = "",
        *,
        approximate: bool = False,
    ) -> PsychophysicsRow:
        """Make a row; SDs of responses are in the quantity's unit if they are differences."""
        if measure.startswith("sigma") and self._by_difference:
            bounded = mapped(bounded, lambda values: values * self.unit)
            unit = self.quantity.unit
        return PsychophysicsRow(
            environment=self.environment,
            subject=self.subject,
            parameter=self.parameter,
            measure=measure,
            method=self.method,
            family=self.data.asked.family,
            level=self.data.asked.level,
            **vars(bounded),
            unit=unit,
            n=self.n,
            approximate=approximate,
        )


def mapped(bounded: Bounded, increasing: Callable[[Array], Array]) -> Bounded:
    """Map an estimate and its limits; the limits' error follows."""
    error = bounded.error or 0.0
    ends = np.array([bounded.lower, bounded.upper])
    with np.errstate(over="ignore"):
        estimate = float(increasing(np.array(bounded.estimate)))
        lower, upper = increasing(ends).tolist()
        further = increasing(ends + error).tolist()
    if bounded.error is None:
        return Bounded(estimate, lower, upper)
    # Two infinite ends have no difference.
    error = math.inf if math.isinf(upper) else max(further[0] - lower, further[1] - upper)
    return Bounded(estimate, lower, upper, error)
