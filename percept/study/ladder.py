"""Why Bayesian intervals differ from classical ones: the effect of each step between them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from percept.errors import RefusalError
from percept.inference.model.limits import limits_of
from percept.inference.record import Kind
from percept.results import IntervalRow, Ladder, LadderEffect
from percept.study.basics import Array
from percept.study.data import Data
from percept.study.fit import Fit, fitted
from percept.study.prepare import prepare

#: Tolerance of the fits between the two methods: effects of a few per cent are told from noise.
_TOLERANCE = 0.05
#: Lower and upper limit in their unit, and the Monte Carlo error of the width, by environment,
#: parameter and kind.
_Intervals = dict[tuple[str, str, Kind], Array]


def climb(rows: Sequence[IntervalRow], fit: Fit, **how: Any) -> Ladder:
    """Fit what lies between the classical method and a study's fit; `how`: progress and store.

    The steps lead from the classical interval (Eq. 15; normal family): "prior" takes each
    environment by itself, "pooling" all of them, and "scale" the lognormal family.
    """
    data = fit.data
    classical: _Intervals = {}
    for row in rows:
        if (row.method, row.family, row.joint) == ("classical", "normal", "marginal"):
            cell = (row.environment, row.parameter, row.kind)
            classical[cell] = np.array([row.lower, row.upper, 0.0])
    is_pooled = data.scene.model.pooling == "partial"
    taken = {
        "prior": is_pooled,
        "pooling": is_pooled and len(fit.environments) > 1,
        "scale": data.asked.family == "lognormal",
    }
    steps = [cause for cause, is_taken in taken.items() if is_taken] or ["sampling"]
    chain = [classical]
    notes = []
    for cause in steps[:-1]:
        found: _Intervals = {}
        for part in _parts(data, alone=cause == "prior"):
            try:
                # Contrasts are not on the ladder.
                one = fitted(dataclasses.replace(prepare(part), contrasts=()), **how)
                why = " ".join(one.run.gate.reasons)
            except RefusalError as refused:
                why = refused.message
            if why:
                names = ", ".join(part.environments)
                notes.append(f"{names}: the step of the {cause} is missing: {why}")
            else:
                found |= _measured(one)
        chain.append(found)
    chain.append(_measured(fit))
    return Ladder(tuple(_effects(steps, chain)), tuple(notes))


def _parts(data: Data, *, alone: bool) -> Iterator[Data]:
    """Yield what is modelled by itself, in the normal family: environments, or the whole study."""
    tolerance = max(_TOLERANCE, data.asked.tolerance)
    scene = data.scene.with_inference(family="normal", tolerance=tolerance)
    table = data.sessions.table
    tables = [table]
    if alone:
        # One environment has no levels to compare.
        model = scene.model.model_dump(exclude={"bias", "spread"}, exclude_none=True)
        study = scene.study.model_dump(exclude={"factor"}, exclude_none=True)
        scene = scene.with_tables(model=model, study=study)
        tables = [rows for _, rows in table.groupby("environment", sort=False)]
    for rows in tables:
        yield Data(dataclasses.replace(data.sessions, table=rows), scene)


def _measured(fit: Fit) -> _Intervals:
    """Limits of a fit, with the error that those of both leave to the width."""
    found: _Intervals = {}
    cells = fit.model.cells
    for kind in fit.data.asked.kinds:
        limits = fit.limits[kind]
        errors = np.stack(limits_of(fit.run.estimates.names, fit.run.estimates.errors, kind, cells))
        errors = errors * fit.scale.unit * (limits if fit.scale.log else 1.0)
        numbers = np.vstack([limits, np.hypot(*errors)])
        for (parameter, environment), of_cell in zip(cells, numbers.T, strict=True):
            found[environment, parameter, kind] = of_cell
    return found


def _effects(steps: Sequence[str], chain: Sequence[_Intervals]) -> Iterator[LadderEffect]:
    """Yield what each step does to each interval that all steps have, the whole first."""
    for cell, of_classical in chain[0].items():
        if not all(cell in found for found in chain):
            continue
        half_width = 0.5 * (of_classical[1] - of_classical[0])
        lower, upper, error = np.array([found[cell] for found in chain]).T.tolist()
        environment, parameter, kind = cell
        neighbours = [(0, len(chain) - 1), *itertools.pairwise(range(len(chain)))]
        for cause, (i, j) in zip(["all", *steps], neighbours, strict=True):
            widths = [upper[i] - lower[i], upper[j] - lower[j]]
            shift = 0.5 * (upper[j] + lower[j]) - 0.5 * (upper[i] + lower[i])
            yield LadderEffect(
                environment=environment,
                parameter=parameter,
                kind=kind,
                cause=cause,
                log_width=math.log(widths[1] / widths[0]),
                log_width_error=math.hypot(error[i] / widths[0], error[j] / widths[1]),
                centre=shift / half_width,
                centre_error=math.hypot(error[i], error[j]) / (2.0 * half_width),
            )
