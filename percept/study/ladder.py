"""Why Bayesian intervals differ from classical ones: the effect of each step between them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from percept.errors import RefusalError
from percept.html import NotebookRecord
from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    thin_walkers,
)
from percept.results import BandPair
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantities
from percept.study.band_pairs import LimitErrors, compare_bands
from percept.study.boundaries import BoundaryDrawing
from percept.study.fit import Fit, estimands_of, fit_of, sampled
from percept.study.prepare import modelled_together, prepare, prepare_apart
from percept.study.regions import Region

__all__ = ["USERS", "Ladder", "band_pairs", "climb", "sentence"]

#: Tolerance of the fits between the two methods: effects of a few per cent are told from noise.
_TOLERANCE = 0.05
#: Effects under this number of standard errors, or smaller than these, are not named.
_ERRORS = 2.0
_LEAST = {"log_width": 0.02, "centre": 0.05}
USERS = {"mean": "the average {user}", "user": "the next {user}", "share": "most {users}"}
_CLAUSES = {
    "prior": "the priors say how {users} usually adjust",
    "trials": "the model tells trial noise from differences between {users}",
    "pooling": "the model also learns from the other {environments}",
    "own_trials": "each {user} has a trial SD of their own",
    "correlation": "the model also learns from the other quantity",
    "scale": "the log scale makes the typical {user} the geometric mean",
    "sampling": "draws are random",
}
_OF_USERS = {
    "trials": "the model leaves trial noise out",
    "scale": "{users} scatter by ratios on the log scale",
}
#: Steps that model each environment by itself.
_BY_ENVIRONMENT = ("prior", "trials")


@dataclasses.dataclass(frozen=True, eq=False)
class Ladder(NotebookRecord):
    """The steps from the classical interval (Eq. 15; normal family) to the Bayesian one."""

    #: A row per environment, parameter, kind and `cause`, the whole difference first. `log_width`
    #: is the log ratio of widths, `centre` the shift of the midpoint in classical half-widths;
    #: errors are Monte Carlo's.
    effects: pd.DataFrame
    #: The difference in words, per environment and parameter: of the first kind, and with repeats
    #: of the next user too.
    sentences: tuple[str, ...]
    notes: tuple[str, ...] = ()  # Environments without a ladder, and why


class _Interval(NamedTuple):
    """An interval of one step in its unit, with Monte Carlo errors."""

    width: float
    centre: float
    width_error: float = 0.0  # Of the logarithm
    centre_error: float = 0.0


_CELL = ["environment", "parameter", "kind"]
_COLUMNS = [*_CELL, "cause", "log_width", "log_width_error", "centre", "centre_error"]
_Cell = tuple[str, str, str]  # Environment, parameter and kind


def climb(
    sessions: Sessions,
    scene: Scene,
    parameters: tuple[str, ...],
    intervals: pd.DataFrame,
    fit: Fit,
    **how: Any,
) -> Ladder:
    """Fit what lies between the classical method and a study's fit; `how`: progress and store."""
    asked = scene.inference
    normal = scene.with_inference(family="normal", tolerance=max(_TOLERANCE, asked.tolerance))
    alone = _without_terms(normal)
    pooled = scene.model.pooling == "partial"
    groups = modelled_together(parameters, asked.together)
    pair = sessions.form != "summary" and any(len(group) > 1 for group in groups)
    climbed = {
        "prior": pooled,
        "trials": pooled and bool(fit.repeats),
        "pooling": pooled and len(fit.environments) > 1,
        "own_trials": "phi" in fit.model.scales(fit.points[:1]),
        "correlation": pooled and pair,
        "scale": asked.family == "lognormal",
    }
    *before, last = [cause for cause, needed in climbed.items() if needed] or ["sampling"]
    notes: list[str] = []
    steps: dict[str, dict[_Cell, _Interval]] = {}
    for cause in before:
        steps[cause] = {}
        table = sessions.table
        if cause == "prior" and climbed["trials"]:
            table = _subject_means(table, parameters)
        tables = [table]
        model_scene = normal
        if cause in _BY_ENVIRONMENT:
            model_scene = alone
            tables = [rows for _, rows in table.groupby("environment", sort=False)]
        if cause == "pooling":
            model_scene = _with_one_trial_sd(normal)
        build = prepare
        if climbed["correlation"] and cause != "correlation":
            build = prepare_apart
        for table in tables:
            part = dataclasses.replace(sessions, table=table)
            try:
                # Contrasts are not on the ladder.
                model = dataclasses.replace(build(part, model_scene, parameters), contrasts=None)
                one = fit_of(model, normal.inference, sampled(model.model, normal.inference, **how))
                why = " ".join(one.run.gate.reasons)
            except RefusalError as error:
                why = error.message
            if why:
                names = ", ".join(part.environments)
                notes.append(f"{names}: the step of the {cause} is missing: {why}")
            else:
                steps[cause] |= _measured(one, normal.inference)
    steps[last] = _measured(fit, asked)
    classical = intervals.query(
        "method == 'classical' and family == 'normal' and joint == 'marginal'"
    )
    start = {
        (e, p, kind): _Interval(upper - lower, 0.5 * (lower + upper))
        for e, p, kind, lower, upper in classical[[*_CELL, "lower", "upper"]].to_numpy().tolist()
    }
    effects = pd.DataFrame(_effects(start, steps), columns=_COLUMNS)
    kinds = {asked.kinds[0]}
    if climbed["trials"]:
        kinds.add("user")  # The mean's interval holds trial noise by both methods
    first = effects[effects["kind"].isin(kinds)].groupby(_CELL, sort=False)
    words = _words(scene)
    told = [sentence(rows, fit.quantities, words) for _, rows in first]
    return Ladder(effects, tuple(told), tuple(notes))


def _without_terms(scene: Scene) -> Scene:
    """Return a scene without factors and covariates: one environment has no levels to compare."""
    model = scene.model.model_dump(exclude={"bias", "spread", "subjects_slope"}, exclude_none=True)
    study = scene.study.model_dump(exclude={"factor"}, exclude_none=True)
    return scene.with_tables(model=model, study=study)


def _with_one_trial_sd(scene: Scene) -> Scene:
    """Return a scene in which all subjects share a trial SD."""
    model = scene.model.model_dump(exclude_none=True) | {"subjects_trial_sd": False}
    return scene.with_tables(model=model)


def _subject_means(table: pd.DataFrame, parameters: tuple[str, ...]) -> pd.DataFrame:
    """Keep one row per subject and environment, with the mean over trials: classical data."""
    cell = ["environment", "subject"]
    columns = [f"{parameter}_adj" for parameter in parameters]
    means = table.groupby(cell, sort=False)[columns].transform("mean")
    return table.assign(**means).drop_duplicates(cell)


def band_pairs(
    fit: Fit, drawing: BoundaryDrawing, regions: Collection[Region], asked: InferenceTable
) -> tuple[BandPair, ...]:
    """Compare the bands of abs(Z_h) of both methods, with the error of a fit's limits."""
    errors = {}
    for cell, interval in _measured(fit, asked).items():
        half_width = 0.5 * interval.width * interval.width_error
        errors[cell] = LimitErrors(interval.centre_error, half_width)
    return tuple(compare_bands(drawing, regions, errors))


def _measured(fit: Fit, asked: InferenceTable) -> dict[_Cell, _Interval]:
    """Limits of a fit, with errors of log width and midpoint by the draws' influence on both."""
    components = fit.components
    scale = fit.scale
    found = {}
    flat = components.reshape(-1, components.shape[-1])
    parts = estimands_of(fit.model, asked).estimates(flat)
    for kind, (_, influence) in zip(asked.kinds, parts, strict=True):
        lower, upper = fit.limits[str(kind)]
        pulls = influence.reshape(*components.shape[:3], 2, -1) * scale.unit
        if scale.log:
            pulls *= np.stack([lower, upper])
        on_lower = pulls[..., 0, :]
        on_upper = pulls[..., 1, :]
        width = upper - lower
        centre = 0.5 * (lower + upper)
        on_width = (on_upper - on_lower) / width
        on_centre = 0.5 * (on_lower + on_upper)
        series = np.concatenate([on_width, on_centre], axis=-1)
        time = autocorrelation_time(thin_walkers(series))
        errors = monte_carlo_error(series, time).reshape(2, -1)
        values = np.stack([width, centre, *errors], axis=1).tolist()
        for (parameter, environment), c in fit.column.items():
            found[environment, parameter, str(kind)] = _Interval(*values[c])
    return found


def _effects(
    start: dict[_Cell, _Interval], steps: dict[str, dict[_Cell, _Interval]]
) -> Iterator[tuple[object, ...]]:
    """Yield what each step does to each interval that all steps have, the whole first."""
    for cell, classical in start.items():
        if any(cell not in found for found in steps.values()):
            continue
        chain = [classical, *(found[cell] for found in steps.values())]
        half = 0.5 * classical.width
        pairs = [(classical, chain[-1]), *itertools.pairwise(chain)]
        for cause, (one, other) in zip(["all", *steps], pairs, strict=True):
            log_width = math.log(other.width / one.width)
            width_error = math.hypot(one.width_error, other.width_error)
            shift = (other.centre - one.centre) / half
            shift_error = math.hypot(one.centre_error, other.centre_error) / half
            yield (*cell, cause, log_width, width_error, shift, shift_error)


def _words(scene: Scene) -> dict[str, str]:
    """Return the study's words for users and environments."""
    user, users = scene.user_noun
    return {"user": user, "users": users, "environments": scene.environment_noun[1]}


def sentence(rows: pd.DataFrame, quantities: Quantities, words: dict[str, str]) -> str:
    """Say how two intervals differ and why, from the effects on one of them."""
    whole = rows.iloc[0]
    kind = whole["kind"]
    label = quantities[whole["parameter"]].label
    width = _noted(rows, "log_width", _LEAST["log_width"])
    centre = _noted(rows, "centre", _LEAST["centre"])
    whose = USERS[kind].format(**words)
    start = f"{whole['environment']}, {label}: "
    if not width and "all" not in centre:
        within = max(_ERRORS * whole["log_width_error"], _LEAST["log_width"])
        same = f"both intervals of {whose} have the same width and centre"
        return f"{start}{same}, to within {100.0 * within:.0f} %."
    clauses = _CLAUSES | ({} if kind == "mean" else _OF_USERS)
    clauses = {cause: clause.format(**words) for cause, clause in clauses.items()}
    size = f"{_ratio(width['all'])} times as wide" if "all" in width else "as wide"
    why = _reasons(width, lambda value: f"×{_ratio(value)}", clauses)
    text = f"{start}the Bayesian interval of {whose} is {size} as the classical one{why}."
    if "all" in centre:
        side = "higher" if centre["all"] > 0 else "lower"
        why = _reasons(centre, lambda value: f"{100.0 * value:+.0f} %", clauses)
        text += (
            f" Its centre lies {100.0 * abs(centre['all']):.0f} % of the classical half-width"
            f" {side}{why}."
        )
    return text


def _noted(rows: pd.DataFrame, name: str, least: float) -> dict[str, float]:
    """Effects by cause, the largest first, without those that are small or lost in their error."""
    kept = rows[rows[name].abs() > np.maximum(least, _ERRORS * rows[f"{name}_error"])]
    order = kept[name].abs().sort_values(ascending=False, kind="stable").index
    pairs = kept.loc[order, ["cause", name]].to_numpy()
    return {str(cause): float(value) for cause, value in pairs}


def _ratio(log: float) -> str:
    return f"{np.exp(log):.2f}" if log < np.log(10.0) else f"{np.exp(log):.0f}"


def _reasons(
    effects: dict[str, float], said: Callable[[float], str], clauses: dict[str, str]
) -> str:
    """Name the causes, the largest first; of a difference, or of effects that cancel."""
    causes = [
        f"{clauses[cause]} ({said(value)})" for cause, value in effects.items() if cause != "all"
    ]
    if not causes:
        return ""
    return f"{', because' if 'all' in effects else ':'} {'; '.join(causes)}"
