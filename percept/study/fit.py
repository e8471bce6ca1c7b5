"""The hierarchical fit of a study: a model of sessions, its sampled posterior and intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

import percept
from percept.errors import RefusalError
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.contrasts import ContrastEstimands
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments, Resolution
from percept.inference.hierarchy.models import IntervalEstimands, Model, Product, Unpooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Options
from percept.inference.hierarchy.statistics import Statistics, from_summary
from percept.inference.record import Family
from percept.inference.sampling.gate import Progress, Run, Settings
from percept.results import IntervalRow
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import IMPEDANCE, Quantities
from percept.study.basics import Array, References, Skipped, Stream, claim_of, generator
from percept.study.intervals import bayesian_row, cell_moments, known_moments
from percept.study.responses import (
    ResponseScale,
    Trials,
    decades,
    references,
    refuse_no_ratio,
    resolution_of,
    trials,
)

__all__ = [
    "Fit",
    "Prepared",
    "RunStore",
    "bayesian_rows",
    "estimands_of",
    "fit_of",
    "modelled_together",
    "pooled",
    "posterior_tree",
    "prepare",
    "prepare_apart",
    "sampled",
]


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """A model of a study, not yet sampled."""

    model: Model  # The posterior
    scale: ResponseScale  # The way from responses to the units of the quantities
    counts: NDArray[np.int64]  # (C,) Subjects behind each cell
    repeats: bool | None  # Whether any cell holds more than one trial; None where it is not known
    trials: Trials | None = None  # None for published limits and without pooling
    approximate: bool = False  # Whether moments of logarithms were matched to published limits
    quantities: Quantities = dataclasses.field(default_factory=lambda: IMPEDANCE)
    skipped: tuple[Skipped, ...] = ()  # Trials and environments that are not in the model


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fit(Prepared):
    """A sampled posterior of C cells, each a parameter in an environment, and its limits."""

    run: Run  #: Draws, diagnostics and the verdict of the gate
    limits: dict[str, tuple[Array, Array]]  #: Lower and upper limits (C,) by kind, in their units

    @property
    def passed(self) -> bool:
        """Whether the numbers may be reported."""
        return self.run.gate.passed

    @property
    def withheld(self) -> str:
        """Why the numbers are withheld, and which settings help; empty where they are not."""
        if self.passed:
            return ""
        simpler = " or ".join(simpler_models(self.model))
        helps = f" A model with fewer scales mixes faster: {simpler}." if simpler else ""
        return " ".join(self.run.gate.reasons) + helps

    @cached_property
    def points(self) -> Array:
        """Coordinates thinned to the effective size, ensemble after ensemble, shape (S, d)."""
        kept = self.run.independent()
        return kept.reshape(-1, kept.shape[-1])

    @cached_property
    def moments(self) -> ConditionalMoments:
        """Moments per kept draw and cell, on the response scale."""
        components = self.run.components
        flat = components.reshape(-1, components.shape[-1])
        return ConditionalMoments.unpack(flat)

    @cached_property
    def estimate(self) -> Array:
        """Posterior mean of each population's mean, in its unit, shape (C,)."""
        posterior_mean = self.moments.mean.mean(axis=0)
        return self.scale.native(posterior_mean)

    @cached_property
    def column(self) -> dict[tuple[str, str], int]:
        """Number of each cell, (parameter, environment)."""
        return {cell: c for c, cell in enumerate(self.model.cells)}

    def pairs(self, values: Array) -> dict[str, tuple[Array, Array]]:
        """Stiffness and damping of each environment, from values (..., C)."""
        of = {cell: values[..., c] for cell, c in self.column.items()}
        return {e: (of["k", e], of["b", e]) for e in self.environments}

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
        parts = self.model.pooled_parts(self.points)
        if self.trials is None or len(parts) != 1:
            needed = "they need the sessions of subjects, pooled over environments"
            return Skipped("checks of the model", needed)
        data = self.trials
        ((density, _),) = parts
        return SubjectDensity(density, data.response, data.subject, data.environment)


class RunStore(Protocol):
    """Keeps finished runs, so that none is sampled twice."""

    def find(self, asked: tuple[object, ...]) -> Run | None:
        """Return the kept run of what is asked."""

    def keep(self, asked: tuple[object, ...], run: Run) -> None:
        """Keep the run of what is asked."""


def estimands_of(model: Model, asked: InferenceTable) -> IntervalEstimands:
    """Limits of the intervals that the scene asks for."""
    return IntervalEstimands(model, kinds=asked.kinds, **claim_of(asked))


def simpler_models(model: Model) -> list[str]:
    """Name the settings of the scene that leave a model fewer scales to sample."""
    settings = []
    if model.takes_options and any(name.startswith("omega") for name in model.names):
        settings.append("[model] common_spread = true")
    names = list(dict.fromkeys(parameter for parameter, _ in model.cells))
    if len(names) == 2:
        settings.append(f'[inference] parameters = ["{names[0]}"] or ["{names[1]}"]')
    return settings


def fit_of(prepared: Prepared, asked: InferenceTable, run: Run) -> Fit:
    """Put a model and its finished run together, with the limits that the scene asks for."""
    responses = run.estimates.value.reshape(len(asked.kinds), 2, -1)
    native = prepared.scale.native(responses)
    limits = {str(kind): (native[i, 0], native[i, 1]) for i, kind in enumerate(asked.kinds)}
    return Fit(**vars(prepared), run=run, limits=limits)


def sampled(
    model: Model,
    asked: InferenceTable,
    estimands: IntervalEstimands | ContrastEstimands | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> Run:
    """Sample a model until the limits meet the scene's tolerance, or find the run in the store."""
    estimands = estimands or estimands_of(model, asked)
    settings = Settings(
        tolerance=asked.tolerance,
        seed=asked.seed,
        walkers=asked.walkers,
        most_steps=asked.most_steps,
    )
    larger = f"[inference] tolerance above {asked.tolerance:g}"
    quicker = ", or ".join([*simpler_models(model), larger])

    def told(state: Progress) -> None:
        if progress:
            progress(dataclasses.replace(state, quicker=quicker))

    question = (model.identity(), estimands.identity(), dataclasses.astuple(settings))
    run = store.find(question) if store else None
    if run is None:
        # A run found in the store needs no sampler.
        from percept.inference.sampling.run import sample

        run = sample(model, estimands, settings, progress=told)
        if store:
            store.keep(question, run)
    # In one order in memory: a sum's last bits then depend on the draws alone, kept or just made.
    points = np.ascontiguousarray(run.points)
    components = np.ascontiguousarray(run.components)
    return dataclasses.replace(run, points=points, components=components)


def bayesian_rows(
    fit: Fit, asked: InferenceTable, reference: References, users: tuple[str, str]
) -> Iterator[IntervalRow | Skipped]:
    """Yield a row of the interval table for every interval of a fit that passed."""
    yield from fit.skipped
    if not fit.passed:
        yield Skipped("Bayesian intervals", fit.withheld)
        return
    if len(fit.parameters) == 2:
        symbols = [fit.quantities[parameter].symbol for parameter in fit.parameters]
        names = " and ".join(symbols)
        what = f"Bayesian intervals of {names} widened to hold together (bonferroni)"
        yield Skipped(what, "the sampler holds only single limits to the tolerance")
    for kind in asked.kinds:
        lower, upper = fit.limits[kind]
        for cell, c in fit.column.items():
            limits = (lower[c], upper[c], fit.estimate[c])
            n = int(fit.counts[c])
            rest: Any = {
                "n": n,
                "repeats": fit.repeats,
                "approximate": fit.approximate,
                "users": users,
            }
            unit = fit.quantities[cell[0]].unit
            yield bayesian_row(asked, kind, cell, limits, reference[cell], unit, **rest)


def prepare(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Build the model that the data and the scene ask for."""
    if scene.model.pooling == "none":
        return _unpooled(sessions, scene, parameters)
    if sessions.form == "summary":
        return _from_limits(sessions, scene, parameters)
    groups = modelled_together(parameters, scene.inference.together)
    partial = scene.inference.method == "both"
    studied = [trials(sessions, scene, group, partial=partial) for group in groups]
    models = [pooled(data.statistics, scene, data.reference, data.scale, data) for data in studied]
    return models[0] if len(models) == 1 else _side_by_side(models)


def prepare_apart(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Build a model in which no parameter learns from another."""
    return _side_by_side([prepare(sessions, scene, (parameter,)) for parameter in parameters])


def modelled_together(
    parameters: tuple[str, ...], named: tuple[str, ...] | None
) -> list[tuple[str, ...]]:
    """Group parameters by model: one or two share one; of more, the two that are named."""
    if len(parameters) < 3:
        return [parameters]
    pair = tuple(parameter for parameter in parameters if parameter in (named or ()))
    groups = []
    for parameter in parameters:
        with_other = parameter in pair and len(pair) == 2
        groups.append(pair if with_other else (parameter,))
    return list(dict.fromkeys(groups))


def _side_by_side(models: list[Prepared]) -> Prepared:
    """Put models of different parameters together, the cells of each in a row."""
    origin = np.concatenate([m.scale.origin for m in models])
    unit = np.concatenate([m.scale.unit for m in models])
    why = "two are modelled together at most; [inference] together names them"
    skipped = [Skipped("correlations of more than two parameters", why)]
    skipped += dict.fromkeys(part for m in models for part in m.skipped)
    return Prepared(
        Product([m.model for m in models]),
        ResponseScale(models[0].scale.log, origin, unit),
        np.concatenate([m.counts for m in models]),
        any(m.repeats for m in models),
        quantities=models[0].quantities,
        skipped=tuple(skipped),
    )


def pooled(
    statistics: Statistics,
    scene: Scene,
    reference: Array,
    scale: ResponseScale,
    data: Trials | None = None,
) -> Prepared:
    """Build the hierarchical model of subjects' trials from their statistics."""
    resolution = resolution_of(statistics, scene, reference, scale)
    counts = np.isfinite(statistics.cell_means).sum(axis=0).ravel()
    return Prepared(
        _model(statistics, scene, resolution),
        scale,
        counts,
        statistics.repeats,
        data,
        quantities=scene.quantities,
        skipped=data.skipped if data else (),
    )


def _model(
    statistics: Statistics, scene: Scene, resolution: Resolution | None = None
) -> CollapsedDensity:
    table = scene.model
    options = Options(
        subject_effect=table.subject_effect, weber=table.weber, common_spread=table.common_spread
    )
    return CollapsedDensity(statistics, Priors(**table.priors), options, resolution)


def _from_limits(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Model each parameter of published limits by itself: limits hold no correlation."""
    environments = sessions.environments
    family = scene.inference.family
    reference = references(sessions, parameters, environments)
    quantities = sessions.quantities
    moments = _all_moments(sessions, parameters, family)
    by_cell = dict(zip(moments.cells, reference.ravel().tolist(), strict=True))
    refuse_no_ratio(by_cell, quantities)
    mean = moments.mean.reshape(reference.shape)
    sd = moments.sd.reshape(reference.shape)
    if family == "lognormal":
        mean = mean - np.log(reference)
    else:
        mean = (mean - reference) / reference
        sd = sd / reference
    n = moments.counts.reshape(reference.shape)
    rows = zip(parameters, mean, sd, n, decades(reference), strict=True)
    models = []
    for parameter, *row in rows:
        statistics = from_summary(*row, parameter=parameter, environments=environments)
        models.append(_model(statistics, scene))
    return Prepared(
        Product(models),
        ResponseScale.of(reference, family),
        moments.counts,
        repeats=None,
        approximate=family == "lognormal",
        quantities=quantities,
    )


def _unpooled(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Prepared:
    """Each cell by itself, standardised by its own exact mean and SD."""
    moments = _all_moments(sessions, parameters, scene.inference.family)
    log = scene.inference.family == "lognormal"
    origin = np.exp(moments.mean) if log else moments.mean
    scale = ResponseScale(log, origin, moments.sd)
    model = Unpooled(moments.cells, moments.counts)
    quantities = sessions.quantities
    return Prepared(model, scale, moments.counts, moments.repeats, quantities=quantities)


class _CellMoments(NamedTuple):
    """Moments of C cells on the family's scale."""

    cells: tuple[tuple[str, str], ...]  # Parameter and environment
    mean: Array  # (C,)
    sd: Array  # (C,)
    counts: NDArray[np.int64]  # (C,) Subjects
    repeats: bool  # Whether any cell holds more than one trial of a subject


def _all_moments(sessions: Sessions, parameters: tuple[str, ...], family: Family) -> _CellMoments:
    """Work out the moments of every cell, or refuse a cell that has none."""
    cells = cell_moments(sessions, parameters, family)
    for cell in cells:
        if cell.moments is None:
            message = f"there is no posterior of {cell.where}: {cell.why}."
            hint = 'Set family = "normal", or leave the parameter or environment out in the scene.'
            raise RefusalError(message, hint=hint)
    known = known_moments(cells, family)
    moments = list(known.values())
    return _CellMoments(
        tuple(known),
        np.array([m.mean for m in moments]),
        np.array([m.sd for m in moments]),
        np.array([m.n for m in moments]),
        any(m.repeats for m in moments),
    )


def posterior_tree(fit: Fit, *, seed: int) -> Any:
    """Collect scales, correlations, locations and new users, one chain per ensemble."""
    import xarray

    points = fit.points
    grid = (len(fit.parameters), len(fit.environments))
    means, users = fit.model.draw(points, generator(seed, Stream.LOCATIONS))
    # Parameters that are modelled apart may have other environments.
    flat_index = []
    for parameter, environment in fit.model.cells:
        row = fit.parameters.index(parameter)
        column = fit.environments.index(environment)
        flat_index.append(row * grid[1] + column)

    def in_cells(responses: Array) -> tuple[Sequence[str], Array]:
        whole = np.full((len(points), *grid), np.nan)
        flat = whole.reshape(len(points), -1)
        flat[:, flat_index] = fit.scale.native(responses)
        return ("parameter", "environment"), whole

    # By group and variable: dimensions after the draw, and values (draws, ...).
    groups: dict[str, Mapping[str, tuple[Sequence[str], Array]]] = {
        "posterior": {"population_mean": in_cells(means), **fit.model.scales(points)},
        "posterior_predictive": {"new_user": in_cells(users)},
        "sample_stats": {"lp": ((), fit.model(points))},
    }
    labels = {
        "parameter": fit.parameters,
        "environment": fit.environments,
        "cell": [f"{p} in {e}" for p, e in fit.model.cells],
    }
    made_by = {"creation_library": "percept", "creation_library_version": percept.__version__}
    chains = len(fit.run.points)
    found = {}
    for group, named in groups.items():
        variables = {}
        for name, (dims, values) in named.items():
            by_chain = np.reshape(values, (chains, -1, *values.shape[1:]))
            variables[name] = (("chain", "draw", *dims), by_chain)
        dataset = xarray.Dataset(variables, attrs=made_by)
        coords = {dim: labels.get(str(dim), np.arange(size)) for dim, size in dataset.sizes.items()}
        found[group] = dataset.assign_coords(coords)
    return xarray.DataTree.from_dict(found)
