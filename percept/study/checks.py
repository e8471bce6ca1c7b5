"""Checks of the hierarchical fit for the analyst: its subjects, data and priors, and smaller models."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.checks.left_out import Loo, Predicted, leave_one_out, predict_left_out
from percept.inference.checks.predictive import (
    GROUPS,
    STATISTICS,
    correlation_draws,
    draw_prior,
    replicate,
    shrinkage,
    statistics_of,
)
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.scales import Options
from percept.inference.sampling.gate import Progress, Settings
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantities
from percept.study.band import weber_trend
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.fit import Fit, RunStore, fit_model, prepare
from percept.study.posterior import posterior_tree, prior_pull

_Told = Callable[[Progress], None] | None
#: Chance of naming any outlier at all in a study the model holds for; shared over all that is looked at.
FALSE_ALARM = 0.05
#: Sensitivity (a distance of distributions per doubling of the power) from which it is worth a look.
THRESHOLD = 0.05
#: Accuracy of sampling without a subject, SDs of the log density; error, nats, above which its mean is rough.
_ACCURACY, _ROUGH = 0.05, 0.2
#: Models compared, by what they leave out of the full one. "Weber trend" keeps each environment's own spread
#: about the trend, which takes up what the trend lacks: it seldom differs from "full". Weber's law itself is
#: put to the test by "exact Weber" against "common spread".
MODELS = {
    "full": Options(),
    "Weber trend": Options(weber=True),
    "common spread": Options(common_spread=True),
    "exact Weber": Options(weber=True, common_spread=True),
    "no subject effect": Options(subject_effect=False),
}
#: Differences below this many nats are too small for their standard error to be believed
#: (Sivula, Magnusson & Vehtari 2020, arXiv:2008.10296).
_SMALL = 4.0
_REPLICATES = 4000
_PRIOR_DRAWS = 40_000
_PRIOR_QUANTILES = (0.005, 0.05, 0.25, 0.5, 0.75, 0.95, 0.995)
_QUANTITIES = {"mean": "population_mean", "user": "new_user", "spread": "population_sd"}


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectChecks(NotebookRecord):
    """Each subject against what the others predict."""

    elpd: float  # Expected log predictive density of a new subject, summed over the subjects
    se: float  # Its standard error
    good_k: float  # Pareto index up to which reweighting is trusted, with this many draws
    subjects: pd.DataFrame  # A row per subject; farther: probability of lying as far off
    cells: pd.DataFrame  # A row per subject and cell; below: predictive probability of a smaller value
    messages: tuple[str, ...]  # Influential subjects and outliers by name, with what to do


@dataclasses.dataclass(frozen=True, eq=False)
class ModelChecks(NotebookRecord):
    """Checks of a hierarchical fit."""

    loo: SubjectChecks  # Each subject against the others
    statistics: pd.DataFrame  # Posterior predictive check of each cell's mean, SD and farthest subject
    prior: pd.DataFrame  # Quantiles of the average and the next user before any data
    sensitivity: pd.DataFrame  # How far results move when priors or data count slightly more
    shrinkage: pd.DataFrame | None  # How far each environment moved to the trend
    correlation: pd.DataFrame | None  # Of two parameters between users
    weber: pd.DataFrame | None  # Trend of the log spread per decade of the reference
    pull: tuple[str, ...]  # How far the prior of the common bias moves the average user, where it does


def model_checks(fit: Fit, scene: Scene, *, progress: _Told = None) -> ModelChecks | Skipped:
    """Check a fit against its data, its priors and its own assumptions."""
    if isinstance(fit.subjects, Skipped):
        return fit.subjects
    level, seed = scene.inference.level, scene.inference.seed
    weber = weber_trend(fit, level=level)
    if weber is not None:
        weber = weber.drop(columns="below_zero").assign(positive=1.0 - weber["below_zero"])
    return ModelChecks(
        loo=check_subjects(fit, fit.subjects, scene, progress=progress),
        statistics=_statistics(fit.subjects, fit.points, level=level, seed=seed),
        prior=_prior_quantiles(fit, fit.subjects, seed=seed),
        sensitivity=power_scaling(posterior_tree(fit, seed=seed, full=True)),
        shrinkage=_shrinkage(fit, fit.subjects),
        correlation=correlation_table(fit, fit.subjects, level=level),
        weber=weber,
        pull=prior_pull(fit, fit.subjects, level=level),
    )


def check_subjects(
    fit: Fit, subjects: SubjectDensity, scene: Scene, *, progress: _Told = None
) -> SubjectChecks:
    """Leave every subject out: by reweighting, and where that fails and the scene says so by sampling."""
    loo = leave_one_out(subjects, fit.points, chains=len(fit.run.points))
    predicted = predict_left_out(subjects, loo.points, loo.weights)
    refitted = np.zeros(subjects.subjects, dtype=bool)
    refit = scene.checks is not None and scene.checks.refit
    if refit:
        loo, predicted, refitted = _refit(subjects, loo, predicted, scene, progress)
    return subject_tables(fit, loo, predicted, refitted, refit=refit)


def _refit(
    subjects: SubjectDensity, loo: Loo, predicted: Predicted, scene: Scene, progress: _Told
) -> tuple[Loo, Predicted, NDArray[np.bool_]]:
    """Replace what reweighting cannot tell; a run that fails its gate changes nothing."""
    from percept.inference.checks.left_out import sample_without

    asked = scene.inference
    settings = Settings(
        tolerance=_ACCURACY, seed=asked.seed, walkers=asked.walkers, most_steps=asked.most_steps
    )
    pointwise, below, farther = loo.pointwise.copy(), predicted.below.copy(), predicted.farther.copy()
    done = np.zeros(subjects.subjects, dtype=bool)
    names = subjects.density.statistics.subjects
    for i in np.flatnonzero(loo.influential):
        without = sample_without(subjects, int(i), names[i], settings, progress=progress)
        if without is None:
            continue
        done[i] = without.error <= _ROUGH
        pointwise[i] = without.log_density
        even = np.full((len(without.points), 1), 1.0 / len(without.points))
        own = predict_left_out(subjects, without.points, even, np.array([i]))
        below[i], farther[i] = own.below[0], own.farther[0]
    return dataclasses.replace(loo, pointwise=pointwise), Predicted(below, farther), done


def subject_tables(
    fit: Fit, loo: Loo, predicted: Predicted, refitted: NDArray[np.bool_], *, refit: bool
) -> SubjectChecks:
    """Name the subjects and cells that lie far from what the others predict."""
    assert isinstance(fit.subjects, SubjectDensity)
    statistics = fit.subjects.density.statistics
    table = pd.DataFrame(
        {
            "subject": statistics.subjects,
            "elpd": loo.pointwise,
            "pareto_k": loo.pareto_k,
            "influential": loo.influential,
            "refitted": refitted,
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
    messages = tuple(_messages(table, cells, loo.good_k, fit.quantities, refit=refit))
    return SubjectChecks(loo.elpd, loo.se, loo.good_k, table, cells, messages)


def _messages(
    table: pd.DataFrame, cells: pd.DataFrame, good_k: float, quantities: Quantities, *, refit: bool
) -> Iterator[str]:
    influential = table[table["influential"]]
    if len(influential):
        named = ", ".join(f"{row.subject} ({row.pareto_k:.2f})" for row in influential.itertuples())
        yield (
            f"{named} {'is' if len(influential) == 1 else 'are'} influential (Pareto index above "
            f"{good_k:.2f}). Inspect their sessions, and report the intervals with and without them."
        )
    if rough := ", ".join(influential.loc[~influential["refitted"], "subject"]):
        yield (
            f"The predictive density of {rough} stays rough, though sampled again: hardly any spread that "
            "the others allow explains them."
            if refit
            else f"Leave-one-out results of {rough} are rough: --refit samples the posterior without them."
        )
    for row in table[table["outlier"]].itertuples():
        yield (
            f"{row.subject} lies far from what the others predict, all cells together: as far or farther "
            f"with probability {row.farther:.1e}. See whether the session went wrong before believing the "
            "spread."
        )
    for cell in cells[cells["outlier"]].to_dict("records"):
        side, quantity = "below" if cell["below"] < 0.5 else "above", quantities[cell["parameter"]]
        yield (
            f"{cell['subject']} set {quantity.label} in {cell['environment']} to "
            f"{quantity.amount(cell['value'])}, far {side} what the others predict."
        )


def _statistics(subjects: SubjectDensity, points: Array, *, level: float, seed: int) -> pd.DataFrame:
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
    _, means, users = draw_prior(subjects.density, _PRIOR_DRAWS, generator(seed, Stream.PRIOR))
    rows: list[dict[str, Any]] = []
    for kind, drawn in (("mean", means), ("user", users)):
        # The map to the quantity is increasing, so quantiles pass through it; far tails may be infinite.
        with np.errstate(over="ignore"):
            found = fit.scale.native(np.quantile(drawn, _PRIOR_QUANTILES, axis=0))
        for (p, environment), c in fit.column.items():
            quantiles = {f"q{100 * q:g}": found[i, c] for i, q in enumerate(_PRIOR_QUANTILES)}
            at = {"environment": environment, "parameter": p, "kind": kind}
            rows.append(at | quantiles | {"unit": fit.quantities[p].unit})
    return pd.DataFrame(rows)


def _shrinkage(fit: Fit, subjects: SubjectDensity) -> pd.DataFrame | None:
    """How far the centre of each environment moved from its raw mean to the trend over environments."""
    found = shrinkage(subjects.density, fit.points)
    if found is None:
        return None
    raw, centre, trend = (fit.scale.native(part.ravel()) for part in (found.raw, found.centre, found.trend))
    return pd.DataFrame(
        {
            "environment": environment,
            "parameter": parameter,
            "raw": raw[c],
            "centre": centre[c],
            "trend": trend[c],
            "moved": found.moved.ravel()[c],
            "unit": fit.quantities[parameter].unit,
        }
        for (parameter, environment), c in fit.column.items()
    )


def correlation_table(fit: Fit, subjects: SubjectDensity, *, level: float) -> pd.DataFrame | None:
    """Correlations of two parameters between users, with intervals."""
    rows = []
    for name, values in correlation_draws(subjects.density, fit.points).items():
        labels = fit.environments if values.ndim == 2 else [""]
        for label, draws in zip(labels, values.reshape(len(values), -1).T, strict=True):
            lower, upper = np.quantile(draws, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
            limits = {"lower": lower, "value": float(draws.mean()), "upper": upper}
            positive = float((draws > 0.0).mean())
            rows.append({"of": name, "environment": label, **limits, "positive": positive})
    return pd.DataFrame(rows) if rows else None


def power_scaling(tree: Any) -> pd.DataFrame:
    """Sensitivity of every environment's mean, new user and spread to the priors and to the data.

    Priors (all together, and by what they speak of) and likelihood are raised to powers just off one by
    Pareto-smoothed reweighting (Kallioinen et al. 2024, doi:10.1007/s11222-023-10366-5).
    """
    import arviz_stats
    import xarray

    posterior = tree["posterior"].to_dataset().merge(tree["posterior_predictive"].to_dataset())
    quantities = posterior[list(_QUANTITIES.values())].rename({old: new for new, old in _QUANTITIES.items()})
    groups = {name: tree[name].to_dataset() for name in ("log_prior", "log_likelihood")}
    wanted = xarray.DataTree.from_dict({"posterior": quantities, **groups})
    powers: dict[str, dict[str, Any]] = {"prior": {"group": "prior"}, "likelihood": {"group": "likelihood"}}
    for name, variables in GROUPS.items():
        if known := [variable for variable in variables if variable in groups["log_prior"]]:
            powers[f"prior_{name}"] = {"group": "prior", "group_var_names": known}
    found = {name: arviz_stats.psense(wanted, **how) for name, how in powers.items()}  # type: ignore[attr-defined, no-untyped-call]
    rows = []
    for environment in posterior["environment"].to_numpy().tolist():
        for parameter in posterior["parameter"].to_numpy().tolist():
            at = {"environment": environment, "parameter": parameter}
            for quantity in _QUANTITIES:
                values = {name: float(table[quantity].sel(at)) for name, table in found.items()}
                rows.append({**at, "quantity": quantity, **values, "diagnosis": _diagnosis(values)})
    return pd.DataFrame(rows)


def _diagnosis(values: dict[str, float]) -> str:
    if not np.isfinite(values["prior"]) or values["prior"] < THRESHOLD:
        return ""
    groups = {name: value for name, value in values.items() if name.startswith("prior_")}
    most = max(groups, key=lambda name: groups[name]).removeprefix("prior_")
    if values["likelihood"] < THRESHOLD:
        return f"the priors (of {most} most) decide, the data hardly count"
    return f"the priors (of {most} most) count beside the data"


@dataclasses.dataclass(frozen=True, eq=False)
class ModelChoice(NotebookRecord):
    """Models in the order of their predictive density."""

    table: pd.DataFrame  # A row per model, with its difference to the best
    failed: tuple[str, ...]  # Models that failed the gate, with the reason
    sentence: str  # What can be told


def compare_models(
    sessions: Sessions,
    scene: Scene,
    parameters: tuple[str, ...],
    *,
    models: tuple[str, ...] = tuple(MODELS),
    progress: _Told = None,
    store: RunStore | None = None,
) -> ModelChoice:
    """Fit models of `MODELS` and compare them by leave-one-subject-out predictive density."""
    if len(sessions.environments) == 1:
        raise RefusalError(
            "with one environment there is one model only.",
            hint="Models differ in how they join several environments.",
        )
    if unknown := [name for name in models if name not in MODELS]:
        raise UsageError(f"no such model; there are {', '.join(MODELS)}.", key="models", value=unknown[0])
    if sessions.form == "summary" or scene.model.pooling == "none":
        raise RefusalError(
            "models are compared on the sessions of subjects, pooled over environments.",
            hint='Give sessions instead of published limits, and pooling = "partial".',
        )
    found, failed = dict[str, SubjectChecks](), list[str]()
    for name in models:
        model = scene.model.model_dump(exclude_none=True) | dataclasses.asdict(MODELS[name])
        asked = scene.with_tables(model=model)
        fit = fit_model(prepare(sessions, asked, parameters), asked.inference, progress=progress, store=store)
        if fit.passed:
            assert not isinstance(fit.subjects, Skipped)
            found[name] = check_subjects(fit, fit.subjects, asked, progress=progress)
        else:
            failed.append(f"{name}: {fit.withheld}")
    if not found:
        raise RefusalError("no model passes the gate of the sampler.", hint=" ".join(failed))
    table = ranked(found)
    return ModelChoice(table, tuple(failed), sentence_of(table))


def ranked(found: Mapping[str, SubjectChecks]) -> pd.DataFrame:
    """Put models in the order of their density, with how far each lies behind the first."""
    order = sorted(found, key=lambda name: -found[name].elpd)
    best = found[order[0]].subjects["elpd"].to_numpy()
    behind = {name: found[name].subjects["elpd"].to_numpy() - best for name in order}
    return pd.DataFrame(
        {
            "model": name,
            "elpd": found[name].elpd,
            "se": found[name].se,
            "difference": float(behind[name].sum()),
            "difference_se": float(np.sqrt(best.size * behind[name].var(ddof=1))),
            "rough": int((subjects["influential"] & ~subjects["refitted"]).sum()),
        }
        for name in order
        for subjects in [found[name].subjects]
    )


def sentence_of(table: pd.DataFrame) -> str:
    """Say which model is best, and which of the others are clearly worse."""
    behind = table.iloc[1:]
    clear = (behind["difference"] < -_SMALL) & (behind["difference"] < -2.0 * behind["difference_se"])
    told = f'"{table["model"].iloc[0]}" predicts a subject left out best'
    if not clear.all():
        told += f", not distinguishable from {', '.join(behind.loc[~clear, 'model'])}"
    if clear.any():
        told += f"; {', '.join(behind.loc[clear, 'model'])} clearly worse"
    rough = int(table["rough"].sum())
    more = f" {rough} of the left-out densities are rough (Pareto index too high): use --refit to be sure."
    return f"{told}.{more * bool(rough)}"
