"""Posterior rows of the psychophysics table.

A model has P quantities in J environments and N subjects, and S draws of its scales. Its P J cells
stand quantity by quantity. Scales go by their names in docs/posterior.md, such as `sigma_u`. Given
a draw the location of a cell is normal, so that limits of points of equality are roots of mixtures.
Measures of the scales alone, and reliabilities, have quantiles of draws.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Self

import numpy as np

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Pooled
from percept.results import PsychophysicsRow
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Array, References, Stream, generator
from percept.study.fit import Fit
from percept.study.psychophysics.limits import DrawLimits, bounded_means
from percept.study.psychophysics.site import Site, mapped
from percept.study.responses import by_difference

__all__ = ["posterior_psychophysics"]


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
    sites = _sites(fit, sessions, scene, reference)
    level = scene.inference.level
    independent = fit.points
    limits = DrawLimits(level, effective=len(independent))
    pses = bounded_means(fit.moments, level, len(independent))
    user_sds = fit.moments.population_sd
    for cell, c in fit.column.items():
        site = sites[cell]
        yield from site.of_location(mapped(pses[c], _to_native(fit, c)))
        yield from site.of_subjects(limits.of(user_sds[:, c]))
    rng = generator(scene.inference.seed, Stream.PSYCHOPHYSICS)
    locations, _ = fit.model.draw(independent, rng)
    # Quantiles of scales take every draw. What must be drawn or solved takes the independent ones.
    every = fit.run.points.reshape(len(user_sds), -1)
    # Quantities without a common model have models of their own.
    models = zip(fit.model.pooled_parts(every), fit.model.pooled_parts(independent), strict=True)
    for (model, every_draw), (_, independent_draws) in models:
        own_sites = [sites[cell] for cell in model.cells]
        columns = [fit.column[cell] for cell in model.cells]
        scales = _Scales.of(model, every_draw)
        yield from _cell_rows(scales, user_sds[:, columns], limits, own_sites)
        yield from _subject_rows(model, scales, limits, own_sites)
        yield from _slope_rows(model, independent_draws, limits, own_sites)
        scales = _Scales.of(model, independent_draws)
        yield from _overall_rows(model, scales, locations[:, columns], limits, own_sites)
        if len(model.statistics.parameters) == 2:
            yield from _correlation_rows(model, independent_draws, limits, own_sites)


def _sites(
    fit: Fit, sessions: Sessions, scene: Scene, reference: References
) -> dict[tuple[str, str], Site]:
    """Return where the rows of each parameter and environment belong."""
    sites = {}
    for cell, c in fit.column.items():
        parameter, environment = cell
        sites[cell] = Site(
            quantity=fit.quantities[parameter],
            environment=environment,
            reference=reference[cell],
            scene=scene,
            method="bayesian",
            n=int(fit.counts[c]),
            response_unit=float(fit.scale.unit[c]),
            by_difference=sessions.form == "trials" and by_difference(sessions, parameter),
        )
    return sites


def _to_native(fit: Fit, c: int) -> Callable[[float], float]:
    """Return the map of a cell's responses to the quantity's unit."""
    origin = float(fit.scale.origin[c])
    unit = float(fit.scale.unit[c])

    def native(response: float) -> float:
        size = response * unit
        return origin * math.exp(size) if fit.scale.log else origin + size

    return native


@dataclasses.dataclass(frozen=True, eq=False)
class _Scales:
    """Draws of the scales of one model."""

    sigma: Array  # (S, P, J) SD between subjects within an environment
    sigma_u: Array | None  # (S, P) SD of the subject effect; None in a model without it
    sigma_e: Array | None  # (S, P, J) SD between trials; None without repeats
    phi: Array | None  # (S, P, N) Log of a subject's trial SD over sigma_e; None if all have one

    @classmethod
    def of(cls, model: Pooled, points: Array) -> Self:
        """Read the scales at coordinates (S, d)."""
        values = {}
        for name, (_, scale) in model.scales(points).items():
            values[name] = scale
        return cls(
            sigma=values["sigma"],
            sigma_u=values.get("sigma_u"),
            sigma_e=values.get("sigma_e"),
            phi=values.get("phi"),
        )


def _cell_rows(
    scales: _Scales,
    user_sds: Array,
    limits: DrawLimits,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield components and reliability of each cell; SDs of its users are (S, P J).

    ICC(1) is user_sd²/(user_sd² + sigma_e²).
    """
    if scales.sigma_u is not None:
        sigma = scales.sigma.reshape(user_sds.shape)
        for c, site in enumerate(sites):
            yield site.sigma("sigma_w", limits.of(sigma[:, c]))
    if scales.sigma_e is None:
        return
    sigma_e = scales.sigma_e.reshape(user_sds.shape)
    icc = user_sds**2 / (user_sds**2 + sigma_e**2)
    for c, site in enumerate(sites):
        yield from site.of_trials(limits.of(sigma_e[:, c]))
        yield site.row("icc_1", limits.of(icc[:, c]))


def _overall_rows(
    model: Pooled,
    scales: _Scales,
    locations: Array,
    limits: DrawLimits,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield components and reliability over all environments; locations are (S, P J).

    With r trials a cell, total = sigma_u² + mean sigma² + mean sigma_e²/r. ICC(C,1) is
    sigma_u²/total, and ICC(A,1) is sigma_u²/(total + variance of the environments' locations).
    """
    if scales.sigma_u is None:
        return
    statistics = model.statistics
    by_environment = locations.reshape(scales.sigma.shape)
    of_environments = by_environment.var(axis=2, ddof=1)
    of_subjects = scales.sigma_u**2
    within = np.square(scales.sigma).mean(axis=2)
    of_trials = np.zeros_like(within)
    if scales.sigma_e is not None:
        of_trials = np.square(scales.sigma_e).mean(axis=2)
    total = of_subjects + within + of_trials / _repeats(model)
    for p, site in enumerate(_first_sites(model, sites)):
        overall = site.over_all(len(statistics.subjects))
        yield overall.sigma("sigma_u", limits.of(scales.sigma_u[:, p]))
        yield overall.sigma("sigma_w", limits.of(np.sqrt(within[:, p])))
        if scales.sigma_e is not None:
            yield overall.sigma("sigma_e", limits.of(np.sqrt(of_trials[:, p])))
        # With factors subjects also differ in their effects, which these two do not count.
        if isinstance(model, CollapsedDensity):
            consistency = of_subjects / total
            agreement = of_subjects / (total + of_environments)
            yield overall.row("icc_c1", limits.of(consistency[:, p]))
            yield overall.row("icc_a1", limits.of(agreement[:, p]))


def _slope_rows(
    model: Pooled,
    points: Array,
    limits: DrawLimits,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield how the bias grows with the reference, where there are several."""
    several = np.ptp(model.statistics.x, axis=1) > 0.0
    if not several.any():
        return
    # Conditions have one slope.
    trend = next(iter(model.trends(points).values()))
    slope_sd = np.sqrt(trend.covariance[..., 1, 1])
    laws = ConditionalMoments(trend.mean[..., 1], slope_sd, np.zeros_like(slope_sd))
    slopes = bounded_means(laws, limits.level, limits.effective)
    _, sd_of_subjects = model.scales(points).get("sigma_v:trend", ((), None))
    for p, site in enumerate(_first_sites(model, sites)):
        if not several[p]:
            continue
        overall = site.over_all(len(model.statistics.subjects))
        yield overall.row("gamma", slopes[p])
        if sd_of_subjects is not None:
            yield overall.row("sigma_slope", limits.of(sd_of_subjects[:, p]))


def _subject_rows(
    model: Pooled,
    scales: _Scales,
    limits: DrawLimits,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield each subject's own trial SD: the geometric mean over all environments."""
    if scales.sigma_e is None or scales.phi is None:
        return
    mean_log_sd = np.log(scales.sigma_e).mean(axis=2)
    trial_sd = np.exp(mean_log_sd[:, :, None] + scales.phi)  # (S, P, N)
    for p, site in enumerate(_first_sites(model, sites)):
        for i, subject in enumerate(model.statistics.subjects):
            own = site.of_subject(subject)
            yield from own.of_own_trials(limits.of(trial_sd[:, p, i]))


def _first_sites(model: Pooled, sites: Sequence[Site]) -> Sequence[Site]:
    """Return the site of every quantity's first environment, which stands for the quantity."""
    return sites[:: len(model.statistics.environments)]


def _repeats(model: Pooled) -> float:
    """Harmonic mean of the numbers of trials of all cells."""
    cells = 0.0
    sum_of_inverses = 0.0
    for pattern in model.statistics.patterns:
        cells += pattern.subjects * pattern.trials.size
        inverses_of_subject = float((1.0 / pattern.trials).sum())
        sum_of_inverses += pattern.subjects * inverses_of_subject
    return cells / sum_of_inverses


def _correlation_rows(
    model: Pooled,
    points: Array,
    limits: DrawLimits,
    sites: Sequence[Site],
) -> Iterator[PsychophysicsRow]:
    """Yield the correlation of both quantities between users, environment by environment."""
    pair = ", ".join(model.statistics.parameters)
    users = model.pairs(points).users
    covariance = users[..., 0, 1]
    variances = np.diagonal(users, axis1=2, axis2=3)
    correlation = covariance / np.sqrt(variances.prod(axis=2))
    of_first_quantity = sites[: len(model.statistics.environments)]
    for site, draws in zip(of_first_quantity, correlation.T, strict=True):
        row = site.row("correlation", limits.of(draws))
        yield dataclasses.replace(row, parameter=pair)
