"""Bayesian contrasts of conditions within subjects: a model for each quantity and pair of levels."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from percept.errors import RefusalError
from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import from_trials
from percept.inference.hierarchy.within import WithinSubjects
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.records import Factor
from percept.study.basics import Skipped, claim_of
from percept.study.contrast import contrast_row
from percept.study.fit import sampled
from percept.study.intervals import Row
from percept.study.responses import lacking_scatter, trials


def bayesian_contrasts(
    sessions: Sessions, parameters: tuple[str, ...], scene: Scene, **how: Any
) -> Iterator[Row | Skipped]:
    """Yield the contrasts of every pair of levels from the model of conditions within subjects."""
    factor = sessions.factor
    assert factor is not None
    for parameter in parameters:
        for pair in factor.pairs:
            label = sessions.quantities[parameter].label
            what = f"Bayesian contrast of {label}, {pair[1]} against {pair[0]}"
            try:
                yield from _of_pair(sessions, parameter, scene, factor, pair, what, **how)
            except RefusalError as refused:
                yield Skipped(what, str(refused))


def prepare_within(
    sessions: Sessions, parameter: str, scene: Scene, factor: Factor, pair: tuple[str, str]
) -> WithinSubjects:
    """Build the model of one quantity at two levels, of the references that have both."""
    if scene.model.pooling == "none":
        raise RefusalError('it needs [model] pooling = "partial".')
    known = sessions.table[sessions.table[f"{parameter}_adj"].notna()]
    present = set(known["environment"])
    names = [e for e in factor.environments if all(factor.cell(e, level) in present for level in pair)]
    if len(names) < 2:
        raise RefusalError("it needs two references that have both levels.")
    cells = [factor.cell(e, level) for e in names for level in pair]
    data = trials(
        dataclasses.replace(sessions, table=known[known["environment"].isin(cells)]), scene, (parameter,)
    )
    statistics = from_trials(
        data.response, data.subject, data.environment, data.x,
        parameters=(parameter,), environments=data.environments, subjects=data.subjects,
    )  # fmt: skip
    lacking_scatter(statistics, (), sessions.quantities)
    at = [factor.cells[cell] for cell in data.environments]
    return WithinSubjects(
        statistics,
        np.array([names.index(environment) for environment, _ in at]),
        np.array([level == pair[1] for _, level in at]),
        names=tuple(names),
        priors=Priors(**scene.model.priors),
    )


def _of_pair(
    sessions: Sessions,
    parameter: str,
    scene: Scene,
    factor: Factor,
    pair: tuple[str, str],
    what: str,
    **how: Any,
) -> Iterator[Row | Skipped]:
    """Yield the rows of one quantity and two levels."""
    asked, quantity = scene.inference, sessions.quantities[parameter]
    model = prepare_within(sessions, parameter, scene, factor, pair)
    run = sampled(model, IntervalEstimands(model, kinds=asked.kinds, **claim_of(asked)), asked, **how)
    if not run.gate.passed:
        yield Skipped(what, " ".join(run.gate.reasons))
        return
    laws = ConditionalMoments.unpack(run.components.reshape(-1, run.components.shape[-1]))
    limits = run.estimates.value.reshape(len(asked.kinds), 2, -1)
    kept = run.independent()
    tails = [0.5 * (1.0 - asked.level), 0.5 * (1.0 + asked.level), 0.5]
    spreads = np.quantile(model.spread_ratios(kept.reshape(-1, kept.shape[-1])), tails, axis=0)
    names = [name for _, name in model.cells[:-1]]
    paired = _paired(model)
    for c, name in enumerate([*names, None]):
        cell: Row = {"factor": factor.name, "first": pair[0], "second": pair[1], "parameter": parameter}
        cell |= {"environment": name, "references": names if name is None else [name]}
        for kind, (lower, upper) in zip(asked.kinds, limits[..., c], strict=True):
            ends = [float(lower), float(upper), float(laws.mean[:, c].mean())]
            yield contrast_row(
                cell, asked, quantity, ends, paired[c], of="bias", kind=kind, method="bayesian"
            )
        ends = spreads[:, c].tolist()
        yield contrast_row(cell, asked, quantity, ends, paired[c], of="spread", kind=None, method="bayesian")


def _paired(model: WithinSubjects) -> list[int]:
    """Subjects with both levels at each reference, and at any."""
    there = np.isfinite(model.statistics.cell_means[:, 0])
    both = [there[:, model.reference == j].all(axis=1) for j in range(len(model.cells) - 1)]
    return [int(own.sum()) for own in (*both, np.any(both, axis=0))]
