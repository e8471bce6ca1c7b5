"""Checks of the hierarchical fit for the analyst: its subjects, its data and its priors."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy import linalg, special, stats

from percept.errors import RefusalError
from percept.html import NotebookRecord
from percept.inference.checks.left_out import Loo, Predicted, leave_one_out, predict_left_out
from percept.inference.checks.predictive import (
    STATISTICS,
    draw_prior,
    replicate,
    statistics_of,
)
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.sampling.endpoints import mixture_quantile
from percept.results import Nouns
from percept.sessions.quantities import Quantities
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.fit import Fit
from percept.study.responses import Trials

__all__ = ["ModelChecks", "model_checks", "spread_pull", "subject_tables", "trial_noise_p_value"]

#: Chance of naming any outlier at all in a study the model holds for; shared over all that is
#: looked at.
FALSE_ALARM = 0.05
#: Share of influential subjects above which they are counted, not named.
_MANY = 1.0 / 3.0
_NOISE_DIFFERS = (
    " The trials of some {subjects} scatter more than those of others, which the model takes to be"
    " alike."
)
_REPLICATES = 4000
_PRIOR_DRAWS = 40_000
_PRIOR_QUANTILES = (0.005, 0.05, 0.25, 0.5, 0.75, 0.95, 0.995)
#: Draws that weights and limits rest on; more would not change two digits.
_MOST_DRAWS = 4000
#: Half-widths of the average user's interval from which the pull on its estimate is told.
_MOVED = 0.1
#: A prior this many times as wide as the one in force counts as flat.
_FLAT = 1e3
#: Ratio of the next user's widths, with the prior of spread and without, from which it is told.
_WIDENED = 1.25
#: Prior SDs between the data's spread and the prior's centre, below which the two agree.
_AGREE = 1.0
#: Effective draws of reweighting, below which the data lie where the prior let no draw go.
_FEWEST_DRAWS = 100.0


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


def model_checks(
    fit: Fit, subjects: SubjectDensity, *, level: float, seed: int, nouns: Nouns
) -> ModelChecks | Skipped:
    """Check a fit against its data and priors; or say why not: its intervals stand all the same."""
    try:
        loo = leave_one_out(subjects, fit.points, chains=len(fit.run.points))
        predicted = predict_left_out(subjects, loo.points, loo.weights)
    except RefusalError as refused:
        return Skipped("checks of the hierarchical model", refused.message.rstrip("."))
    return ModelChecks(
        loo=subject_tables(fit, subjects, loo, predicted, nouns.subject[1]),
        statistics=_statistics(subjects, fit.points, level=level, seed=seed),
        prior=_prior_quantiles(fit, subjects, seed=seed),
        pull=bias_pull(fit, level=level, user=nouns.user[0]),
    )


def subject_tables(
    fit: Fit, subjects: SubjectDensity, loo: Loo, predicted: Predicted, noun: str = "subjects"
) -> SubjectChecks:
    """Name the subjects, which the study calls `noun`, and cells that lie far from the others."""
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
    by_cell = means.reshape(len(means), -1)
    value = fit.scale.native(by_cell).reshape(means.shape)
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
    noise = ""
    if fit.trials is not None and trial_noise_p_value(fit.trials) < FALSE_ALARM:
        noise = _NOISE_DIFFERS.format(subjects=noun)
    messages = tuple(_messages(table, cells, loo.good_k, fit.quantities, noise, noun))
    return SubjectChecks(loo.elpd, loo.se, loo.good_k, table, cells, messages)


def trial_noise_p_value(data: Trials) -> float:
    """Test whether subjects' trials scatter alike: p-value by Kruskal and Wallis; 1 without repeats.

    Within a subject's cell, Helmert's contrasts of the trials are uncorrelated and have the SD of a
    trial. Their sizes, over what is usual in the environment, are compared between subjects, each
    parameter by itself. Ranks need no normal law. The smallest p-value is for all parameters.
    """
    by_cell = pd.DataFrame({"subject": data.subject, "environment": data.environment})
    sizes = []
    subjects: list[int] = []
    environments: list[int] = []
    for rows in by_cell.groupby(["subject", "environment"]).indices.values():
        if len(rows) > 1:
            contrasts = linalg.helmert(len(rows)) @ data.response[rows]
            sizes.append(np.abs(contrasts))
            first = rows[0]
            subjects += [int(data.subject[first])] * len(contrasts)
            environments += [int(data.environment[first])] * len(contrasts)
    if len(set(subjects)) < 2:
        return 1.0
    size = np.concatenate(sizes)
    smallest = 1.0
    for p in range(size.shape[1]):
        table = pd.DataFrame({"size": size[:, p], "who": subjects, "where": environments})
        usual = table.groupby("where")["size"].transform("mean")
        table["size"] /= usual.where(usual > 0, 1.0)
        of_subjects = [own.to_numpy() for _, own in table.groupby("who")["size"]]
        if table["size"].nunique() > 1:
            smallest = min(smallest, float(stats.kruskal(*of_subjects).pvalue))
    return min(1.0, smallest * size.shape[1])


def _messages(
    table: pd.DataFrame,
    cells: pd.DataFrame,
    good_k: float,
    quantities: Quantities,
    noise: str,
    subjects: str,
) -> Iterator[str]:
    """Say which subjects the results lean on and which lie far off; `noise` is why they may."""
    influential = table.loc[table["influential"], "subject"].tolist()
    if len(influential) > _MANY * len(table):
        yield (
            f"Leave-one-out results are rough: {len(influential)} of {len(table)} {subjects} are"
            f" influential (Pareto index above {good_k:.2f}).{noise}"
        )
    elif influential:
        rule = json.dumps(influential, ensure_ascii=False)
        yield (
            f"The results lean on {', '.join(influential)} (Pareto index above {good_k:.2f})."
            " Leave-one-out results are rough there. To repeat without them, set"
            f' exclude = [{{ column = "subject", equals = {rule} }}] in [sessions].{noise}'
        )
    for row in table[table["outlier"]].itertuples():
        yield (
            f"{row.subject} lies far from what the others predict, all cells together: as far or"
            f" farther with probability {row.farther:.1e}. See whether the session went wrong"
            " before believing the spread."
        )
    for cell in cells[cells["outlier"]].to_dict("records"):
        side = "below" if cell["below"] < 0.5 else "above"
        quantity = quantities[cell["parameter"]]
        yield (
            f"{cell['subject']} set {quantity.label} in {cell['environment']} to "
            f"{quantity.amount(cell['value'])}, far {side} what the others predict."
        )


def _statistics(
    subjects: SubjectDensity, points: Array, *, level: float, seed: int
) -> pd.DataFrame:
    """Compare each cell's mean, SD and farthest subject with new studies from the posterior."""
    stride = max(1, len(points) // _REPLICATES)
    rng = generator(seed, Stream.CHECKED_STATISTICS)
    drawn = replicate(subjects, points[::stride], rng)
    statistics = subjects.density.statistics
    observed = statistics_of(statistics.cell_means)
    ends = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    lower, upper = np.quantile(drawn, ends, axis=0)
    above = (drawn > observed).mean(axis=0)
    unusual = ~((lower <= observed) & (observed <= upper))
    known = np.isfinite(observed).transpose(2, 1, 0)
    rows = []
    for j, p, s in np.argwhere(known).tolist():
        index = (s, p, j)
        row = {
            "environment": statistics.environments[j],
            "parameter": statistics.parameters[p],
            "statistic": STATISTICS[s],
            "observed": observed[index],
            "lower": lower[index],
            "upper": upper[index],
            "above": above[index],
            "unusual": bool(unusual[index]),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def _prior_quantiles(fit: Fit, subjects: SubjectDensity, *, seed: int) -> pd.DataFrame:
    """Quantiles of the average and the next user before any data."""
    prior = draw_prior(subjects.density, _PRIOR_DRAWS, generator(seed, Stream.PRIOR))
    rows: list[dict[str, object]] = []
    for kind, drawn in (("mean", prior.means), ("user", prior.users)):
        # The map to the quantity is increasing, so quantiles pass through it; far tails may be
        # infinite.
        with np.errstate(over="ignore"):
            native = fit.scale.native(np.quantile(drawn, _PRIOR_QUANTILES, axis=0))
        for (parameter, environment), c in fit.column.items():
            row: dict[str, object]
            row = {"environment": environment, "parameter": parameter, "kind": kind}
            for i, probability in enumerate(_PRIOR_QUANTILES):
                row[f"q{100 * probability:g}"] = native[i, c]
            row["unit"] = fit.quantities[parameter].unit
            rows.append(row)
    return pd.DataFrame(rows)


def bias_pull(fit: Fit, *, level: float, user: str) -> tuple[str, ...]:
    """Say how far the prior of the common bias moves average users from where a flat one has them."""
    ((density, points),) = fit.model.pooled_parts(_some_draws(fit))
    flat = dataclasses.replace(density.priors, alpha_sd=_FLAT * density.priors.alpha_sd)
    free = CollapsedDensity(density.statistics, flat, density.layout.options, density.resolution)
    own = density.laws(points)
    other = free.laws(points)
    # Locations are integrated out of both densities, whose ratio tells how likely draws are under
    # the other.
    weights = special.softmax(free(points) - density(points))
    sd = np.hypot(own.sd, own.mean.std(axis=0)).mean(axis=0)
    half_width = special.ndtri(0.5 * (1.0 + level)) * sd
    free_mean = weights @ other.mean
    moved = (own.mean.mean(axis=0) - free_mean) / half_width
    cells = ", ".join(
        f"{fit.quantities[p].label} in {e} ({moved[c]:+.2f})"
        for (p, e), c in fit.column.items()
        if abs(moved[c]) > _MOVED
    )
    if not cells:
        return ()
    return (
        f"The prior of the common bias, N(0, {density.priors.alpha_sd:g}²), moves the estimate"
        f" of the average {user}, in half-widths of the interval: {cells}. It expects settings"
        " near their references. Where these or their unit are arbitrary, set a larger"
        " alpha_sd in [model.priors].",
    )


def spread_pull(fit: Fit, *, level: float, users: tuple[str, str]) -> tuple[str, ...]:
    """Say how much wider or narrower the prior of spread makes the next user's intervals.

    `users` are the study's words for one user and for several.
    """
    said: list[str] = []
    for model, points in fit.model.pooled_parts(_some_draws(fit)):
        said += _pull_of_model(fit, model, points, level, users)
    return tuple(said)


def _some_draws(fit: Fit) -> Array:
    stride = max(1, len(fit.points) // _MOST_DRAWS)
    return fit.points[::stride]


def _pull_of_model(
    fit: Fit, model: CollapsedDensity, points: Array, level: float, users: tuple[str, str]
) -> Iterator[str]:
    """Yield a sentence per parameter whose spread the prior moves."""
    priors = model.priors
    laws = model.laws(points)
    named = model.scales(points)
    environments = model.statistics.environments
    # One environment has no trend: its own log sigma has the prior of log s.
    log_s = np.log(named["s"][1] if "s" in named else named["sigma"][1][..., 0])
    for p, parameter in enumerate(model.statistics.parameters):
        cells = [c for c, (name, _) in enumerate(model.cells) if name == parameter]
        widths = _widths(laws, cells, level)
        # Without its prior a draw weighs by one over the prior's density.
        prior_sds = (log_s[:, p] - priors.log_s_mean) / priors.log_s_sd
        weights = special.softmax(0.5 * prior_sds**2)
        effective_draws = 1.0 / float(weights @ weights)
        reweighted = effective_draws >= _FEWEST_DRAWS
        if not reweighted:
            against = "the classical one"
            others, centre = _by_scatter(model, p, level)
        else:
            against = "without that prior"
            count = len(weights)
            places = (np.arange(count) + 0.5) / count
            index = np.searchsorted(np.cumsum(weights), places)
            drawn = np.minimum(index, count - 1)
            others = _widths(laws, cells, level, drawn)
            centre = float(weights @ log_s[:, p])
        distance = abs(centre - priors.log_s_mean)
        has_width = others > 0
        ratio = np.where(has_width, widths / np.where(has_width, others, 1.0), 1.0)
        # Against the classical ones a ratio is also what a cell learns from the others: the middle
        # one tells the prior's part. Without the prior the largest does.
        order = np.argsort(np.abs(np.log(ratio)), kind="stable")
        worst = int(order[-1] if reweighted else order[len(order) // 2])
        factor = float(ratio[worst])
        precise = centre < priors.log_s_mean
        pull = factor if precise else 1.0 / factor
        if pull < _WIDENED or distance < _AGREE * priors.log_s_sd:
            continue
        change = f"{factor:.2g} times as wide as {against}"
        expects = "more" if precise else "less"
        yield (
            f"The prior of the spread between {users[1]} expects {expects} spread in"
            f" {fit.quantities[parameter].label} than the data show. It makes the next {users[0]}’s"
            f" interval {change} in {environments[worst]}. Set log_s_sd ="
            f" {np.ceil(distance):g} in [model.priors]."
        )


def _widths(
    laws: ConditionalMoments, cells: list[int], level: float, draws: Array | None = None
) -> Array:
    """Widths of the next user's intervals of cells on the response scale, by all draws or by some."""
    mean = laws.mean[:, cells]
    sd = np.hypot(laws.sd, laws.population_sd)[:, cells]
    if draws is not None:
        mean = mean[draws]
        sd = sd[draws]
    tail = 0.5 * (1.0 - level)
    lower, _ = mixture_quantile(mean, sd, tail, upper=False)
    upper, _ = mixture_quantile(mean, sd, tail, upper=True)
    return upper - lower


def _by_scatter(model: CollapsedDensity, p: int, level: float) -> tuple[Array, float]:
    """Widths of a parameter's classical prediction intervals (J,), 0 without scatter, and its mean log SD."""
    sd = model.statistics.sd[p]
    df = model.statistics.df[p]
    scatters = (sd > 0) & (df > 0)
    freedom = np.where(scatters, df, 1.0)
    t = -special.stdtrit(freedom, 0.5 * (1.0 - level))
    prediction = np.sqrt(1.0 + 1.0 / (freedom + 1.0))
    widths = np.where(scatters, 2.0 * t * sd * prediction, 0.0)
    logs = np.log(sd[scatters])
    return widths, float(logs.mean()) if logs.size else float(model.priors.log_s_mean)
