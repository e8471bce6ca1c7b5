"""Where a row of the psychophysics table belongs, and what is made of a mean or an SD there."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator

from percept.inference.classical.variability import Bounded
from percept.inference.record import Method
from percept.results.psychophysics import Measure, PsychophysicsRow
from percept.sessions.quantities import Quantity
from percept.study.data import Data

#: The quartile of a standard normal: half of all adjustments lie within so many SDs.
_QUARTILE = 0.6744897501960817
#: Of what has no exponential among the doubles: SDs of several decades lead beyond.
_OVERFLOW = math.log(sys.float_info.max)


def exp(response: float) -> float:
    """Return e to a response, infinite where that is beyond the doubles."""
    return math.exp(response) if response < _OVERFLOW else math.inf


def expm1(response: float) -> float:
    """Return e to a response less one, infinite where that is beyond the doubles."""
    return math.expm1(response) if response < _OVERFLOW else math.inf


@dataclasses.dataclass(frozen=True, eq=False)
class Site:
    """Where rows belong: a quantity in an environment, or over all, by one method."""

    data: Data
    parameter: str  # Of a correlation both, as "k, b"
    environment: str | None  # None over all environments
    method: Method
    n: int  # Subjects
    #: Of the quantity, or of its logarithm, per unit of response.
    response_unit: float
    subject: str | None = None  # None of all subjects together

    @property
    def quantity(self) -> Quantity:
        """The quantity."""
        return self.data.quantities[self.parameter]

    @property
    def reference(self) -> float:
        """Reference in the quantity's unit; NaN over all environments."""
        return self.data.reference.get((self.parameter, self.environment or ""), math.nan)

    @property
    def by_difference(self) -> bool:
        """Whether the quantity has a reference that is not positive."""
        trials = self.data.sessions.form == "trials"
        return trials and self.data.by_difference(self.parameter)

    def over_all(self, n: int) -> Site:
        """Return the place of the quantity's rows over all environments, of n subjects."""
        return dataclasses.replace(self, environment=None, n=n)

    def of_subject(self, subject: str) -> Site:
        """Return the place of the rows of one subject, over all environments."""
        return dataclasses.replace(self.over_all(1), subject=subject)

    def step(self, sd: float, multiple: float = 1.0) -> float:
        """Return how far some SDs of the family's scale lead from the reference."""
        size = multiple * sd * self.response_unit
        if self.data.asked.family == "lognormal":
            return self.reference * expm1(size)
        return size

    def row(
        self, measure: Measure, bounded: Bounded, unit: str = "", *, approximate: bool = False
    ) -> PsychophysicsRow:
        """Make a row of a measure."""
        asked = self.data.asked
        return PsychophysicsRow(
            environment=self.environment,
            subject=self.subject,
            parameter=self.parameter,
            measure=measure,
            method=self.method,
            family=asked.family,
            level=asked.level,
            **vars(bounded),
            unit=unit,
            n=self.n,
            approximate=approximate,
        )

    def of_subjects(self, sd: Bounded) -> Iterator[PsychophysicsRow]:
        """Yield the SD between subjects in the quantity's unit."""
        if not math.isnan(self.reference):
            yield self.row("sd_subjects", mapped(sd, self.step), self.quantity.unit)

    def of_trials(self, sd: Bounded) -> Iterator[PsychophysicsRow]:
        """Yield the SD between trials, on the response scale, and thresholds made of it."""
        yield self.sigma("sigma_e", sd)
        if math.isnan(self.reference):
            return
        step = mapped(sd, self.step)
        yield self.row("jnd", step, self.quantity.unit)
        if self.reference != 0.0:
            size = abs(self.reference)
            yield self.row("weber", mapped(step, lambda x: x / size))
        quartile = mapped(sd, lambda x: self.step(x, _QUARTILE))
        yield self.row("jnd_quartile", quartile, self.quantity.unit)

    def of_own_trials(self, sd: Bounded) -> Iterator[PsychophysicsRow]:
        """Yield a subject's own SD between trials, and their Weber fraction."""
        yield self.sigma("sigma_e", sd)
        if self.by_difference:
            return
        log = self.data.asked.family == "lognormal"
        yield self.row("weber", mapped(sd, expm1) if log else sd)

    def sigma(
        self, measure: Measure, sd: Bounded, *, approximate: bool = False
    ) -> PsychophysicsRow:
        """Make the row of an SD of responses, in the quantity's unit if they are differences."""
        if not self.by_difference:
            return self.row(measure, sd, approximate=approximate)
        native = mapped(sd, lambda x: x * self.response_unit)
        return self.row(measure, native, self.quantity.unit, approximate=approximate)


def mapped(bounded: Bounded, increasing: Callable[[float], float]) -> Bounded:
    """Map an estimate and its limits; the limits' error follows."""
    lower = increasing(bounded.lower)
    upper = increasing(bounded.upper)
    error = None
    if bounded.error is not None:
        below = increasing(bounded.lower + bounded.error) - lower
        above = increasing(bounded.upper + bounded.error) - upper
        # Two infinite ends have no difference.
        error = math.inf if math.isinf(upper) else max(below, above)
    return Bounded(increasing(bounded.estimate), lower, upper, error)
