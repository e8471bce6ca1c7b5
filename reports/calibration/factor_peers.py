"""Limits of studies with factors by nutpie, beside percept's.

PyMC has the model as `studies` draws from it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from percept.checkpoint import Line, plan_digest
from percept.inference.model.linear_posterior import LinearPosterior
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from percept.provenance import made_by, markdown_table
from reports.calibration.fits import Rows, contrast_rows
from reports.calibration.studies import GROUP, KINDS, Drawn, draw_study, model_of
from reports.peers import CHAINS, Observed, nutpie_sampler, plain_model
from reports.store import store

Array: TypeAlias = NDArray[np.float64]

LEVEL = 0.9
TAILS = (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
SIDES = ("lower", "upper")
KIND_NAMES = ("mean", "user")
#: Monte Carlo error of percept's limits, over the half-width.
TOLERANCE = 0.01
#: Shorter steps than by default: divergences would bias the comparison.
ACCEPTANCE = 0.97
#: Draws of each chain that are not kept.
WARM_UP = 1500
#: Combined errors within which nearly all limits must lie, and all.
NEARLY_ALL = 3.0
ALL = 4.5
SHARE = 0.99
PAGE = """# Limits of studies with factors, next to nutpie's

One study of each kind is fitted by percept and by nutpie ({chains} chains of {draws:,} draws). PyMC
has the model written plainly, with locations and subjects' effects as unknowns. Limits at
{level:.0%} of means and of the next user are compared, for cells, contrasts and slopes of
covariates. A difference is divided by the root of the sum of both squared Monte Carlo errors.

{made}

{table}

Of all {count} limits, {near:.1%} lie within {nearly_all:g} combined errors, and the farthest at
{farthest:.2g}. At least {share:.0%} must lie within {nearly_all:g}, and all within {all_of:g}.

The `error` columns are root mean squares of Monte Carlo errors over half-widths.

## The ten farthest limits

{worst}
"""


def observed(drawn: Drawn) -> Observed:
    """Return a study as the plainly written model takes it."""
    kind = drawn.kind
    own = {}
    for term, contrast in drawn.contrast.items():
        if GROUP not in term.split(":"):
            own[term] = contrast
    return Observed(
        drawn.response,
        drawn.subject,
        drawn.cell,
        drawn.environment,
        drawn.x,
        drawn.priors,
        contrast=drawn.contrast,
        own=own,
        factors=kind.factors,
        spread=kind.spread,
        covariate=drawn.covariate[:, 0] if kind.covariate else None,
        own_trial_sds=kind.own_trial_sds,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Lower and upper limits by name, with their Monte Carlo errors."""

    value: dict[str, float]
    error: dict[str, float]


def percept_limits(model: LinearPosterior, rows: Rows, *, tolerance: float) -> Limits:
    """Return limits of means and users by percept."""
    run = sample(model, rows.estimands(model, LEVEL), Settings(tolerance=tolerance, seed=1))
    assert run.gate.passed, run.gate.reasons
    assert run.gate.tolerance_met, run.gate.error_reached
    of_users = [*map(",".join, model.cells), *rows.names]
    names = [*itertools.product(KIND_NAMES, SIDES, of_users)]
    names += itertools.product(KIND_NAMES[:1], SIDES, rows.group_names)
    labels = [f"{kind} {name} {side}" for kind, side, name in names]
    value = dict(zip(labels, run.estimates.value.tolist(), strict=True))
    return Limits(value, dict(zip(labels, run.errors.tolist(), strict=True)))


def nutpie_limits(
    drawn: Drawn, cell_names: Sequence[str], rows: Rows, plan: Plan
) -> tuple[Limits, int]:
    """Return limits of means and users by nutpie, and how many of its draws diverged.

    Those of means are quantiles of its draws. A user's law given a draw is normal.
    """
    from arviz_stats.base.array import BaseArray

    study = observed(drawn)
    drawn_by_nutpie = nutpie_sampler(plain_model(study))(
        plan.draws, tune=plan.warm_up, cores=1, seed=plan.seed, target_accept=plan.acceptance
    )
    posterior = drawn_by_nutpie.values
    locations = posterior["beta"].reshape(CHAINS, plan.draws, -1)
    if drawn.kind.covariate:
        locations = np.concatenate([locations, posterior["slope"]], axis=2)
    weights = rows.weights
    every = np.vstack([weights.cells, weights.users, weights.groups])
    names = [*cell_names, *rows.names, *rows.group_names]
    array_stats: Any = BaseArray()
    found = Limits({}, {})
    for name, row in zip(names, every, strict=True):
        mean = locations @ row  # (chains, draws)
        for side, tail in zip(SIDES, TAILS, strict=True):
            label = f"mean {name} {side}"
            found.value[label] = float(np.quantile(mean, tail))
            error = array_stats.mcse(mean, method="quantile", prob=tail)
            found.error[label] = float(error)
            if name not in rows.group_names:
                sd = user_sd(study, posterior, row)
                label = f"user {name} {side}"
                found.value[label], found.error[label] = _user_limit(mean, sd, tail, array_stats)
    return found, drawn_by_nutpie.divergences


def user_sd(study: Observed, posterior: Mapping[str, Array], row: Array) -> Array:
    """Return the SD of one user's own combination of the cells of one quantity, (chains, draws)."""
    size, cells = study.x.shape
    by_quantity = row[: size * cells].reshape(size, cells)
    (p,) = np.flatnonzero(by_quantity.any(axis=1))
    weight = by_quantity[p]
    stretch = posterior["stretch"][:, :, p]
    variance = (posterior["sigma"][:, :, p] ** 2) @ weight**2
    for name, contrast in study.columns.items():
        size_of_effect = posterior[f"sigma_{name}"][:, :, p]
        variance = variance + (size_of_effect * (stretch @ (weight * contrast))) ** 2
    return np.asarray(np.sqrt(variance))


def _user_limit(mean: Array, sd: Array, tail: float, array_stats: Any) -> tuple[float, float]:
    """Return the quantile of a mixture of normal laws, and its Monte Carlo error."""

    def excess(limit: float) -> float:
        return special.ndtr((limit - mean) / sd).mean() - tail

    limit = optimize.brentq(excess, (mean - 9.0 * sd).min(), (mean + 9.0 * sd).max(), xtol=1e-10)
    score = (limit - mean) / sd
    density = np.mean(np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * sd))
    error = float(array_stats.mcse(special.ndtr(score), method="mean"))
    return float(limit), error / float(density)


@dataclasses.dataclass(frozen=True)
class Plan:
    """How the studies are fitted by both."""

    draws: int  # Of each of nutpie's chains
    seed: int = 11  # Of the studies and of nutpie
    tolerance: float = TOLERANCE
    warm_up: int = WARM_UP
    acceptance: float = ACCEPTANCE


def compare(plan: Plan, number: int) -> Line:
    """Return how far all limits of one kind of study lie apart, and both errors.

    `apart` is in combined Monte Carlo errors, errors are over the half-width.
    """
    kind = list(KINDS)[number]
    drawn = draw_study(KINDS[kind], np.random.default_rng(plan.seed))
    model = model_of(drawn)
    rows = contrast_rows(drawn, model)
    ours = percept_limits(model, rows, tolerance=plan.tolerance)
    cell_names = [",".join(pair) for pair in model.cells]
    theirs, divergences = nutpie_limits(drawn, cell_names, rows, plan)
    assert ours.value.keys() == theirs.value.keys()
    apart = []
    percept = []
    nutpie = []
    for name, value in ours.value.items():
        stem = name.rpartition(" ")[0]
        half_width = 0.5 * (ours.value[f"{stem} upper"] - ours.value[f"{stem} lower"])
        combined = np.hypot(ours.error[name], theirs.error[name])
        apart.append(float((theirs.value[name] - value) / combined))
        percept.append(ours.error[name] / half_width)
        nutpie.append(theirs.error[name] / half_width)
    errors = {"percept": percept, "nutpie": nutpie}
    named = dict(zip(ours.value, apart, strict=True))
    return {"kind": kind, "apart": named, "errors": errors, "divergences": divergences}


def compared(draws: int, folder: Path, typed: str) -> tuple[bool, str]:
    """Fit what is not kept yet by both; say whether the limits differ, and write the page."""
    plan = Plan(draws)
    rows = []
    every: list[tuple[str, str, float]] = []
    kept = store(folder, plan_digest(plan))
    for both in kept.complete(functools.partial(compare, plan), len(KINDS)):
        apart = np.abs(list(both["apart"].values()))
        near = f"{np.mean(apart <= NEARLY_ALL):.1%}"
        errors = [f"{np.sqrt(np.mean(np.square(each))):.2%}" for each in both["errors"].values()]
        farthest = f"{apart.max():.2g}"
        rows.append([both["kind"], len(apart), near, farthest, *errors, both["divergences"]])
        every += [
            (both["kind"], name, errors_apart) for name, errors_apart in both["apart"].items()
        ]
    every.sort(key=lambda limit: -abs(limit[2]))
    apart = np.abs([errors_apart for _, _, errors_apart in every])
    within = np.mean(apart <= NEARLY_ALL)
    heads = ["kind", "limits", "within 3", "farthest", "percept error", "nutpie error", "diverged"]
    worst = [[kind, name, f"{errors_apart:.2f}"] for kind, name, errors_apart in every[:10]]
    text = PAGE.format(
        chains=CHAINS,
        draws=draws,
        level=LEVEL,
        made=made_by(typed, ("pymc", "nutpie")).sentence,
        table=markdown_table(heads, rows),
        count=len(apart),
        near=within,
        nearly_all=NEARLY_ALL,
        farthest=apart.max(),
        share=SHARE,
        all_of=ALL,
        worst=markdown_table(["kind", "limit", "combined errors"], worst),
    )
    return bool(within < SHARE or apart.max() > ALL), text
