"""Why the Bayesian intervals differ from the classical: the effect of each step from one to the other."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from percept.errors import RefusalError
from percept.html import NotebookRecord
from percept.inference.sampling.diagnostics import autocorrelation_time, monte_carlo_error, some_walkers
from percept.inference.sampling.gate import Progress
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantities
from percept.study.fit import Fit, RunStore, estimands_of, fit_of, prepare, sampled

#: Tolerance of the fits between the two methods: effects of a few per cent are told from noise.
_TOLERANCE = 0.05
#: Effects under this number of standard errors, or smaller than these, are not named.
_ERRORS = 2.0
_LEAST = {"log_width": 0.02, "centre": 0.05}
_USERS = {"mean": "the average user", "user": "the next user", "share": "most users"}
_NOUNS = {"prior": "the priors", "pooling": "pooling with other environments", "scale": "the log scale"}
_CLAUSES = {
    "prior": "the priors say how users usually adjust",
    "pooling": "the model also learns from the other environments",
    "scale": "the log scale makes the typical user the geometric mean",
    "sampling": "draws are random",
}


@dataclasses.dataclass(frozen=True, eq=False)
class Ladder(NotebookRecord):
    """The steps from the classical interval (Eq. 15; normal family) to the Bayesian one.

    The causes are "prior" (each environment modelled by itself), "pooling" (all environments together) and
    "scale" (the lognormal family), in this order; "sampling" where both methods are the same. "all" is the
    whole difference. `log_width` is the log ratio of widths in its unit, `centre` the shift of the
    midpoint in half-widths of the classical interval; both have Monte Carlo standard errors.
    """

    effects: pd.DataFrame  # A row per environment, parameter, kind and `cause`
    sentences: tuple[str, ...]  # The difference in words, per environment and parameter, of the first kind
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
_Step = tuple[str, dict[_Cell, _Interval]]


def climb(
    sessions: Sessions,
    scene: Scene,
    parameters: tuple[str, ...],
    intervals: pd.DataFrame,
    fit: Fit,
    *,
    progress: Callable[[Progress], None] | None = None,
    store: RunStore | None = None,
) -> Ladder:
    """Fit the models between the classical method and a study's own fit, and measure every step."""
    asked = scene.inference
    normal = scene.with_inference(family="normal", tolerance=max(_TOLERANCE, asked.tolerance))
    pooled = scene.model.pooling == "partial"
    climbed = {
        "prior": pooled,
        "pooling": pooled and len(fit.environments) > 1,
        "scale": asked.family == "lognormal",
    }
    *before, last = [cause for cause, needed in climbed.items() if needed] or ["sampling"]
    notes: list[str] = []
    steps: list[_Step] = []
    for cause in before:
        found: dict[_Cell, _Interval] = {}
        by_itself = sessions.table.groupby("environment", sort=False)
        for table in [rows for _, rows in by_itself] if cause == "prior" else [sessions.table]:
            part = dataclasses.replace(sessions, table=table)
            try:
                model = prepare(part, normal, parameters)
                run = sampled(model.model, normal.inference, progress=progress, store=store)
                one = fit_of(model, normal.inference, run)
                why = " ".join(one.run.gate.reasons)
            except RefusalError as error:
                why = error.message
            if why:
                notes.append(f"{', '.join(part.environments)}: the step of the {cause} is missing: {why}")
            else:
                found |= _measured(one, normal.inference)
        steps.append((cause, found))
    steps.append((last, _measured(fit, asked)))
    classical = intervals.query("method == 'classical' and family == 'normal' and joint == 'marginal'")
    start = {
        (e, p, kind): _Interval(upper - lower, 0.5 * (lower + upper))
        for e, p, kind, lower, upper in classical[[*_CELL, "lower", "upper"]].to_numpy().tolist()
    }
    effects = pd.DataFrame(_effects(start, steps), columns=_COLUMNS)
    first = effects[effects["kind"] == asked.kinds[0]].groupby(["environment", "parameter"], sort=False)
    told = [sentence(rows, fit.quantities, repeats=bool(fit.repeats)) for _, rows in first]
    return Ladder(effects, tuple(told), tuple(notes))


def _measured(fit: Fit, asked: InferenceTable) -> dict[_Cell, _Interval]:
    """Limits of a fit, with the errors of log width and midpoint by the influence of each draw on both."""
    components, scale = fit.run.components, fit.scale
    found = {}
    parts = estimands_of(fit.model, asked).estimates(components.reshape(-1, components.shape[-1]))
    for kind, (_, influence) in zip(asked.kinds, parts, strict=True):
        lower, upper = fit.limits[str(kind)]
        pulls = influence.reshape(*components.shape[:3], 2, -1) * scale.unit
        if scale.log:
            pulls *= np.stack([lower, upper])
        on_width = (pulls[..., 1, :] - pulls[..., 0, :]) / (upper - lower)
        series = np.concatenate([on_width, 0.5 * (pulls[..., 0, :] + pulls[..., 1, :])], axis=-1)
        errors = monte_carlo_error(series, autocorrelation_time(some_walkers(series))).reshape(2, -1)
        for (parameter, environment), c in fit.column.items():
            values = upper[c] - lower[c], 0.5 * (lower[c] + upper[c]), *errors[:, c]
            found[environment, parameter, str(kind)] = _Interval(*map(float, values))
    return found


def _effects(start: dict[_Cell, _Interval], steps: Sequence[_Step]) -> Iterator[tuple[object, ...]]:
    """Yield what each step does to each interval that all steps have, the whole first."""
    for cell, classical in start.items():
        if any(cell not in found for _, found in steps):
            continue
        chain = [classical, *(found[cell] for _, found in steps)]
        half = 0.5 * classical.width
        pairs = [(classical, chain[-1]), *itertools.pairwise(chain)]
        for cause, (one, other) in zip(["all", *(cause for cause, _ in steps)], pairs, strict=True):
            width = float(np.log(other.width / one.width))
            errors = [float(np.hypot(one[which], other[which])) for which in (2, 3)]
            yield *cell, cause, width, errors[0], (other.centre - one.centre) / half, errors[1] / half


def sentence(rows: pd.DataFrame, quantities: Quantities, *, repeats: bool = False) -> str:
    """Say how two intervals differ and why, from the effects on one environment, parameter and kind."""
    whole = rows.iloc[0]
    users, label = _USERS[whole["kind"]], quantities[whole["parameter"]].label
    width, centre = (_noted(rows, name, least) for name, least in _LEAST.items())
    start = f"{whole['environment']}, {label}: "
    if not width and "all" not in centre:
        within = max(_ERRORS * whole["log_width_error"], _LEAST["log_width"])
        same = f"both intervals of {users} have the same width and centre"
        return f"{start}{same}, to within {100.0 * within:.0f} %."
    reasons = _reasons(width, lambda v: f"×{_ratio(v)}", whole["kind"], repeats)
    size = f"{_ratio(width['all'])} times as wide" if "all" in width else "as wide"
    text = f"{start}the Bayesian interval of {users} is {size} as the classical one{reasons}."
    if "all" in centre:
        side = "higher" if centre["all"] > 0 else "lower"
        reasons = _reasons(centre, lambda v: f"{100.0 * v:+.0f} %", whole["kind"], repeats)
        shift = f"{100.0 * abs(centre['all']):.0f} % of the classical half-width {side}"
        text += f" Its centre lies {shift}{reasons}."
    return text


def _noted(rows: pd.DataFrame, name: str, least: float) -> dict[str, float]:
    """Effects by cause, the largest first, without those that are small or lost in their error."""
    kept = rows[rows[name].abs() > np.maximum(least, _ERRORS * rows[f"{name}_error"])]
    order = kept[name].abs().sort_values(ascending=False, kind="stable").index
    return {str(cause): float(value) for cause, value in kept.loc[order, ["cause", name]].to_numpy()}


def _ratio(log: float) -> str:
    return f"{np.exp(log):.2f}" if log < np.log(10.0) else f"{np.exp(log):.0f}"


def _listed(texts: list[str]) -> str:
    return " and ".join(text for text in (", ".join(texts[:-1]), *texts[-1:]) if text)


def _reasons(effects: dict[str, float], said: Callable[[float], str], kind: str, repeats: bool) -> str:
    """Name the causes of a difference, the largest first; effects that cancel are named together."""
    causes = [cause for cause in effects if cause != "all"]
    nouns = [f"{_NOUNS.get(cause, cause)} ({said(effects[cause])})" for cause in causes]
    whole = effects.get("all", 0.0)
    if not causes or whole * effects[causes[0]] < 0.5 * effects[causes[0]] ** 2:
        return f"; {_listed(nouns)} act against each other" if len(nouns) > 1 else ""
    clause = _CLAUSES[causes[0]]
    if kind != "mean":
        clause = {"scale": "users scatter by ratios on the log scale"}.get(causes[0], clause)
        if repeats and causes[0] == "prior":
            clause = "it leaves trial noise out, and the priors say how users usually adjust"
    mostly, rest = ("mostly ", f"; smaller effects: {_listed(nouns[1:])}") if len(nouns) > 1 else ("", "")
    return f", {mostly}because {clause} ({said(effects[causes[0]])}){rest}"
