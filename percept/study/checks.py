"""Checks of the hierarchical fit for the analyst: its subjects, its data and its priors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from percept.html import NotebookRecord
from percept.inference.checks.left_out import Loo, Predicted, leave_one_out, predict_left_out
from percept.inference.checks.predictive import (
    STATISTICS,
    draw_prior,
    replicate,
    statistics_of,
)
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from percept.sessions.quantities import Quantities
from percept.study.basics import Array, Stream, generator
from percept.study.fit import Fit

#: Chance of naming any outlier at all in a study the model holds for; shared over all that is
#: looked at.
FALSE_ALARM = 0.05
_REPLICATES = 4000
_PRIOR_DRAWS = 40_000
_PRIOR_QUANTILES = (0.005, 0.05, 0.25, 0.5, 0.75, 0.95, 0.995)
#: Half-widths of the average user's interval from which a prior's pull is told; SDs of a prior
#: taken as flat.
_PULL, _FLAT = 0.1, 1e3


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectChecks(NotebookRecord):
    """Each subject against what the others predict."""

    elpd: float  # Expected log predictive density of a new subject, summed over the subjects
    se: float  # Its standard error
    good_k: float  # Pareto index up to which reweighting is trusted, with this many draws
    subjects: pd.DataFrame  # A row per subject; farther: probability of lying as far off
    cells: (
        pd.DataFrame
    )  # A row per subject and cell; below: predictive probability of a smaller value
    messages: tuple[str, ...]  # Influential subjects and outliers by name, with what to do


@dataclasses.dataclass(frozen=True, eq=False)
class ModelChecks(NotebookRecord):
    """Checks of a hierarchical fit."""

    loo: SubjectChecks  # Each subject against the others
    statistics: (
        pd.DataFrame
    )  # Posterior predictive check of each cell's mean, SD and farthest subject
    prior: pd.DataFrame  # Quantiles of the average and the next user before any data
    pull: tuple[
        str, ...
    ]  # How far the prior of the common bias moves the average user, where it does


def model_checks(fit: Fit, subjects: SubjectDensity, *, level: float, seed: int) -> ModelChecks:
    """Check a fit against its data, its priors and its own assumptions."""
    loo = leave_one_out(subjects, fit.points, chains=len(fit.run.points))
    return ModelChecks(
        loo=subject_tables(fit, subjects, loo, predict_left_out(subjects, loo.points, loo.weights)),
        statistics=_statistics(subjects, fit.points, level=level, seed=seed),
        prior=_prior_quantiles(fit, subjects, seed=seed),
        pull=prior_pull(fit, subjects, level=level),
    )


def subject_tables(
    fit: Fit, subjects: SubjectDensity, loo: Loo, predicted: Predicted
) -> SubjectChecks:
    """Name the subjects and cells that lie far from what the others predict."""
    statistics = subjects.density.statistics
    table = pd.DataFrame(
        {
            "subject": statistics.subjects,
            "elpd": loo.pointwise,
            "pareto_k": loo.pareto_k,
            "influential": loo.influential,
            "farther": predicted.farther,
            "outlier": predicted.farther < FALSE_ALARM / len(statistics.subjects),
        }
    )
    means = statistics.cell_means
    value = fit.scale.native(means.reshape(len(means), -1)).reshape(means.shape)
    cells = pd.DataFrame(
        {
            "subject": statistics.subjects[i],
            "environment": statistics.environments[j],
            "parameter": statistics.parameters[p],
            "value": value[i, p, j],
            "below": predicted.below[i, p, j],
        }
        for i, p, j in np.argwhere(np.isfinite(means)).tolist()
    )
    tail = 2.0 * np.minimum(cells["below"], 1.0 - cells["below"])
    cells["outlier"] = tail < FALSE_ALARM / len(cells)
    messages = tuple(_messages(table, cells, loo.good_k, fit.quantities))
    return SubjectChecks(loo.elpd, loo.se, loo.good_k, table, cells, messages)


def _messages(
    table: pd.DataFrame, cells: pd.DataFrame, good_k: float, quantities: Quantities
) -> Iterator[str]:
    influential = table[table["influential"]]
    if len(influential):
        named = ", ".join(f"{row.subject} ({row.pareto_k:.2f})" for row in influential.itertuples())
        yield (
            f"{named} {'is' if len(influential) == 1 else 'are'} influential (Pareto index above"
            f" {good_k:.2f}), and their own leave-one-out results are rough. Inspect their"
            " sessions, and report the intervals with and without them."
        )
    for row in table[table["outlier"]].itertuples():
        yield (
            f"{row.subject} lies far from what the others predict, all cells together: as far or"
            f" farther with probability {row.farther:.1e}. See whether the session went wrong"
            " before believing the spread."
        )
    for cell in cells[cells["outlier"]].to_dict("records"):
        side, quantity = "below" if cell["below"] < 0.5 else "above", quantities[cell["parameter"]]
        yield (
            f"{cell['subject']} set {quantity.label} in {cell['environment']} to "
            f"{quantity.amount(cell['value'])}, far {side} what the others predict."
        )


def _statistics(
    subjects: SubjectDensity, points: Array, *, level: float, seed: int
) -> pd.DataFrame:
    """Compare each cell's mean, SD and farthest subject with new studies from the posterior."""
    some = points[:: max(1, len(points) // _REPLICATES)]
    drawn = replicate(subjects, some, generator(seed, Stream.CHECKED_STATISTICS))
    statistics = subjects.density.statistics
    observed = statistics_of(statistics.cell_means)
    lower, upper = np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], axis=0)
    above = (drawn > observed).mean(axis=0)
    at = [tuple(index) for index in np.argwhere(np.isfinite(observed).transpose(2, 1, 0)).tolist()]
    return pd.DataFrame(
        {
            "environment": statistics.environments[j],
            "parameter": statistics.parameters[p],
            "statistic": STATISTICS[s],
            "observed": observed[s, p, j],
            "lower": lower[s, p, j],
            "upper": upper[s, p, j],
            "above": above[s, p, j],
            "unusual": bool(not lower[s, p, j] <= observed[s, p, j] <= upper[s, p, j]),
        }
        for j, p, s in at
    )


def _prior_quantiles(fit: Fit, subjects: SubjectDensity, *, seed: int) -> pd.DataFrame:
    """Quantiles of the average and the next user before any data."""
    means, users = draw_prior(subjects.density, _PRIOR_DRAWS, generator(seed, Stream.PRIOR))[1:]
    rows: list[dict[str, Any]] = []
    for kind, drawn in (("mean", means), ("user", users)):
        # The map to the quantity is increasing, so quantiles pass through it; far tails may be
        # infinite.
        with np.errstate(over="ignore"):
            found = fit.scale.native(np.quantile(drawn, _PRIOR_QUANTILES, axis=0))
        for (p, environment), c in fit.column.items():
            quantiles = {f"q{100 * q:g}": found[i, c] for i, q in enumerate(_PRIOR_QUANTILES)}
            at = {"environment": environment, "parameter": p, "kind": kind}
            rows.append(at | quantiles | {"unit": fit.quantities[p].unit})
    return pd.DataFrame(rows)


def prior_pull(fit: Fit, subjects: SubjectDensity, *, level: float) -> tuple[str, ...]:
    """Say how far the prior of the common bias moves average users from where a flat one has them."""
    density = subjects.density
    flat = dataclasses.replace(density.priors, alpha_sd=_FLAT * density.priors.alpha_sd)
    free = CollapsedDensity(density.statistics, flat, density.layout.options, density.resolution)
    some = fit.points[:: max(1, len(fit.points) // _REPLICATES)]
    own, other = (one.laws(some) for one in (density, free))
    # Locations are integrated out of both densities, whose ratio tells how likely draws are under
    # the other.
    weights = special.softmax(free(some) - density(some))
    half_width = special.ndtri(0.5 * (1.0 + level)) * np.hypot(own.sd, own.mean.std(axis=0)).mean(
        axis=0
    )
    moved = (own.mean.mean(axis=0) - weights @ other.mean) / half_width
    cells = ", ".join(
        f"{fit.quantities[p].label} in {e} ({moved[c]:+.2f})"
        for (p, e), c in fit.column.items()
        if abs(moved[c]) > _PULL
    )
    if not cells:
        return ()
    return (
        (
            f"The prior of the common bias, N(0, {density.priors.alpha_sd:g}²), moves the estimate"
            f" of the average user, in half-widths of the interval: {cells}. It expects settings"
            " near their references. Where these or their unit are arbitrary, set a larger"
            " alpha_sd in [model.priors]."
        ),
    )
