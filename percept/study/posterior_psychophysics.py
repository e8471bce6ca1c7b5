"""Bayesian rows of the psychophysics table, and of verdicts on JNDs, from the posterior of a fit.

A fit has one model of all its quantities, or one model for each. A model has P quantities in J
environments and N subjects. Its P J cells stand quantity by quantity: all environments of the
first one come first. All SDs are of responses:

- `sigma_u`: between subjects, in the effect that a subject has in all environments;
- `sigma`: between subjects, in what else each has in one environment (rows call it `sigma_w`);
- `population_sd`: between users in one environment: both together, and effects of factors;
- `sigma_e`: between trials of one subject, a typical one if subjects have trial SDs of their own;
- `phi`: the log of a subject's trial SD over sigma_e, with the SD `omega_s`.

There are S draws of the scales. Some R of them are independent, and stand for what takes long to
draw or to solve. Given a draw a location is normal, so limits of points of equality are roots of
mixtures. Scales and reliabilities have quantiles of draws.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.classical.variability import Bounded
from percept.inference.model.gaussian import Moments
from percept.inference.model.model import LinearModel
from percept.inference.model.predictions import cells_of_subjects, trend_rows
from percept.inference.record import FloatOrArray
from percept.inference.sampling.endpoints import batch_errors, mixture_limits
from percept.results import EquivalenceRow, Measure, PsychophysicsRow, Skipped
from percept.study.basics import Array
from percept.study.fit import Fit
from percept.study.psychophysics import (
    Measured,
    ends_of_jnd,
    equivalence_row,
    jnd_in_unit,
    jnds_of,
)

#: Monte Carlo errors by which a probability must pass the one that decides.
_SURE = 2.0
_Rows = Iterator[PsychophysicsRow]
#: Draws, (S, cells) or (S, quantities), by what they are of.
_Drawn = dict[Measure, Array]


@dataclasses.dataclass(frozen=True)
class DrawLimits:
    """Estimate and limits of draws, with the limits' Monte Carlo error.

    What is slow to mix, such as an SD near zero, errs by more than as many independent draws would.
    Batches of walkers are independent, and their scatter tells by how much.
    """

    level: float
    batch: NDArray[np.intp]  # (S,) Batch of walkers that each draw is from

    def of(self, draws: Array) -> Bounded:
        """Bound what is drawn, (S,), by its median and quantiles.

        The quantiles at one error of the share of draws below a limit, to either side, say how far
        the limit errs.
        """
        tails = 0.5 * np.array([1.0 - self.level, 1.0 + self.level])
        limits = np.quantile(draws, tails)
        off = batch_errors(draws[:, None] < limits, self.batch)
        beside = np.quantile(draws, np.clip([tails - off, tails + off], 0.0, 1.0))
        return Bounded(
            estimate=float(np.median(draws)),
            lower=float(limits[0]),
            upper=float(limits[1]),
            error=float(0.5 * np.max(beside[1] - beside[0])),
        )

    def of_laws(self, laws: Moments) -> list[Bounded]:
        """Bound what is normal given each draw, (S, L), by roots of mixtures."""
        lower, upper, influence = mixture_limits(laws.mean, laws.sd, 0.5 * (1.0 - self.level))
        error = batch_errors(influence, self.batch).reshape(2, -1).max(axis=0)
        estimate = laws.mean.mean(axis=0)
        by_law = np.stack([estimate, lower, upper, error], axis=1)
        return [Bounded(*numbers) for numbers in by_law.tolist()]


def posterior_psychophysics(fit: Fit) -> _Rows:
    """Yield the Bayesian rows of a fit that passed."""
    level = fit.data.asked.level
    of_every_draw = DrawLimits(level, fit.run.batches(every=True))
    limits = DrawLimits(level, fit.run.batches())
    measured = list(_cells(fit))
    population_sd = fit.moments.population_sd
    yield from _rows({"sd_subjects": population_sd}, measured, of_every_draw)
    every = fit.run.points.reshape(len(population_sd), -1)
    parts = zip(fit.model.split(every), fit.model.split(fit.points), strict=True)
    first = 0
    for (model, every_draw), (_, points) in parts:
        last = first + len(model.cells)
        of_cells = measured[first:last]
        scales = _scales_of(model, every_draw)
        drawn = _of_cells(scales, population_sd[:, first:last])
        yield from _rows(drawn, of_cells, of_every_draw)
        statistics = model.statistics
        n = len(statistics.subjects)
        over_all = [
            dataclasses.replace(cell, environment=None, n=n)
            for cell in of_cells[:: len(statistics.environments)]
        ]
        yield from _of_subjects(model, scales, over_all, of_every_draw)
        yield from _slopes(model, points, over_all, limits)
        yield from _rows(_over_all(model, scales), over_all, of_every_draw)
        if len(statistics.parameters) == 2:
            yield from _correlations(model, points, of_cells, limits)
        first = last


def _cells(fit: Fit) -> Iterator[Measured]:
    """Yield what is measured in every cell."""
    cells = zip(fit.model.cells, fit.counts.tolist(), fit.scale.unit.tolist(), strict=True)
    for (parameter, environment), n, unit in cells:
        yield Measured(
            data=fit.data,
            method="bayesian",
            parameter=parameter,
            environment=environment,
            n=n,
            unit=unit,
        )


def _rows(
    drawn: _Drawn,
    measured: Sequence[Measured],
    limits: DrawLimits,
) -> _Rows:
    """Yield the rows of draws of each quantity measured."""
    for measure, draws in drawn.items():
        for one, column in zip(measured, draws.T, strict=True):
            yield from one.rows(measure, limits.of(column))


def _scales_of(model: LinearModel, points: Array) -> dict[str, Array]:
    """Draws of a model's scales, by name: (S, P), (S, P, J) or (S, P, N).

    With one environment there is no sigma_u: only the sum sigma_u² + sigma² is told by the data,
    which is population_sd².
    """
    scales = {name: scale for name, (_, scale) in model.scales(points).items()}
    if len(model.statistics.environments) == 1:
        scales.pop("sigma_u", None)
    return scales


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
    model: LinearModel,
    scales: Mapping[str, Array],
    over_all: Sequence[Measured],
    limits: DrawLimits,
) -> _Rows:
    """Yield each subject's own trial SD: the geometric mean over the cells of its groups."""
    if "sigma_e" not in scales or "phi" not in scales:
        return
    cells = cells_of_subjects(model).T
    weights = cells / cells.sum(axis=0)
    mean_log_sd = np.log(scales["sigma_e"]) @ weights
    trial_sd = np.exp(mean_log_sd + scales["phi"])  # (S, P, N)
    for p, measured in enumerate(over_all):
        for i, subject in enumerate(model.statistics.subjects):
            of_subject = dataclasses.replace(measured, n=1, subject=subject)
            yield from of_subject.rows("sigma_e", limits.of(trial_sd[:, p, i]))


def _slopes(
    model: LinearModel,
    points: Array,
    over_all: Sequence[Measured],
    limits: DrawLimits,
) -> _Rows:
    """Yield how the bias grows with the reference, where there are several."""
    several = np.ptp(model.statistics.x, axis=1) > 0.0
    if not several.any():
        return
    # Trends of all levels of factors have the same slope: the first one's tells it.
    _, slope_rows = next(iter(trend_rows(model).values()))
    slopes = limits.of_laws(model.moments(points, slope_rows))
    _, sd_of_subjects = model.scales(points).get("sigma_v:trend", ((), None))
    for p in np.flatnonzero(several).tolist():
        yield from over_all[p].rows("gamma", slopes[p])
        if sd_of_subjects is not None:
            yield from over_all[p].rows("sigma_slope", limits.of(sd_of_subjects[:, p]))


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


def _correlations(
    model: LinearModel,
    points: Array,
    of_cells: Sequence[Measured],
    limits: DrawLimits,
) -> _Rows:
    """Yield the correlation of both quantities between users, environment by environment."""
    users = model.joint(points, model.pair_rows).users
    variances = np.diagonal(users, axis1=2, axis2=3)
    correlation = users[..., 0, 1] / np.sqrt(variances.prod(axis=2))
    both = ", ".join(model.statistics.parameters)
    for measured, draws in zip(of_cells, correlation.T, strict=False):
        of_pair = dataclasses.replace(measured, parameter=both)
        yield from of_pair.rows("correlation", limits.of(draws))


def posterior_equivalence(fit: Fit) -> Iterator[EquivalenceRow | Skipped]:
    """Yield whether biases are smaller than one JND, by their posterior probability."""
    jnds = jnds_of(fit.data)
    trial_sds = _trial_sds(fit) if "trials" in jnds.values() else {}
    for cell in fit.model.cells:
        if cell[0] in jnds:
            yield _judged(fit, cell, trial_sds.get(cell))


def _judged(
    fit: Fit,
    where: tuple[str, str],
    trial_sd: Array | None,
) -> EquivalenceRow | Skipped:
    """Judge a cell of a fit that passed; `trial_sd` has its draws of the SD between trials."""
    data = fit.data
    c = fit.column[where]
    scale = fit.scale.at(c)
    size: float | None = None
    jnd: FloatOrArray
    if data.scene.study.jnd[where[0]] == "trials":
        if trial_sd is None:
            what = f"whether {data.quantities[where[0]].label} of {where[1]} is within one JND"
            return Skipped(f"{what} from trials", "without repeated trials there is none")
        jnd = scale.native(trial_sd) - scale.origin
    else:
        found = jnd_in_unit(data, where)
        if isinstance(found, Skipped):
            return found
        jnd = size = found
    ends = (ends_of_jnd(data.reference[where], jnd, log=scale.log) - scale.centre) / scale.unit
    mean = fit.moments.mean[:, c]
    sd = fit.moments.sd[:, c]
    inside = special.ndtr((ends[1] - mean) / sd) - special.ndtr((ends[0] - mean) / sd)
    probability = float(inside.mean())
    error = float(inside.std()) / math.sqrt(len(fit.points))
    decisive = data.asked.decision + _SURE * error
    return equivalence_row(
        data,
        where,
        "bayesian",
        size,
        is_within=probability >= decisive,
        is_beyond=1.0 - probability >= decisive,
        probability=probability,
        error=error,
    )


def _trial_sds(fit: Fit) -> dict[tuple[str, str], Array]:
    """Return every cell's draws of the SD between trials; empty without repeats."""
    points = fit.run.points.reshape(len(fit.moments.mean), -1)
    sds: dict[tuple[str, str], Array] = {}
    for model, coordinates in fit.model.split(points):
        draws = _scales_of(model, coordinates).get("sigma_e")
        if draws is not None:
            sds |= zip(model.cells, draws.reshape(len(draws), -1).T, strict=True)
    return sds
