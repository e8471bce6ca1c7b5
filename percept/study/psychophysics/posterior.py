"""Posterior rows of the psychophysics table.

Given a draw of the scales the location of a cell is normal, so that limits of points of equality
are roots of mixtures. Measures of the scales alone, and reliabilities, have quantiles of draws.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Self

import numpy as np

from percept.inference.classical.variability import Bounded
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Pooled
from percept.inference.sampling.endpoints import mixture_quantile
from percept.results import PsychophysicsRow
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Array, References, Stream, generator
from percept.study.fit import Fit
from percept.study.psychophysics.site import Site, mapped
from percept.study.responses import by_difference

__all__ = ["bounded_means", "posterior_psychophysics"]


def posterior_psychophysics(
    fit: Fit, sessions: Sessions, scene: Scene, reference: References
) -> Iterator[PsychophysicsRow]:
    """Yield the Bayesian rows.

    Parameters
    ----------
    fit : Fit
        A fit that passed.
    sessions : Sessions
        What it was fitted to.
    scene : Scene
        Level and family.
    reference : mapping
        By parameter and environment, in the parameter's unit.

    Yields
    ------
    PsychophysicsRow
    """
    level = scene.inference.level
    bounded = _Quantiles(level, effective=len(fit.points))
    locations = bounded_means(fit.moments, level, len(fit.points))
    users = fit.moments.population_sd
    sites = {}
    for cell, c in fit.column.items():
        parameter, environment = cell
        site = Site(
            quantity=fit.quantities[parameter],
            environment=environment,
            reference=reference[cell],
            scene=scene,
            method="bayesian",
            n=int(fit.counts[c]),
            response_unit=float(fit.scale.unit[c]),
            by_difference=sessions.form == "trials" and by_difference(sessions, parameter),
        )
        sites[cell] = site
        pse = mapped(locations[c], _to_native(fit, c))
        yield from site.of_location(pse)
        yield from site.of_subjects(bounded(users[:, c]))
    rng = generator(scene.inference.seed, Stream.PSYCHOPHYSICS)
    means, _ = fit.model.draw(fit.points, rng)
    # Quantiles of scales take every draw. What must be drawn or solved takes the independent ones.
    all_points = fit.run.points.reshape(len(users), -1)
    all_parts = fit.model.pooled_parts(all_points)
    thinned_parts = fit.model.pooled_parts(fit.points)
    for (density, every), (_, thinned) in zip(all_parts, thinned_parts, strict=True):
        model_sites = [sites[cell] for cell in density.cells]
        columns = [fit.column[cell] for cell in density.cells]
        scales = _Scales.of(density, every)
        yield from _cell_rows(scales, users[:, columns], bounded, model_sites)
        yield from _subject_rows(density, scales, bounded, model_sites)
        scales = _Scales.of(density, thinned)
        yield from _slope_rows(density, thinned, bounded, model_sites)
        yield from _overall_rows(density, scales, means[:, columns], bounded, model_sites)
        if len(density.statistics.parameters) == 2:
            yield from _correlation_rows(density, thinned, bounded, model_sites)


def _to_native(fit: Fit, c: int) -> Callable[[float], float]:
    """Return the map of a cell's responses to the quantity's unit."""
    origin = float(fit.scale.origin[c])
    unit = float(fit.scale.unit[c])

    def native(response: float) -> float:
        size = response * unit
        return origin * math.exp(size) if fit.scale.log else origin + size

    return native


def bounded_means(laws: ConditionalMoments, level: float, effective: int) -> list[Bounded]:
    """Bound what is normal given each draw, by roots of mixtures.

    The draws are worth `effective` independent ones.
    """
    tail = 0.5 * (1.0 - level)
    mean = laws.mean
    sd = laws.sd
    lower, influence_on_lower = mixture_quantile(mean, sd, tail, upper=False)
    upper, influence_on_upper = mixture_quantile(mean, sd, tail, upper=True)
    sd_of_lower = influence_on_lower.std(axis=0)
    sd_of_upper = influence_on_upper.std(axis=0)
    errors = np.maximum(sd_of_lower, sd_of_upper) / math.sqrt(effective)
    estimates = mean.mean(axis=0)
    columns = np.stack([estimates, lower, upper, errors], axis=1)
    return [Bounded(*numbers) for numbers in columns.tolist()]


@dataclasses.dataclass(frozen=True)
class _Quantiles:
    """Takes the median and both limits of draws."""

    level: float
    effective: int  # Independent draws that the draws are worth

    def __call__(self, draws: Array) -> Bounded:
        """Bound what is drawn, (S,).

        The share of draws below a quantile errs by √(tail (1 − tail)/effective). The quantiles at
        one such error to either side say how far the limit errs.
        """
        tail = 0.5 * (1.0 - self.level)
        tail_error = math.sqrt(tail * (1.0 - tail) / self.effective)
        smaller_tail = tail - tail_error
        larger_tail = tail + tail_error
        tails = np.clip([tail, smaller_tail, larger_tail], 0.0, 1.0)
        lower, lower_outside, lower_inside = np.quantile(draws, tails).tolist()
        upper, upper_outside, upper_inside = np.quantile(draws, 1.0 - tails).tolist()
        error_of_lower = 0.5 * (lower_inside - lower_outside)
        error_of_upper = 0.5 * (upper_outside - upper_inside)
        median = float(np.median(draws))
        return Bounded(median, lower, upper, error=max(error_of_lower, error_of_upper))


@dataclasses.dataclass(frozen=True, eq=False)
class _Scales:
    """Draws of the scales of P quantities in J environments that have one model."""

    between: Array  # (S, P, J) SD between subjects within an environment
    shared: Array | None  # (S, P) SD of the subject effect; None in a model without it
    trial: Array | None  # (S, P, J) SD between trials; None without repeats
    #: (S, P, N) Log SDs between trials of a subject, less those of the cells
    subject_deviations: Array | None

    @classmethod
    def of(cls, density: Pooled, coordinates: Array) -> Self:
        """Read the scales at coordinates (S, d)."""
        values = {}
        for name, (_, scale) in density.scales(coordinates).items():
            values[name] = scale
        return cls(
            between=values["sigma"],
            shared=values.get("sigma_u"),
            trial=values.get("sigma_e"),
            subject_deviations=values.get("phi"),
        )


def _cell_rows(
    scales: _Scales,
    users: Array,
    bounded: _Quantiles,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield components and reliability of each cell; SDs of its users are (S, P J)."""
    if scales.shared is not None:
        between = scales.between.reshape(users.shape)
        for c, site in enumerate(sites):
            yield site.sigma("sigma_w", bounded(between[:, c]))
    if scales.trial is None:
        return
    trial = scales.trial.reshape(users.shape)
    users_variance = users**2
    reliability = users_variance / (users_variance + trial**2)
    for c, site in enumerate(sites):
        yield from site.of_trials(bounded(trial[:, c]))
        yield site.row("icc_1", bounded(reliability[:, c]))


def _overall_rows(
    density: Pooled,
    scales: _Scales,
    means: Array,
    bounded: _Quantiles,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield components and reliability over all environments; locations are (S, P J)."""
    if scales.shared is None:
        return
    statistics = density.statistics
    locations = means.reshape(scales.between.shape)
    between_environments = locations.var(axis=2, ddof=1)
    first_sites = sites[:: len(statistics.environments)]
    shared = scales.shared**2
    within = np.square(scales.between).mean(axis=2)
    noise = np.zeros_like(within)
    if scales.trial is not None:
        noise = np.square(scales.trial).mean(axis=2)
    total = shared + within + noise / _repeats(density)
    for p, first in enumerate(first_sites):
        site = first.over_all(len(statistics.subjects))
        yield site.sigma("sigma_u", bounded(scales.shared[:, p]))
        yield site.sigma("sigma_w", bounded(np.sqrt(within[:, p])))
        if scales.trial is not None:
            yield site.sigma("sigma_e", bounded(np.sqrt(noise[:, p])))
        # With factors subjects also differ in their effects, which these two do not count.
        if isinstance(density, CollapsedDensity):
            consistency = shared / total
            agreement = shared / (total + between_environments)
            yield site.row("icc_c1", bounded(consistency[:, p]))
            yield site.row("icc_a1", bounded(agreement[:, p]))


def _slope_rows(
    density: Pooled,
    coordinates: Array,
    bounded: _Quantiles,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield how the bias grows with the reference, where there are several."""
    x = density.statistics.x
    count = x.shape[1]
    several = np.ptp(x, axis=1) > 0.0
    if not several.any():
        return
    # Conditions have one slope.
    trend = next(iter(density.trends(coordinates).values()))
    slope_sd = np.sqrt(trend.covariance[..., 1, 1])
    laws = ConditionalMoments(trend.mean[..., 1], slope_sd, np.zeros_like(slope_sd))
    of_means = bounded_means(laws, bounded.level, bounded.effective)
    _, own_sd = density.scales(coordinates).get("sigma_v:trend", ((), None))
    for p, first in enumerate(sites[::count]):
        if not several[p]:
            continue
        site = first.over_all(len(density.statistics.subjects))
        yield site.row("gamma", of_means[p])
        if own_sd is not None:
            yield site.row("sigma_slope", bounded(own_sd[:, p]))


def _subject_rows(
    density: Pooled,
    scales: _Scales,
    bounded: _Quantiles,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield each subject's own trial SD: the geometric mean over all environments."""
    if scales.trial is None or scales.subject_deviations is None:
        return
    statistics = density.statistics
    typical_log_sd = np.log(scales.trial).mean(axis=2)
    log_sd = typical_log_sd[:, :, None] + scales.subject_deviations
    trial_sd = np.exp(log_sd)
    first_sites = sites[:: len(statistics.environments)]
    for p, first in enumerate(first_sites):
        for i, subject in enumerate(statistics.subjects):
            site = first.of_subject(subject)
            yield from site.of_own_trials(bounded(trial_sd[:, p, i]))


def _repeats(density: Pooled) -> float:
    """Harmonic mean of the numbers of trials of all cells."""
    cells = 0.0
    sum_of_inverses = 0.0
    for pattern in density.statistics.patterns:
        cells += pattern.subjects * pattern.trials.size
        inverses_of_subject = float((1.0 / pattern.trials).sum())
        sum_of_inverses += pattern.subjects * inverses_of_subject
    return cells / sum_of_inverses


def _correlation_rows(
    density: Pooled,
    coordinates: Array,
    bounded: _Quantiles,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield the correlation of both quantities between users, environment by environment."""
    pair = ", ".join(density.statistics.parameters)
    users = density.pairs(coordinates).users
    covariance = users[..., 0, 1]
    variances = np.diagonal(users, axis1=2, axis2=3)
    correlation = covariance / np.sqrt(variances.prod(axis=2))
    first_sites = sites[: len(density.statistics.environments)]
    for site, draws in zip(first_sites, correlation.T, strict=True):
        row = site.row("correlation", bounded(draws))
        yield dataclasses.replace(row, parameter=pair)
