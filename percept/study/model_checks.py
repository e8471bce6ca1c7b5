"""Checks of the hierarchical fit for the analyst, in N/m and N·s/m and with names."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.html import NotebookRecord
from percept.inference.checks.predictive import correlation_draws, draw_prior, shrinkage
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.sampling.run import Progress
from percept.scene import Scene
from percept.sessions.values import UNITS
from percept.study.bands import weber_trend
from percept.study.bayesian import Fit
from percept.study.posterior import data_tree, full_groups, subject_density, thinned_points
from percept.study.sensitivity import power_scaling
from percept.study.streams import Stream, generator
from percept.study.subject_checks import SubjectChecks, check_statistics, check_subjects

Array = NDArray[np.float64]
_PRIOR_DRAWS = 40_000
_QUANTILES = (0.005, 0.05, 0.25, 0.5, 0.75, 0.95, 0.995)


@dataclasses.dataclass(frozen=True, eq=False)
class ModelChecks(NotebookRecord):
    """Checks of a hierarchical fit."""

    loo: SubjectChecks  # Each subject against the others
    statistics: pd.DataFrame  # Posterior predictive check of each environment (see `check_statistics`)
    prior: pd.DataFrame  # What the priors say before any data (see `prior_quantiles`)
    sensitivity: pd.DataFrame
    shrinkage: pd.DataFrame | None  # How far each environment moved to the trend (see `shrinkage_table`)
    correlation: pd.DataFrame | None
    weber: pd.DataFrame | None


def model_checks(
    fit: Fit,
    scene: Scene,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> ModelChecks | None:
    """Check a fit against its data, its priors and its own assumptions."""
    subjects = subject_density(fit)
    if subjects is None:
        return None
    level, seed = scene.inference.level, scene.inference.seed
    return ModelChecks(
        loo=check_subjects(fit, subjects, scene, progress=progress),
        statistics=check_statistics(fit, subjects, scene),
        prior=prior_quantiles(fit, subjects, seed=seed),
        sensitivity=power_scaling(data_tree(full_groups(fit, seed=seed))),
        shrinkage=shrinkage_table(fit, subjects),
        correlation=correlation_table(fit, subjects, level=level),
        weber=_weber(fit, level),
    )


def prior_quantiles(fit: Fit, subjects: SubjectDensity, *, seed: int) -> pd.DataFrame:
    """Quantiles of the average and the next user before any data."""
    rng = generator(seed, Stream.PRIOR)
    _, means, users = draw_prior(subjects.density, _PRIOR_DRAWS, rng)
    scale = fit.prepared.scale
    rows: list[dict[str, Any]] = []
    for kind, drawn in (("mean", means), ("user", users)):
        # The map to N/m is increasing, so quantiles pass through it; far tails may be infinite there.
        with np.errstate(over="ignore"):
            found = scale.native(np.quantile(drawn, _QUANTILES, axis=0))
        for c, (parameter, environment) in enumerate(fit.prepared.model.cells):
            at = {"environment": environment, "parameter": parameter, "kind": kind}
            quantiles = {f"q{100 * q:g}": found[i, c] for i, q in enumerate(_QUANTILES)}
            rows.append({**at, **quantiles, "unit": UNITS[parameter]})
    return pd.DataFrame(rows)


def shrinkage_table(fit: Fit, subjects: SubjectDensity) -> pd.DataFrame | None:
    """How far the centre of each environment moved from its raw mean to the trend over environments."""
    found = shrinkage(subjects.density, thinned_points(fit)[0])
    if found is None:
        return None
    native = fit.prepared.scale.native
    rows = [
        {
            "environment": environment,
            "parameter": parameter,
            "raw": native(found.raw.ravel())[c],
            "centre": native(found.centre.ravel())[c],
            "trend": native(found.trend.ravel())[c],
            "moved": found.moved.ravel()[c],
            "unit": UNITS[parameter],
        }
        for c, (parameter, environment) in enumerate(fit.prepared.model.cells)
    ]
    return pd.DataFrame(rows)


def correlation_table(fit: Fit, subjects: SubjectDensity, *, level: float) -> pd.DataFrame | None:
    """Correlations of stiffness and damping between users, with intervals."""
    draws = correlation_draws(subjects.density, thinned_points(fit)[0])
    rows = []
    for name, values in draws.items():
        labels = subjects.density.statistics.environments if values.ndim == 2 else ("",)
        for label, column in zip(labels, values.reshape(len(values), -1).T, strict=True):
            rows.append({"of": name, "environment": label, **_summary(column, level)})
    return pd.DataFrame(rows) if rows else None


def _summary(draws: Array, level: float) -> dict[str, float]:
    lower, upper = np.quantile(draws, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    positive = float((draws > 0.0).mean())
    return {"lower": lower, "value": float(draws.mean()), "upper": upper, "positive": positive}


def _weber(fit: Fit, level: float) -> pd.DataFrame | None:
    found = weber_trend(fit, level=level)
    if found is None:
        return None
    return found.drop(columns="below_zero").assign(positive=1.0 - found["below_zero"])
