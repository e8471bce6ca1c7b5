"""Why Bayesian intervals differ from classical ones: the effect of each step between them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from percept.errors import RefusalError
from percept.inference.model.limits import limits_of
from percept.inference.record import Kind
from percept.results import IntervalRow, Ladder, LadderEffect
from percept.scene import Scene
from percept.study.data import Data
from percept.study.fit import Fit, fitted
from percept.study.prepare import modelled_together, prepare

#: Tolerance of the fits between the two methods: effects of a few per cent are told from noise.
_TOLERANCE = 0.05
#: Steps from the classical interval (Eq. 15; normal family) to the Bayesian one. Each model has
#: what the steps before it added; without `trials` it takes each subject's mean, and without
#: `pooling` it takes each environment by itself.
STEPS = ("prior", "trials", "pooling", "own_trials", "correlation", "scale", "sampling")


class _Interval(NamedTuple):
    """An interval of one step in its unit."""

    lower: float
    upper: float
    error: float = 0.0  # Monte Carlo error of the width

    @property
    def width(self) -> float:
        """Upper less lower limit."""
        return self.upper - self.lower

    @property
    def centre(self) -> float:
        """The midpoint."""
        return 0.5 * (self.lower + self.upper)


#: By environment, parameter and kind.
_Intervals = dict[tuple[str, str, Kind], _Interval]


def climb(data: Data, rows: Sequence[IntervalRow], fit: Fit, **how: Any) -> Ladder:
    """Fit what lies between the classical method and a study's fit; `how`: progress and store."""
    classical: _Intervals = {}
    for row in rows:
        if (row.method, row.family, row.joint) == ("classical", "normal", "marginal"):
            cell = (row.environment, row.parameter, row.kind)
            classical[cell] = _Interval(row.lower, row.upper)
    steps = _steps(data, fit)
    notes = []
    chain = [classical]
    for cause in steps[:-1]:
        found: _Intervals = {}
        apart = "correlation" in steps and cause != "correlation"
        for part in _parts(data, cause, by_mean="trials" in steps):
            one = _fitted(part, apart=apart, **how)
            if isinstance(one, str):
                names = ", ".join(part.environments)
                notes.append(f"{names}: the step of the {cause} is missing: {one}")
            else:
                found |= _measured(one)
        chain.append(found)
    chain.append(_measured(fit))
    return Ladder(tuple(_effects(steps, chain)), tuple(notes))


def _fitted(part: Data, *, apart: bool, **how: Any) -> Fit | str:
    """Fit the model of a step, quantities together or apart; or say why there is none."""
    try:
        # Contrasts are not on the ladder.
        prepared = dataclasses.replace(prepare(part, apart=apart), contrasts=())
        fit = fitted(prepared, **how)
    except RefusalError as error:
        return error.message
    return " ".join(fit.run.gate.reasons) or fit


def _steps(data: Data, fit: Fit) -> list[str]:
    """Return the steps that lead to a study's own model."""
    pooled = data.scene.model.pooling == "partial"
    groups = modelled_together(data.parameters, data.asked.together)
    pair = data.sessions.form != "summary" and any(len(group) > 1 for group in groups)
    taken = {
        "prior": pooled,
        "trials": pooled and bool(fit.repeats),
        "pooling": pooled and len(fit.environments) > 1,
        "own_trials": "phi" in fit.model.scales(fit.points[:1]),
        "correlation": pooled and pair,
        "scale": data.asked.family == "lognormal",
    }
    return [cause for cause in STEPS if taken.get(cause)] or ["sampling"]


def _parts(data: Data, cause: str, *, by_mean: bool) -> Iterator[Data]:
    """Yield what is modelled by itself at a step: environments, or the whole study."""
    tolerance = max(_TOLERANCE, data.asked.tolerance)
    scene = data.scene.with_inference(family="normal", tolerance=tolerance)
    table = data.sessions.table
    tables = [table]
    if cause == "prior" and by_mean:
        # Classical data: each subject's mean over trials.
        cell = ["environment", "subject"]
        columns = [f"{parameter}_adj" for parameter in data.parameters]
        means = table.groupby(cell, sort=False)[columns].transform("mean")
        table = table.assign(**means).drop_duplicates(cell)
    if cause in ("prior", "trials"):
        # One environment has no levels to compare.
        scene = _without(scene, "bias", "spread", "factor")
        tables = [rows for _, rows in table.groupby("environment", sort=False)]
    if cause == "pooling":
        scene = _without(scene, subjects_trial_sd=False)
    for rows in tables:
        yield Data(dataclasses.replace(data.sessions, table=rows), scene)


def _without(scene: Scene, *left_out: str, **changed: object) -> Scene:
    """Return a scene without some keys of [model] and [study], or with others in [model]."""
    model = scene.model.model_dump(exclude=set(left_out), exclude_none=True)
    study = scene.study.model_dump(exclude=set(left_out), exclude_none=True)
    return scene.with_tables(model=model | changed, study=study)


def _measured(fit: Fit) -> _Intervals:
    """Limits of a fit, with the error that those of both leave to the width."""
    found: _Intervals = {}
    cells = fit.model.cells
    for kind in fit.data.asked.kinds:
        lower, upper = fit.limits[kind]
        ends = limits_of(fit.run.estimates.names, fit.run.estimates.errors, kind, cells)
        errors = fit.scale.unit * np.stack(ends)
        if fit.scale.log:
            errors = errors * np.stack([lower, upper])
        numbers = np.stack([lower, upper, np.hypot(*errors)], axis=1)
        for (parameter, environment), of_cell in zip(cells, numbers.tolist(), strict=True):
            found[environment, parameter, kind] = _Interval(*of_cell)
    return found


def _effects(steps: Sequence[str], chain: Sequence[_Intervals]) -> Iterator[LadderEffect]:
    """Yield what each step does to each interval that all steps have, the whole first."""
    for cell in chain[0]:
        intervals = [found[cell] for found in chain if cell in found]
        if len(intervals) < len(chain):
            continue
        neighbours = [(intervals[0], intervals[-1]), *itertools.pairwise(intervals)]
        width = intervals[0].width
        environment, parameter, kind = cell
        for cause, (before, after) in zip(["all", *steps], neighbours, strict=True):
            yield LadderEffect(
                environment=environment,
                parameter=parameter,
                kind=kind,
                cause=cause,
                log_width=math.log(after.width / before.width),
                log_width_error=math.hypot(before.error / before.width, after.error / after.width),
                centre=(after.centre - before.centre) / (0.5 * width),
                centre_error=math.hypot(before.error, after.error) / width,
            )
