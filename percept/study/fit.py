"""The hierarchical fit of a study: its sampled posterior, and the intervals of its cells."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.classical.variability import Bounded
from percept.inference.left_out import LeftOut, SubjectDensity
from percept.inference.model.gaussian import Moments
from percept.inference.model.limits import Combinations, Limits, limits_of
from percept.inference.sampling.endpoints import batch_errors, mixture_limits
from percept.inference.sampling.gate import Progress, Run, Settings
from percept.results import Skipped
from percept.study.basics import Array, Stream, claim_of, generator
from percept.study.prepare import Prepared

#: Draws of users, at most: a probability of 0.95 is known to 0.003 by them.
MOST_DRAWS = 4096


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fit(Prepared):
    """A sampled posterior of C cells, each a parameter in an environment, and its limits."""

    run: Run  #: Draws, diagnostics and the verdict of the gate
    limits: dict[str, Array]  #: Lower and upper limits (2, C) by kind, in their units

    @property
    def passed(self) -> bool:
        """Whether the numbers may be reported."""
        return self.run.gate.passed

    @property
    def withheld(self) -> str:
        """Why the numbers are withheld, and which settings help; empty where they are not."""
        if self.passed:
            return ""
        simpler = " or ".join(simpler_models(self))
        helps = f" A model with fewer scales mixes faster: {simpler}." if simpler else ""
        return " ".join(self.run.gate.reasons) + helps

    @cached_property
    def points(self) -> Array:
        """Coordinates thinned to the effective size, ensemble after ensemble, shape (S, d)."""
        return self.run.independent()

    @cached_property
    def shuffled(self) -> Array:
        """The first of these in random order, as users are drawn with, shape (S, d)."""
        rng = generator(self.data.asked.seed, Stream.USERS)
        return rng.permutation(self.points)[:MOST_DRAWS]

    @cached_property
    def every_point(self) -> Array:
        """All kept coordinates, ensemble after ensemble, shape (S, d)."""
        return self.run.points.reshape(-1, self.run.points.shape[-1])

    @cached_property
    def _batch(self) -> dict[int, NDArray[np.intp]]:
        """Batch of walkers that each draw is from, of `every_point` or `points`, by their number.

        What is slow to mix, such as an SD near zero, errs by more than as many independent draws
        would. Batches of walkers are independent, and their scatter tells by how much.
        """
        batches = (self.run.batches(every=True), self.run.batches())
        return {len(batch): batch for batch in batches}

    def limits_of_draws(self, draws: Array) -> Bounded:
        """Bound what is drawn at `every_point` or `points`, (S,), by its median and quantiles.

        The quantiles at one error of the share of draws below a limit, to either side, say how far
        the limit errs.
        """
        level = self.data.asked.level
        tails = 0.5 * np.array([1.0 - level, 1.0 + level])
        lower, upper = np.quantile(draws, tails).tolist()
        off = batch_errors(draws[:, None] < [lower, upper], self._batch[len(draws)])
        beside = np.quantile(draws, np.clip([tails - off, tails + off], 0.0, 1.0))
        error = float(0.5 * np.max(beside[1] - beside[0]))
        return Bounded(float(np.median(draws)), lower, upper, error)

    def limits_of_laws(self, laws: Moments) -> list[Bounded]:
        """Bound what is normal given each of the draws, (S, L), by roots of mixtures."""
        tail = 0.5 * (1.0 - self.data.asked.level)
        lower, upper, influence = mixture_limits(laws.mean, laws.sd, tail)
        error = batch_errors(influence, self._batch[len(influence)]).reshape(2, -1).max(axis=0)
        by_law = np.stack([laws.mean.mean(axis=0), lower, upper, error], axis=1)
        return [Bounded(*numbers) for numbers in by_law.tolist()]

    @cached_property
    def all_moments(self) -> Moments:
        """Moments per kept draw of cells and then contrasts, on the response scale."""
        kept = self.run.components
        return Moments.unpack(kept.reshape(-1, kept.shape[-1]))

    @cached_property
    def moments(self) -> Moments:
        """Moments per kept draw and cell, on the response scale."""
        return self.all_moments.of(slice(len(self.model.cells)))

    @cached_property
    def estimate(self) -> Array:
        """Posterior mean of each population's mean, in its unit, shape (C,)."""
        posterior_mean = self.moments.mean.mean(axis=0)
        return self.scale.native(posterior_mean)

    @cached_property
    def column(self) -> dict[tuple[str, str], int]:
        """Number of each cell, (parameter, environment)."""
        return {cell: c for c, cell in enumerate(self.model.cells)}

    @cached_property
    def trial_sds(self) -> dict[tuple[str, str], Array]:
        """SD between trials in each cell with repeated ones, at `every_point`, (S,) responses."""
        found: dict[tuple[str, str], Array] = {}
        for model, points in self.model.split(self.every_point):
            scales = model.scales(points)
            if "sigma_e" in scales:
                _, sds = scales["sigma_e"]
                found |= zip(model.cells, sds.reshape(len(sds), -1).T, strict=True)
        return found

    def pair(self, environment: str) -> list[int]:
        """Numbers of the cells of stiffness and damping in an environment."""
        return [self.column["k", environment], self.column["b", environment]]

    @property
    def parameters(self) -> list[str]:
        """Parameters of the model."""
        return list(dict.fromkeys(parameter for parameter, _ in self.model.cells))

    @property
    def environments(self) -> list[str]:
        """Environments of the model: those in which every parameter was adjusted."""
        return list(dict.fromkeys(environment for _, environment in self.model.cells))

    @cached_property
    def subjects(self) -> SubjectDensity | Skipped:
        """Densities of the subjects' data under the pooled model of sessions."""
        parts = self.model.split(self.points)
        if self.trials is None or len(parts) != 1:
            needed = "they need the sessions of subjects, pooled over environments"
            return Skipped("checks of the model", needed)
        ((density, _),) = parts
        if density.statistics.covariates is not None:
            return Skipped("checks of the model", "they do not follow covariates")
        trials = self.trials
        return SubjectDensity(density, trials.response, trials.subject, trials.environment)

    @cached_property
    def left_out(self) -> LeftOut:
        """Each of the `subjects` predicted from the others, at the first of `shuffled`."""
        assert not isinstance(self.subjects, Skipped)
        return self.subjects.left_out(self.shuffled[: self.subjects.most_draws])


class RunStore(Protocol):
    """Keeps finished runs, so that none is sampled twice."""

    def find(self, asked: tuple[object, ...]) -> Run | None:
        """Return the kept run of what is asked."""

    def keep(self, asked: tuple[object, ...], run: Run) -> None:
        """Keep the run of what is asked."""


def simpler_models(prepared: Prepared) -> list[str]:
    """Name the settings of the scene that leave a model fewer scales to sample."""
    model = prepared.model
    settings = []
    if any(name.startswith("omega_s") for name in model.names):
        settings.append("[model] subjects_trial_sd = false")
    elif not prepared.data.scene.terms and any(name.startswith("omega") for name in model.names):
        settings.append("[model] common_spread = true")
    names = list(dict.fromkeys(parameter for parameter, _ in model.cells))
    if len(names) == 2:
        settings.append(f'[inference] parameters = ["{names[0]}"] or ["{names[1]}"]')
    return settings


def fitted(
    prepared: Prepared,
    *,
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> Fit:
    """Sample a model until its limits meet the scene's tolerance, or find its run in the store."""
    asked = prepared.data.asked
    model = prepared.model
    further = []
    for contrasts, kinds in prepared.sums:
        names = tuple(contrast.name for contrast in contrasts)
        rows = np.array([contrast.row for contrast in contrasts])
        further.append(Combinations(names, rows, kinds))
    estimands = Limits(model, kinds=asked.kinds, **claim_of(asked), further=tuple(further))
    settings = Settings(
        tolerance=asked.tolerance,
        seed=asked.seed,
        most_steps=asked.most_steps,
    )
    larger = f"[inference] tolerance above {asked.tolerance:g}"
    quicker = ", or ".join([*simpler_models(prepared), larger])

    def report_state(state: Progress) -> None:
        if progress:
            progress(dataclasses.replace(state, quicker=quicker))

    question = (model.identity(), estimands.identity(), dataclasses.astuple(settings))
    run = store.find(question) if store else None
    if run is None:
        # A run found in the store needs no sampler.
        from percept.inference.sampling.run import sample

        run = sample(model, estimands, settings, progress=report_state)
        if store:
            store.keep(question, run)
    # In one order in memory: a sum's last bits then depend on the draws alone, kept or just made.
    points = np.ascontiguousarray(run.points)
    components = np.ascontiguousarray(run.components)
    limits = {}
    for kind in asked.kinds:
        ends = limits_of(run.estimates.names, run.estimates.value, kind, model.cells)
        limits[str(kind)] = prepared.scale.native(np.stack(ends))
    run = dataclasses.replace(run, points=points, components=components)
    return Fit(**vars(prepared), run=run, limits=limits)
