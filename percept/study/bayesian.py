"""The hierarchical fit of a study: from sessions to a sampled posterior."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.classical.moments import Moments
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments, Resolution
from percept.inference.hierarchy.models import IntervalEstimands, Model, Pooled, Product, Unpooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Options
from percept.inference.hierarchy.statistics import Statistics, from_summary, from_trials
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import Progress, Run
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.classical import Cell, cell_moments
from percept.study.responses import ResponseScale, Trials, decades, references, refuse_no_ratio, trials
from percept.study.scatter import lacking_scatter
from percept.study.units import NAMES

Array = NDArray[np.float64]
#: Beyond so many, proposals are hardly ever accepted and judging a run takes as long as making it.
_MOST_COORDINATES = 128


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """A model of a study, not yet sampled."""

    model: Model  # The posterior
    scale: ResponseScale  # The way from responses to N/m and N·s/m
    counts: NDArray[np.int64]  # (C,) Subjects behind each cell
    repeats: bool | None  # Whether any cell holds more than one trial
    trials: Trials | None  # The trials


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A sampled posterior and its interval limits."""

    prepared: Prepared  # What was sampled
    run: Run  # Draws, diagnostics and verdict
    limits: dict[str, tuple[Array, Array]]  # Lower and upper limits (C,) per kind, N/m or N·s/m
    estimate: Array  # (C,) Posterior mean of the population's mean on the model's scale, in N/m or N·s/m


class RunStore(Protocol):
    """Keeps finished runs, so that none is sampled twice."""

    def run(self, asked: tuple[object, ...], compute: Callable[[], Run]) -> Run:
        """Return the kept run of what is asked, or compute and keep it."""


def prepare(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Build the model that the data and the scene ask for."""
    if scene.model.pooling == "none":
        return _unpooled(sessions, scene, parameters)
    if sessions.form == "summary":
        return _from_limits(sessions, scene, parameters)
    data = trials(sessions, scene, parameters)
    statistics = from_trials(
        data.response,
        data.subject,
        data.environment,
        data.x,
        parameters=parameters,
        environments=data.environments,
        subjects=data.subjects,
    )
    return pooled(statistics, scene, data.reference, data.scale, data)


def pooled(
    statistics: Statistics,
    scene: Scene,
    reference: Array,
    scale: ResponseScale,
    data: Trials | None = None,
) -> Prepared:
    """Build the hierarchical model of subjects' trials from their statistics."""
    resolution = _resolution(statistics, scene, reference, scale)
    density = CollapsedDensity(statistics, Priors(**scene.model.priors), _options(scene), resolution)
    counts = np.isfinite(statistics.cell_means).sum(axis=0).ravel()
    return Prepared(Pooled(density), scale, counts, statistics.repeats, data)


def fit(
    prepared: Prepared,
    scene: Scene,
    *,
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> Fit:
    """Sample a prepared model to the scene's tolerance."""
    coordinates = len(prepared.model.names)
    if coordinates > _MOST_COORDINATES:
        raise RefusalError(
            f"{len(prepared.model.cells)} cells (parameters times environments) make {coordinates} "
            f"coordinates to sample; beyond {_MOST_COORDINATES} that takes hours.",
            hint='Use method = "classical", one parameter at a time, or fewer environments.',
        )
    asked = scene.inference
    estimands = IntervalEstimands(
        prepared.model,
        kinds=asked.kinds,
        level=asked.level,
        share=asked.held_share,
        confidence=asked.confidence,
    )
    settings = Settings(
        tolerance=asked.tolerance, seed=asked.seed, walkers=asked.walkers, most_steps=asked.most_steps
    )

    def sampled() -> Run:
        from percept.inference.sampling.run import sample

        run = sample(prepared.model, estimands, settings, progress=progress)
        # In one order in memory: a sum's last bits then depend on the draws alone, kept or just made.
        points, components = np.ascontiguousarray(run.points), np.ascontiguousarray(run.components)
        return dataclasses.replace(run, points=points, components=components)

    question = (prepared.model.identity(), estimands.identity(), dataclasses.astuple(settings))
    run = store.run(question, sampled) if store is not None else sampled()
    laws = ConditionalMoments.unpack(run.components.reshape(-1, run.components.shape[-1]))
    native = prepared.scale.native(run.estimates.value.reshape(len(asked.kinds), 2, -1))
    limits = {str(kind): (native[i, 0], native[i, 1]) for i, kind in enumerate(asked.kinds)}
    return Fit(prepared, run, limits, prepared.scale.native(laws.mean.mean(axis=0)))


def _options(scene: Scene) -> Options:
    model = scene.model
    return Options(subject_effect=model.subject_effect, weber=model.weber, common_spread=model.common_spread)


def _resolution(statistics: Statistics, scene: Scene, reference: Array, scale: ResponseScale) -> Resolution:
    """Step²/12 on the response scale, in cells whose scatter is less than the step shows; or refuse those.

    Rounding is part of the scatter that is seen: there the variance would count twice.
    """
    steps = dict(scene.model.resolution)
    lacking = lacking_scatter(statistics, steps)
    if not (lacking.between.any() or lacking.trial.any()):
        return Resolution()
    if scene.inference.family == "lognormal":
        unit = reference * np.exp(np.nanmean(statistics.cell_means, axis=0))
    else:
        unit = scale.unit.reshape(reference.shape)
    size = np.array([steps.get(p, 0.0) for p in statistics.parameters])  # type: ignore[call-overload]
    variance = (size[:, None] / unit) ** 2 / 12.0
    return Resolution(
        between=np.where(lacking.between, variance, 0.0), trial=np.where(lacking.trial, variance, 0.0)
    )


def _from_limits(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Model each parameter of published limits by itself: limits hold no correlation."""
    environments = sessions.environments
    reference = references(sessions, parameters, environments)
    named = [(p, e) for p in parameters for e in environments]
    refuse_no_ratio(dict(zip(named, reference.ravel().tolist(), strict=True)))
    x = decades(reference)
    family = scene.inference.family
    found = {(cell.parameter, cell.environment): cell for cell in cell_moments(sessions, parameters, family)}
    models: list[Model] = []
    counts: list[int] = []
    for p, parameter in enumerate(parameters):
        cells = [_moments(found[parameter, e]).on_scale(family) for e in environments]
        mean = np.array([float(cell.mean) for cell in cells])
        sd = np.array([float(cell.sd) for cell in cells])
        n = np.array([int(cell.n) for cell in cells])
        if family == "lognormal":
            mean = mean - np.log(reference[p])
        else:
            mean, sd = (mean - reference[p]) / reference[p], sd / reference[p]
        statistics = from_summary(mean, sd, n, x[p], parameter=parameter, environments=environments)
        models.append(Pooled(CollapsedDensity(statistics, Priors(**scene.model.priors), _options(scene))))
        counts += n.tolist()
    scale = ResponseScale.of(reference, family)
    return Prepared(Product(models), scale, np.array(counts), None, None)


def _moments(cell: Cell) -> Moments:
    if cell.moments is None:
        raise RefusalError(
            f"there is no posterior of {NAMES[cell.parameter]} in {cell.environment}: {cell.why}.",
            hint='Set family = "normal", or leave the parameter or environment out in the scene.',
        )
    return cell.moments


def _unpooled(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Each cell by itself, standardised by its own exact mean and SD."""
    family = scene.inference.family
    cells, origin, unit, counts, repeats = [], [], [], [], False
    for cell in cell_moments(sessions, parameters, family):
        moments = _moments(cell).on_scale(family)
        cells.append((cell.parameter, cell.environment))
        origin.append(float(moments.mean))
        unit.append(float(moments.sd))
        counts.append(int(moments.n))
        repeats = repeats or bool(moments.repeats)
    log = family == "lognormal"
    scale = ResponseScale(log, np.exp(origin) if log else np.array(origin), np.array(unit))
    return Prepared(Unpooled(tuple(cells), np.array(counts)), scale, np.array(counts), repeats, None)
