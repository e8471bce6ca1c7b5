"""From sessions and a scene to the model that is sampled: one for every kind of study."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.model.design import Options
from percept.inference.model.model import LinearModel, Model, Resolution, plain_model
from percept.inference.model.product import Product, Unpooled
from percept.inference.model.statistics import Statistics, from_summary
from percept.results import Skipped
from percept.scene import Scene
from percept.sessions.quantities import IMPEDANCE, Quantities
from percept.study.basics import Array, priors_of
from percept.study.data import Data
from percept.study.linear import ContrastPlan, linear_study, side_by_side
from percept.study.responses import (
    ResponseScale,
    Trials,
    decades,
    refuse_no_ratio,
    resolution_of,
)
from percept.study.subject_trials import subject_trials


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
    contrasts: ContrastPlan | None = None  # Of factors and covariates; None without these


def prepare(data: Data, parameters: tuple[str, ...] | None = None) -> Prepared:
    """Build the model that the data and the scene ask for, of some parameters or of all."""
    parameters = parameters or data.parameters
    if data.scene.model.pooling == "none":
        return _unpooled(data, parameters)
    if data.sessions.form == "summary":
        return _from_limits(data, parameters)
    groups = modelled_together(parameters, data.asked.together)
    models = [_of_group(data, group) for group in groups]
    return models[0] if len(models) == 1 else _side_by_side(models)


def prepared_beside(data: Data) -> Prepared | Skipped:
    """Build the model; skip a refused one where classical intervals of some cell stand without."""
    try:
        return prepare(data)
    except RefusalError as refused:
        known = any(cell.moments for of_family in data.cells.values() for cell in of_family)
        if data.asked.method != "both" or not known:
            raise
        return Skipped("Bayesian intervals", str(refused))


def _of_group(data: Data, parameters: tuple[str, ...]) -> Prepared:
    """Model the trials of quantities that share a model."""
    scene = data.scene
    compares = bool(scene.terms) or scene.model.subjects_slope
    scaled = tuple(p for p in parameters if data.by_difference(p)) if compares else ()
    trials = data.trials(*parameters, partial=data.asked.method == "both", scaled=scaled)
    trial_sds = subject_trials(trials, scene)
    if not (compares or trial_sds.own):
        prepared = pooled(trials.statistics, scene, trials.reference, trials.scale, trials)
    else:
        resolution = resolution_of(trials.statistics, scene, trials.reference, trials.scale)
        plan = linear_study(trials, data, resolution, own_trial_sds=trial_sds.own)
        prepared = _of_trials(plan.model, trials.statistics, trials.scale, scene, trials)
        if compares:
            prepared = dataclasses.replace(prepared, contrasts=plan)
    return dataclasses.replace(prepared, skipped=(*prepared.skipped, *trial_sds.skipped))


def prepare_apart(data: Data) -> Prepared:
    """Build a model in which no parameter learns from another."""
    return _side_by_side([prepare(data, (parameter,)) for parameter in data.parameters])


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
    plans = [m.contrasts for m in models if m.contrasts is not None]
    plan = side_by_side(plans) if plans else None
    return Prepared(
        plan.model if plan else Product([m.model for m in models]),
        ResponseScale(models[0].scale.log, origin, unit),
        np.concatenate([m.counts for m in models]),
        any(m.repeats for m in models),
        quantities=models[0].quantities,
        skipped=tuple(skipped),
        contrasts=plan,
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
    return _of_trials(_model(statistics, scene, resolution), statistics, scale, scene, data)


def _of_trials(
    model: Model, statistics: Statistics, scale: ResponseScale, scene: Scene, data: Trials | None
) -> Prepared:
    """Put a model of subjects' trials together with what its cells rest on."""
    counts = np.isfinite(statistics.cell_means).sum(axis=0).ravel()
    return Prepared(
        model,
        scale,
        counts,
        statistics.repeats,
        data,
        quantities=scene.quantities,
        skipped=data.skipped if data else (),
    )


def _model(
    statistics: Statistics, scene: Scene, resolution: Resolution | None = None
) -> LinearModel:
    table = scene.model
    options = Options(
        subject_effect=table.subject_effect, weber=table.weber, common_spread=table.common_spread
    )
    priors = priors_of(scene, statistics.parameters)
    return plain_model(statistics, priors, options, resolution)


def _from_limits(data: Data, parameters: tuple[str, ...]) -> Prepared:
    """Model each parameter of published limits by itself: limits hold no correlation."""
    scene = data.scene
    environments = data.environments
    family = data.asked.family
    reference = np.array([[data.reference[p, e] for e in environments] for p in parameters])
    quantities = data.quantities
    moments = _all_moments(data, parameters)
    flat = reference.ravel().tolist()
    by_cell = dict(zip(moments.cells, flat, strict=True))
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


def _unpooled(data: Data, parameters: tuple[str, ...]) -> Prepared:
    """Each cell by itself, standardised by its own exact mean and SD."""
    moments = _all_moments(data, parameters)
    log = data.asked.family == "lognormal"
    origin = np.exp(moments.mean) if log else moments.mean
    scale = ResponseScale(log, origin, moments.sd)
    model = Unpooled(moments.cells, moments.counts)
    return Prepared(model, scale, moments.counts, moments.repeats, quantities=data.quantities)


class _CellMoments(NamedTuple):
    """Moments of C cells on the family's scale."""

    cells: tuple[tuple[str, str], ...]  # Parameter and environment
    mean: Array  # (C,)
    sd: Array  # (C,)
    counts: NDArray[np.int64]  # (C,) Subjects
    repeats: bool  # Whether any cell holds more than one trial of a subject


def _all_moments(data: Data, parameters: tuple[str, ...]) -> _CellMoments:
    """Work out the moments of every cell, or refuse a cell that has none."""
    family = data.asked.family
    for cell in data.cells[family]:
        if cell.parameter in parameters and cell.moments is None:
            message = f"there is no posterior of {cell.where}: {cell.why}."
            hint = 'Set family = "normal", or leave the parameter or environment out in the scene.'
            raise RefusalError(message, hint=hint)
    of_all = data.moments(family)
    moments = {cell: found for cell, found in of_all.items() if cell[0] in parameters}
    return _CellMoments(
        tuple(moments),
        np.array([m.mean for m in moments.values()]),
        np.array([m.sd for m in moments.values()]),
        np.array([m.n for m in moments.values()]),
        any(m.repeats for m in moments.values()),
    )
