"""Bayesian rows of the psychophysics table, from the posterior of a fit.

A fit has one model of all its quantities, or one model for each. A model has P quantities in J
environments and N subjects. Its P J cells stand quantity by quantity: all environments of the
first one come first. All SDs are of responses:

- `sigma_u`: between subjects, in the effect that a subject has in all environments;
- `sigma`: between subjects, in what else each has in one environment (rows call it `sigma_w`);
- `population_sd`: between users in one environment: both together, and effects of factors;
- `sigma_e`: between trials of one subject, a typical one if subjects have trial SDs of their own.

There are S draws of the scales. Some R of them are independent, and stand for what takes long to
draw or to solve. Given a draw a location is normal, so limits of points of equality are roots of
mixtures. Scales and reliabilities have quantiles of draws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from percept.inference.model.model import LinearModel
from percept.inference.model.predictions import trend_rows
from percept.inference.model.subjects import cells_of_subjects
from percept.results import PsychophysicsRow
from percept.study.basics import Array, Stream, generator
from percept.study.data import Data
from percept.study.fit import Fit
from percept.study.psychophysics.limits import DrawLimits, bounded_means
from percept.study.psychophysics.site import Site, exp, mapped


def posterior_psychophysics(fit: Fit, data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the Bayesian rows of a fit that passed."""
    scene = data.scene
    sites = _sites(fit, data)
    level = scene.inference.level
    independent = fit.points
    limits = DrawLimits(level, effective=len(independent))
    points_of_equality = bounded_means(fit.moments, level, limits.effective)
    population_sd = fit.moments.population_sd
    for cell, c in fit.column.items():
        site = sites[cell]
        pse = mapped(points_of_equality[c], _to_native(fit, c))
        yield site.row("pse", pse, site.quantity.unit)
        yield from site.of_subjects(limits.of(population_sd[:, c]))
    rng = generator(scene.inference.seed, Stream.PSYCHOPHYSICS)
    locations, _ = fit.model.draw(independent, rng)
    every = fit.run.points.reshape(len(population_sd), -1)
    every_by_model = fit.model.split(every)
    independent_by_model = fit.model.split(independent)
    for (model, every_draw), (_, independent_draws) in zip(
        every_by_model, independent_by_model, strict=True
    ):
        columns = [fit.column[cell] for cell in model.cells]
        posterior = _Posterior(
            model=model,
            sites=[sites[cell] for cell in model.cells],
            limits=limits,
            scales=_scales_of(model, every_draw),
            population_sd=population_sd[:, columns],
            independent=independent_draws,
            locations=locations[:, columns],
            alike=not (scene.terms or scene.model.subjects_slope),
        )
        yield from posterior.rows()


def _sites(fit: Fit, data: Data) -> dict[tuple[str, str], Site]:
    """Return where the rows of each parameter and environment belong."""
    sites = {}
    for cell, c in fit.column.items():
        parameter, environment = cell
        sites[cell] = Site(
            data=data,
            parameter=parameter,
            environment=environment,
            method="bayesian",
            n=int(fit.counts[c]),
            response_unit=float(fit.scale.unit[c]),
        )
    return sites


def _to_native(fit: Fit, c: int) -> Callable[[float], float]:
    """Return the map of a cell's responses to the quantity's unit."""
    origin = float(fit.scale.origin[c])
    unit = float(fit.scale.unit[c])

    def native(response: float) -> float:
        size = response * unit
        return origin * exp(size) if fit.scale.log else origin + size

    return native


def _scales_of(model: LinearModel, points: Array) -> dict[str, Array]:
    """Draws of a model's scales, by name.

    With one environment there is no sigma_u: only the sum sigma_u² + sigma² is told by the data,
    which is population_sd².
    """
    scales = {name: scale for name, (_, scale) in model.scales(points).items()}
    if len(model.statistics.environments) == 1:
        scales.pop("sigma_u", None)
    return scales


def _trial_variance(scales: Mapping[str, Array]) -> Array:
    """Variance between trials averaged over users, (S, P, J); zero without repeats.

    phi is normal, so a user's variance is on average exp(2 omega_s²) times sigma_e².
    """
    if "sigma_e" not in scales:
        return np.zeros_like(scales["sigma"])
    of_typical_user = np.square(scales["sigma_e"])
    if "omega_s" not in scales:
        return of_typical_user
    return of_typical_user * np.exp(2.0 * scales["omega_s"] ** 2)[:, :, None]


@dataclasses.dataclass(frozen=True, eq=False)
class _Posterior:
    """Draws of one model, and where its rows belong."""

    model: LinearModel
    sites: list[Site]  # P J, of the cells
    limits: DrawLimits
    #: S draws: sigma (S, P, J), sigma_u (S, P), of repeats sigma_e (S, P, J). If trial SDs are
    #: subjects' own: phi (S, P, N), the log of theirs over sigma_e, and its SD omega_s (S, P).
    scales: Mapping[str, Array]
    population_sd: Array  # (S, P J)
    independent: Array  # (R, d) Coordinates of the independent draws
    locations: Array  # (R, P J) Drawn
    alike: bool  # Whether a subject's effects are the same in all cells

    def rows(self) -> Iterator[PsychophysicsRow]:
        """Yield all rows but those that every cell of a fit has."""
        yield from self._cell_rows()
        yield from self._subject_rows()
        yield from self._slope_rows()
        yield from self._overall_rows()
        if len(self.model.statistics.parameters) == 2:
            yield from self._correlation_rows()

    @property
    def _overall_sites(self) -> list[Site]:
        """Where rows of every quantity over all environments belong."""
        statistics = self.model.statistics
        of_quantities = self.sites[:: len(statistics.environments)]
        return [site.over_all(len(statistics.subjects)) for site in of_quantities]

    def _cell_rows(self) -> Iterator[PsychophysicsRow]:
        """Yield components of variance and the reliability of each cell.

        ICC(1) is population_sd²/(population_sd² + the average variance between trials).
        """
        if "sigma_u" in self.scales:
            sigma = self.scales["sigma"].reshape(self.population_sd.shape)
            for c, site in enumerate(self.sites):
                yield site.sigma("sigma_w", self.limits.of(sigma[:, c]))
        if "sigma_e" not in self.scales:
            return
        sigma_e = self.scales["sigma_e"].reshape(self.population_sd.shape)
        of_users = self.population_sd**2
        of_trials = _trial_variance(self.scales).reshape(self.population_sd.shape)
        icc = of_users / (of_users + of_trials)
        for c, site in enumerate(self.sites):
            yield from site.of_trials(self.limits.of(sigma_e[:, c]))
            yield site.row("icc_1", self.limits.of(icc[:, c]))

    def _subject_rows(self) -> Iterator[PsychophysicsRow]:
        """Yield each subject's own trial SD: the geometric mean over the cells of its groups."""
        if "sigma_e" not in self.scales or "phi" not in self.scales:
            return
        own = cells_of_subjects(self.model).T
        mean_log_sd = np.log(self.scales["sigma_e"]) @ (own / own.sum(axis=0))
        trial_sd = np.exp(mean_log_sd + self.scales["phi"])  # (S, P, N)
        for p, site in enumerate(self._overall_sites):
            for i, subject in enumerate(self.model.statistics.subjects):
                of_subject = site.of_subject(subject)
                yield from of_subject.of_own_trials(self.limits.of(trial_sd[:, p, i]))

    def _slope_rows(self) -> Iterator[PsychophysicsRow]:
        """Yield how the bias grows with the reference, where there are several."""
        several = np.ptp(self.model.statistics.x, axis=1) > 0.0
        if not several.any():
            return
        # Trends of all levels of factors have the same slope: the first one's tells it.
        _, slope_rows = next(iter(trend_rows(self.model).values()))
        moments = self.model.moments(self.independent, slope_rows)
        slopes = bounded_means(moments, self.limits.level, self.limits.effective)
        scales = self.model.scales(self.independent)
        _, sd_of_subjects = scales.get("sigma_v:trend", ((), None))
        for p, site in enumerate(self._overall_sites):
            if not several[p]:
                continue
            yield site.row("gamma", slopes[p])
            if sd_of_subjects is not None:
                yield site.row("sigma_slope", self.limits.of(sd_of_subjects[:, p]))

    def _overall_rows(self) -> Iterator[PsychophysicsRow]:
        """Yield components of variance and reliability over all environments.

        With r trials a cell, total = sigma_u² + mean sigma² + mean variance between trials/r.
        ICC(C,1) is sigma_u²/total. In ICC(A,1) the total has the variance of the environments'
        locations too.
        """
        scales = _scales_of(self.model, self.independent)
        if "sigma_u" not in scales:
            return
        # There are several environments, or there were no sigma_u: the variance over them exists.
        by_environment = self.locations.reshape(scales["sigma"].shape)
        of_environments = by_environment.var(axis=2, ddof=1)
        of_subjects = scales["sigma_u"] ** 2
        within = np.square(scales["sigma"]).mean(axis=2)
        of_trials = _trial_variance(scales).mean(axis=2)
        total = of_subjects + within + of_trials / _mean_trials(self.model)
        consistency = of_subjects / total
        agreement = of_subjects / (total + of_environments)
        for p, site in enumerate(self._overall_sites):
            yield site.sigma("sigma_u", self.limits.of(scales["sigma_u"][:, p]))
            yield site.sigma("sigma_w", self.limits.of(np.sqrt(within[:, p])))
            if "sigma_e" in scales:
                of_typical_user = np.square(scales["sigma_e"][:, p]).mean(axis=1)
                yield site.sigma("sigma_e", self.limits.of(np.sqrt(of_typical_user)))
            # With factors and slopes subjects also differ in effects that both ratios leave out.
            if self.alike:
                yield site.row("icc_c1", self.limits.of(consistency[:, p]))
                yield site.row("icc_a1", self.limits.of(agreement[:, p]))

    def _correlation_rows(self) -> Iterator[PsychophysicsRow]:
        """Yield the correlation of both quantities between users, environment by environment."""
        statistics = self.model.statistics
        users = self.model.joint(self.independent, self.model.pair_rows).users
        covariance = users[..., 0, 1]
        variances = np.diagonal(users, axis1=2, axis2=3)
        correlation = covariance / np.sqrt(variances.prod(axis=2))
        of_first_quantity = self.sites[: len(statistics.environments)]
        for site, draws in zip(of_first_quantity, correlation.T, strict=True):
            row = site.row("correlation", self.limits.of(draws))
            yield dataclasses.replace(row, parameter=", ".join(statistics.parameters))


def _mean_trials(model: LinearModel) -> float:
    """Harmonic mean of the numbers of trials of all cells."""
    cells = 0.0
    sum_of_inverses = 0.0
    for pattern in model.statistics.patterns:
        cells += pattern.subjects * pattern.trials.size
        inverses_of_subject = float((1.0 / pattern.trials).sum())
        sum_of_inverses += pattern.subjects * inverses_of_subject
    return cells / sum_of_inverses
