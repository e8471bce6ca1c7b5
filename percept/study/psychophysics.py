"""The psychophysics table, and whether biases are smaller than one JND: rows of any method.

The classical ones are made here, by t, χ², F and Fisher's z. SDs are of responses; a row says what
they are in the quantity's unit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from percept.errors import RefusalError
from percept.inference.classical.contrasts import tost
from percept.inference.classical.variability import (
    Bounded,
    MeanSquares,
    component_sd,
    correlation,
    icc_one_way,
    mean_squares,
    sd_interval,
    trial_mean_squares,
)
from percept.inference.record import FloatOrArray, Method
from percept.results import Equivalence, EquivalenceRow, Measure, PsychophysicsRow, Skipped
from percept.sessions.quantities import amount_in
from percept.study.basics import Array
from percept.study.data import Cell, Data
from percept.study.responses import Trials


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

    def rows(
        self, measure: Measure, bounded: Bounded, *, approximate: bool = False
    ) -> Iterator[PsychophysicsRow]:
        """Yield what an estimate says: of SDs in the quantity's unit, of those of trials also JNDs.

        SDs are of responses, and the rest are pure numbers.
        """
        if measure != "sd_subjects":
            yield self._row(measure, bounded, approximate=approximate)
        elif not math.isnan(self._reference):
            yield self._row(measure, mapped(bounded, self._step), self._named_unit)
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
        yield self._row("jnd", step, self._named_unit)
        size = abs(self._reference)
        if size:
            yield self._row("weber", mapped(step, lambda values: values / size))

    def _step(self, sd: Array) -> Array:
        """Return how far SDs of responses lead from the reference, in the quantity's unit."""
        size = sd * self.unit
        if self.data.asked.family == "lognormal":
            return np.asarray(self._reference * np.expm1(size))
        return size

    @property
    def _named_unit(self) -> str:
        """The quantity's unit."""
        return self.data.quantities[self.parameter].unit

    @property
    def _reference(self) -> float:
        """Reference in the quantity's unit; NaN over all environments."""
        return self.data.reference.get((self.parameter, self.environment or ""), math.nan)

    @property
    def _by_difference(self) -> bool:
        """Whether the quantity has a reference that is not positive."""
        return self.data.sessions.form == "trials" and self.data.by_difference(self.parameter)

    def _row(
        self, measure: Measure, bounded: Bounded, unit: str = "", *, approximate: bool = False
    ) -> PsychophysicsRow:
        """Make a row; SDs of responses are in the quantity's unit if they are differences."""
        if measure.startswith("sigma") and self._by_difference:
            bounded = mapped(bounded, lambda values: values * self.unit)
            unit = self._named_unit
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
    lower = bounded.lower
    upper = bounded.upper
    with np.errstate(over="ignore"):
        of_all = increasing(
            np.array([bounded.estimate, lower, upper, lower + error, upper + error])
        )
    estimate, lower, upper, beyond_lower, beyond_upper = of_all.tolist()
    if bounded.error is None:
        return Bounded(estimate, lower, upper)
    # Two infinite ends have no difference.
    error = math.inf if math.isinf(upper) else max(beyond_lower - lower, beyond_upper - upper)
    return Bounded(estimate, lower, upper, error)


def classical_psychophysics(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the classical rows; of published limits those of SDs only."""
    family = data.asked.family
    for parameter in data.parameters:
        trials = _trials_if_any(data, parameter)
        unit = {}
        if trials is not None:
            unit = dict(zip(trials.environments, trials.scale.unit.tolist(), strict=True))
        by_environment = {}
        for cell in data.cells[family]:
            if cell.parameter != parameter:
                continue
            measured = Measured(
                data=data,
                method="classical",
                parameter=parameter,
                environment=cell.environment,
                n=0 if cell.moments is None else int(np.asarray(cell.moments.n)),
                unit=unit.get(cell.environment, 1.0),
            )
            by_environment[cell.environment] = measured
            if cell.moments is not None:
                sd = float(cell.moments.on_scale(family).sd) / measured.unit
                bounded = sd_interval(sd, measured.n - 1.0, level=data.asked.level)
                yield from measured.rows("sd_subjects", bounded)
        if trials is not None:
            for j, environment in enumerate(trials.environments):
                yield from _of_trials(by_environment[environment], trials, j)
            yield from _over_all(by_environment[trials.environments[0]], trials)
    if len(data.parameters) == 2:
        yield from _correlations(data)


def absent_jnds(data: Data) -> Iterator[Skipped]:
    """Name the quantities and environments without a JND, and say why."""
    for parameter in data.parameters:
        what = f"JND of {data.quantities[parameter].label}"
        try:
            trials = data.trials(parameter, partial=True)
        except RefusalError as refused:
            yield Skipped(what, str(refused))
            continue
        names = trials.environments
        most = trials.counts.max(axis=0).tolist()
        once = [name for name, count in zip(names, most, strict=True) if count == 1.0]
        if once:
            where = "" if len(once) == len(names) else f" in {', '.join(once)}"
            yield Skipped(what + where, "it needs repeated trials")


def _trials_if_any(data: Data, *parameters: str) -> Trials | None:
    """Return trials of parameters as responses; None where they have none."""
    try:
        return data.trials(*parameters, partial=True)
    except RefusalError:
        return None


def _of_trials(measured: Measured, trials: Trials, j: int) -> Iterator[PsychophysicsRow]:
    """Yield rows of repeated trials in environment j."""
    level = measured.data.asked.level
    df = float(trials.statistics.trial_df[j])
    if df == 0.0:
        return
    trial_sd = abs(float(trials.statistics.trial_rows[0, 0, j])) / math.sqrt(df)
    yield from measured.rows("sigma_e", sd_interval(trial_sd, df, level=level))
    present = trials.counts[:, j] > 0
    means = trials.statistics.cell_means[present, 0, j]
    no_scatter = trial_sd == 0.0 and np.ptp(means) == 0.0
    if no_scatter or len(means) < 2:
        return
    counts = trials.counts[present, j]
    reliability = icc_one_way(trial_mean_squares(means, counts, trial_sd), level=level)
    yield from measured.rows("icc_1", reliability, approximate=bool(np.ptp(counts) > 0.0))


def _over_all(measured: Measured, trials: Trials) -> Iterator[PsychophysicsRow]:
    """Yield components of variance over all environments, of subjects who were in each."""
    level = measured.data.asked.level
    table = trials.statistics.cell_means[:, 0]
    complete = np.isfinite(table).all(axis=1)
    try:
        squares = mean_squares(table[complete])
    except RefusalError:
        return
    overall = dataclasses.replace(measured, environment=None, n=int(complete.sum()))
    yield from overall.rows("sigma_u", component_sd(squares, level=level), approximate=True)
    df = float(trials.statistics.trial_df.sum())
    if df > 0.0:
        trial_square = float(np.square(trials.statistics.trial_rows[0, 0]).sum()) / df
        # What subjects differ by within environments, against what their trials differ by.
        repeats = 1.0 / float(np.mean(1.0 / trials.counts[complete]))
        within_environments = MeanSquares(
            subjects=repeats * squares.error,
            error=trial_square,
            n=round(squares.error_df) + 1,
            k=repeats,
            error_df=df,
        )
        within = component_sd(within_environments, level=level)
        yield from overall.rows("sigma_w", within, approximate=True)
        yield from overall.rows("sigma_e", sd_interval(math.sqrt(trial_square), df, level=level))
    else:
        within = sd_interval(math.sqrt(squares.error), squares.error_df, level=level)
        yield from overall.rows("sigma_w", within)


def _correlations(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the correlation of both quantities between subjects, environment by environment."""
    trials = _trials_if_any(data, *data.parameters)
    if trials is None:
        return
    for j, environment in enumerate(trials.environments):
        pairs = trials.statistics.cell_means[:, :, j]
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        # Two pairs lie on a line, whatever they are.
        if len(pairs) < 3:
            continue
        try:
            bounded = correlation(pairs, level=data.asked.level)
        except RefusalError:
            continue
        measured = Measured(
            data=data,
            method="classical",
            parameter=", ".join(data.parameters),
            environment=environment,
            n=len(pairs),
        )
        yield from measured.rows("correlation", bounded, approximate=True)


def classical_equivalence(data: Data) -> Iterator[EquivalenceRow | Skipped]:
    """Yield whether biases are within one JND, by two one-sided tests of size 1 - decision."""
    for cell in data.cells[data.asked.family]:
        if cell.parameter in jnds_of(data):
            yield _tested(data, cell)


def jnds_of(data: Data) -> Mapping[str, float | str]:
    """JNDs that the scene gives, by quantity; none where no quantity has a reference."""
    quantities = data.sessions.options.quantities.values()
    has_reference = any(quantity.is_matched for quantity in quantities)
    return data.scene.study.jnd if has_reference else {}


def _tested(data: Data, cell: Cell) -> EquivalenceRow | Skipped:
    """Judge a cell."""
    asked = data.asked
    what = f"classical verdict whether {cell.quantity.label} is within one JND"
    if data.scene.study.jnd[cell.parameter] == "trials":
        return Skipped(what, "a JND from trials has an error that the tests do not know")
    if cell.moments is None:
        return Skipped(f"{what} in {cell.environment}", cell.why)
    where = (cell.parameter, cell.environment)
    jnd = jnd_in_unit(data, where)
    if isinstance(jnd, Skipped):
        return jnd
    ends = ends_of_jnd(data.reference[where], jnd, log=asked.family == "lognormal")
    tests = tost(cell.moments.on_scale(asked.family), *ends.tolist())
    size = 1.0 - asked.decision
    return equivalence_row(
        data,
        where,
        "classical",
        jnd,
        is_within=bool(tests.p_within <= size),
        is_beyond=bool(tests.p_beyond <= size),
        p_within=float(tests.p_within),
        p_beyond=float(tests.p_beyond),
    )


def jnd_in_unit(data: Data, where: tuple[str, str]) -> float | Skipped:
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


def ends_of_jnd(reference: float, jnd: FloatOrArray, *, log: bool) -> Array:
    """Return the values one JND below and above a reference, or their logarithms."""
    ends = np.stack([reference - np.asarray(jnd), reference + np.asarray(jnd)])
    if not log:
        return ends
    with np.errstate(divide="ignore"):
        # No positive value lies a whole reference below it.
        return np.log(np.maximum(ends, 0.0))


def equivalence_row(
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
