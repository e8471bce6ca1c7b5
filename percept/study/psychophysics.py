"""The psychophysics table: thresholds, components of variance and reliability, by both methods.

The classical rows are made by t, χ², F and Fisher's z. The Bayesian ones come from a fit, which has
one model of all its quantities, or one for each. A model has P quantities in J environments and N
subjects. Its P J cells stand quantity by quantity. All SDs are of responses, and a row says what
they are in the quantity's unit:

- `sigma_u`: between subjects, in the effect that a subject has in all environments;
- `sigma`: between subjects, in what else each has in one environment (rows call it `sigma_w`);
- `population_sd`: between users in one environment: both together, and effects of factors;
- `sigma_e`: between trials of one subject, a typical one if subjects have trial SDs of their own;
- `phi`: the log of a subject's trial SD over sigma_e, with the SD `omega_s`.

There are S draws of the scales. Some R of them are independent, and stand for what takes long to
draw or to solve. Given a draw a location is normal, so limits of slopes are roots of mixtures.
Scales and reliabilities have quantiles of draws.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from percept.errors import RefusalError
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
from percept.inference.record import Method
from percept.results import Measure, PsychophysicsRow, Skipped
from percept.study.basics import Array
from percept.study.data import Data
from percept.study.responses import Trials

# The classical method does without the model.
if TYPE_CHECKING:
    from percept.inference.model.model import LinearModel
    from percept.study.fit import Fit

_Rows = Iterator[PsychophysicsRow]
#: Draws, (S, cells) or (S, quantities), by what they are of.
_Drawn = dict[Measure, Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A quantity in an environment, or over all, by one method: what its numbers say as rows."""

    data: Data
    method: Method
    parameter: str  # Of a correlation both, as "k, b"
    environment: str | None  # None over all environments
    n: int  # Subjects
    unit: float = 1.0  # Of the quantity, or of its logarithm, per unit of response
    subject: str | None = None  # None of all subjects together

    def rows(self, measure: Measure, bounded: Bounded, *, approximate: bool = False) -> _Rows:
        """Yield what an estimate says: of SDs in the quantity's unit, of those of trials also JNDs.

        Other SDs are of responses, or in the quantity's unit if these are differences. The rest are
        pure numbers.
        """
        data = self.data
        log = data.asked.family == "lognormal"
        reference = data.reference.get((self.parameter, self.environment or ""), math.nan)
        by_difference = measure.startswith("sigma") and data.by_difference(self.parameter)

        def in_unit(sd: Array) -> Array:
            return sd * self.unit

        def from_reference(sd: Array) -> Array:
            """How far SDs of responses lead from the reference, in the quantity's unit."""
            return np.asarray(reference * np.expm1(in_unit(sd))) if log else in_unit(sd)

        found: dict[Measure, Bounded] = {measure: bounded}
        if by_difference:
            found[measure] = mapped(bounded, in_unit)
        if measure == "sd_subjects":
            found[measure] = mapped(bounded, from_reference)
            if math.isnan(reference):
                return
        elif measure == "sigma_e" and not math.isnan(reference):
            found["jnd"] = mapped(bounded, from_reference)
            if reference:
                found["weber"] = mapped(found["jnd"], lambda values: values / abs(reference))
        elif measure == "sigma_e" and self.subject is not None and not by_difference:
            found["weber"] = mapped(bounded, np.expm1) if log else bounded
        for name, numbers in found.items():
            has_unit = name in ("sd_subjects", "jnd") or (name == measure and by_difference)
            yield PsychophysicsRow(
                environment=self.environment,
                subject=self.subject,
                parameter=self.parameter,
                measure=name,
                method=self.method,
                family=data.asked.family,
                level=data.asked.level,
                **vars(numbers),
                unit=data.quantities[self.parameter].unit if has_unit else "",
                n=self.n,
                approximate=approximate,
            )


def mapped(bounded: Bounded, increasing: Callable[[Array], Array]) -> Bounded:
    """Map an estimate and its limits; the error of a convex function is largest above."""
    error = bounded.error
    highest = bounded.upper + (error or 0.0)
    with np.errstate(over="ignore"):
        of_all = increasing(np.array([bounded.estimate, bounded.lower, bounded.upper, highest]))
    estimate, lower, upper, highest = of_all.tolist()
    if error is not None:
        # Two infinite ends have no difference.
        error = math.inf if math.isinf(upper) else highest - upper
    return Bounded(estimate, lower, upper, error)


def absent_jnds(data: Data) -> Iterator[Skipped]:
    """Name the quantities and environments without a JND, and say why."""
    for parameter in data.parameters:
        what = f"JND of {data.quantities[parameter].label}"
        try:
            trials = data.trials(parameter, partial=True)
        except RefusalError as refused:
            yield Skipped(what, str(refused))
            continue
        names = np.array(trials.environments)
        once = names[trials.statistics.trial_df == 0.0].tolist()
        if once:
            where = "" if len(once) == len(names) else f" in {', '.join(once)}"
            yield Skipped(what + where, "it needs repeated trials")


def classical_psychophysics(data: Data) -> _Rows:
    """Yield the classical rows. Published limits have only those of SDs."""
    for parameter in data.parameters:
        for (of, environment), moments in data.moments(data.asked.family).items():
            if of != parameter:
                continue
            n = int(np.asarray(moments.n))
            measured = Measured(data, "classical", parameter, environment, n)
            bounded = sd_interval(float(moments.sd), n - 1.0, level=data.asked.level)
            yield from measured.rows("sd_subjects", bounded)
        trials = _trials_if_any(data, parameter)
        if trials is not None:
            for j in range(len(trials.environments)):
                yield from _of_trials(data, trials, j)
            yield from _components(data, trials)
    if len(data.parameters) == 2:
        yield from _classical_correlations(data)


def _trials_if_any(data: Data, *parameters: str) -> Trials | None:
    """Return trials of parameters as responses; None where they have none."""
    try:
        return data.trials(*parameters, partial=True)
    except RefusalError:
        return None


def _of_trials(data: Data, trials: Trials, j: int) -> _Rows:
    """Yield rows of repeated trials of a quantity in environment j."""
    level = data.asked.level
    df = float(trials.statistics.trial_df[j])
    if df == 0.0:
        return
    present = trials.statistics.counts[:, j] > 0
    measured = Measured(
        data,
        "classical",
        trials.parameters[0],
        trials.environments[j],
        n=int(present.sum()),
        unit=float(trials.scale.unit[j]),
    )
    trial_sd = math.sqrt(float(trials.statistics.trial_squares[0, j]) / df)
    yield from measured.rows("sigma_e", sd_interval(trial_sd, df, level=level))
    means = trials.statistics.cell_means[present, 0, j]
    no_scatter = trial_sd == 0.0 and np.ptp(means) == 0.0
    if no_scatter or len(means) < 2:
        return
    counts = trials.statistics.counts[present, j]
    reliability = icc_one_way(trial_mean_squares(means, counts, trial_sd), level=level)
    yield from measured.rows("icc_1", reliability, approximate=bool(np.ptp(counts) > 0.0))


def _components(data: Data, trials: Trials) -> _Rows:
    """Yield components of variance over all environments, of subjects who were in each."""
    level = data.asked.level
    table = trials.statistics.cell_means[:, 0]
    complete = np.isfinite(table).all(axis=1)
    try:
        squares = mean_squares(table[complete])
    except RefusalError:
        return
    # A quantity that is compared by differences has one unit everywhere.
    unit = float(trials.scale.unit[0])
    overall = Measured(data, "classical", trials.parameters[0], None, squares.n, unit)
    yield from overall.rows("sigma_u", component_sd(squares, level=level), approximate=True)
    df = float(trials.statistics.trial_df.sum())
    if df == 0.0:
        within = sd_interval(math.sqrt(squares.error), squares.error_df, level=level)
        yield from overall.rows("sigma_w", within)
        return
    trial_square = float(trials.statistics.trial_squares.sum()) / df
    # What subjects differ by within environments, against what their trials differ by.
    repeats = 1.0 / float(np.mean(1.0 / trials.statistics.counts[complete]))
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


def _classical_correlations(data: Data) -> _Rows:
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
        both = ", ".join(data.parameters)
        measured = Measured(data, "classical", both, environment, len(pairs))
        yield from measured.rows("correlation", bounded, approximate=True)


def posterior_psychophysics(fit: Fit) -> _Rows:
    """Yield the Bayesian rows of a fit that passed."""
    measured = []
    cells = zip(fit.model.cells, fit.counts.tolist(), fit.scale.unit.tolist(), strict=True)
    for (parameter, environment), n, unit in cells:
        measured.append(Measured(fit.data, "bayesian", parameter, environment, n, unit))
    population_sd = fit.moments.population_sd
    yield from _bounded(fit, {"sd_subjects": population_sd}, measured)
    parts = zip(fit.model.split(fit.every_point), fit.model.split(fit.points), strict=True)
    first = 0
    for (model, every_draw), (_, points) in parts:
        last = first + len(model.cells)
        of_cells = measured[first:last]
        statistics = model.statistics
        scales = {name: scale for name, (_, scale) in model.scales(every_draw).items()}
        if len(statistics.environments) == 1:
            # The data tell the sum sigma_u² + sigma² only, which is population_sd².
            scales.pop("sigma_u", None)
        yield from _bounded(fit, _of_cells(scales, population_sd[:, first:last]), of_cells)
        n = len(statistics.subjects)
        of_quantities = of_cells[:: len(statistics.environments)]
        over_all = [dataclasses.replace(cell, environment=None, n=n) for cell in of_quantities]
        yield from _of_subjects(fit, model, scales, over_all)
        yield from _slopes(fit, model, points, over_all)
        yield from _bounded(fit, _over_all(model, scales), over_all)
        if len(statistics.parameters) == 2:
            users = model.joint(points, model.pair_rows).users
            variances = np.diagonal(users, axis1=2, axis2=3)
            draws = users[..., 0, 1] / np.sqrt(variances.prod(axis=2))
            both = ", ".join(statistics.parameters)
            pairs = [dataclasses.replace(cell, parameter=both) for cell in of_cells]
            yield from _bounded(fit, {"correlation": draws}, pairs[: draws.shape[1]])
        first = last


def _bounded(fit: Fit, drawn: _Drawn, measured: Sequence[Measured]) -> _Rows:
    """Yield the rows of draws of each quantity measured."""
    for measure, draws in drawn.items():
        for one, column in zip(measured, draws.T, strict=True):
            yield from one.rows(measure, fit.limits_of_draws(column))


def _of_cells(scales: Mapping[str, Array], population_sd: Array) -> _Drawn:
    """Draws of components of variance and reliability, in every cell.

    ICC(1) is population_sd²/(population_sd² + the average variance between trials). phi is normal,
    so a user's variance is on average exp(2 omega_s²) times sigma_e².
    """
    drawn: _Drawn = {}
    shape = population_sd.shape
    if "sigma_u" in scales:
        drawn["sigma_w"] = scales["sigma"].reshape(shape)
    if "sigma_e" in scales:
        drawn["sigma_e"] = scales["sigma_e"].reshape(shape)
        of_users = population_sd**2
        of_trials = np.square(scales["sigma_e"])
        if "omega_s" in scales:
            of_trials = of_trials * np.exp(2.0 * scales["omega_s"] ** 2)[:, :, None]
        drawn["icc_1"] = of_users / (of_users + of_trials.reshape(shape))
    return drawn


def _of_subjects(
    fit: Fit, model: LinearModel, scales: Mapping[str, Array], over_all: Sequence[Measured]
) -> _Rows:
    """Yield each subject's own trial SD: the geometric mean over the cells of its groups."""
    from percept.inference.model.predictions import cells_of_subjects

    if "sigma_e" not in scales or "phi" not in scales:
        return
    cells = cells_of_subjects(model).T
    weights = cells / cells.sum(axis=0)
    trial_sd = np.exp(np.log(scales["sigma_e"]) @ weights + scales["phi"])  # (S, P, N)
    for p, measured in enumerate(over_all):
        of_subjects = [
            dataclasses.replace(measured, n=1, subject=subject)
            for subject in model.statistics.subjects
        ]
        yield from _bounded(fit, {"sigma_e": trial_sd[:, p]}, of_subjects)


def _slopes(fit: Fit, model: LinearModel, points: Array, over_all: Sequence[Measured]) -> _Rows:
    """Yield how the bias grows with the reference, where there are several."""
    several = np.ptp(model.statistics.x, axis=1) > 0.0
    if not several.any():
        return
    slopes = fit.limits_of_laws(model.moments(points, model.slope_rows))
    _, sd_of_subjects = model.scales(points).get("sigma_v:trend", ((), None))
    for p in np.flatnonzero(several).tolist():
        yield from over_all[p].rows("gamma", slopes[p])
        if sd_of_subjects is not None:
            yield from _bounded(fit, {"sigma_slope": sd_of_subjects[:, [p]]}, [over_all[p]])


def _over_all(model: LinearModel, scales: Mapping[str, Array]) -> _Drawn:
    """Draws of components of variance over all environments, (S, P).

    A subject's own trend over the x decades of the references is part of sigma_w².
    """
    if "sigma_u" not in scales:
        return {}
    within = np.square(scales["sigma"]).mean(axis=2)
    if "sigma_v:trend" in scales:
        within += scales["sigma_v:trend"] ** 2 * np.square(model.statistics.x).mean(axis=1)
    drawn: _Drawn = {"sigma_u": scales["sigma_u"], "sigma_w": np.sqrt(within)}
    if "sigma_e" in scales:
        drawn["sigma_e"] = np.sqrt(np.square(scales["sigma_e"]).mean(axis=2))
    return drawn
