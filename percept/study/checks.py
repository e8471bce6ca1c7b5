"""Checks of the hierarchical fit for the analyst: its subjects, its data and its priors."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from scipy import special

from percept.errors import RefusalError
from percept.inference.checks.left_out import (
    Loo,
    Predicted,
    leave_one_out,
    limit_moves,
    predict_left_out,
)
from percept.inference.checks.predictive import (
    STATISTICS,
    new_studies,
    statistics_of,
)
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.model import Pooled
from percept.inference.record import Kind
from percept.inference.sampling.endpoints import mixture_quantile
from percept.results import (
    CellOutlier,
    Checks,
    LeftOut,
    PredictiveCheck,
    PriorQuantiles,
    SubjectCheck,
)
from percept.sessions.quantities import Quantities
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.fit import Fit
from percept.study.ladder import USERS

__all__ = ["bias_pull", "model_checks", "spread_pull", "subject_tables"]

#: Chance of naming any outlier at all in a study the model holds for; shared over all that is
#: looked at.
FALSE_ALARM = 0.05
#: Refits without a subject, at most.
_MOST_REFITS = 5
#: New studies whose largest move is known in closed form, a part of all.
_EVERY = 4
#: What 95 % of studies stay below by refits, over what they stay below in closed form: of 49
#: simulated studies of 3 to 20 subjects.
_REFIT_RATIO = 0.93
#: Below this part of the latter a refit does not reach the former: the two differ by 13 %.
_CANDIDATE = 0.8
_REPLICATES = 4000
_PRIOR_DRAWS = 40_000
_PRIOR_QUANTILES = (0.005, 0.05, 0.25, 0.5, 0.75, 0.95, 0.995)
#: Draws that weights and limits rest on; more would not change two digits.
_MOST_DRAWS = 4000
#: Half-widths of the average user's interval from which the pull on its estimate is told.
_MOVED = 0.1
#: Cells named with the pull on them, those with most of it.
_MOST_CELLS = 5
#: A prior this many times as wide as the one in force counts as flat.
_FLAT = 1e3
#: Ratio of the next user's widths, with the prior of spread and without, from which it is told.
_WIDENED = 1.25
#: Prior SDs between the data's spread and the prior's centre, below which the two agree.
_AGREE = 1.0
#: Effective draws of reweighting, below which the data lie where the prior let no draw go.
_FEWEST_DRAWS = 100.0


def model_checks(
    fit: Fit,
    subjects: SubjectDensity,
    refit: Callable[[str], Fit | None],
    *,
    level: float,
    seed: int,
    users: tuple[str, str],
) -> Checks | Skipped:
    """Check a fit against its data and priors; or say why not: its intervals stand all the same.

    `refit` fits the same model without a subject; it gives None where that cannot be done. `users`
    are the study's words for one user and for several.
    """
    try:
        loo = leave_one_out(subjects, fit.points, chains=len(fit.run.points))
        predicted = predict_left_out(subjects, loo.points, loo.weights)
    except RefusalError as refused:
        return Skipped("checks of the hierarchical model", refused.message.rstrip("."))
    statistics, usual_moves = _statistics(subjects, fit.points, level=level, seed=seed)
    influential = dict(_influential(fit, subjects, level, usual_moves, refit, users))
    return Checks(
        normality=(),
        loo=subject_tables(fit, subjects, loo, predicted, influential),
        statistics=statistics,
        prior=tuple(_prior_quantiles(fit, subjects, seed=seed)),
        pull=bias_pull(fit, level=level, user=users[0]),
    )


def _influential(
    fit: Fit,
    subjects: SubjectDensity,
    level: float,
    usual_moves: Array,
    refit: Callable[[str], Fit | None],
    users: tuple[str, str],
) -> Iterator[tuple[str, str]]:
    """Yield subjects without whom a refit moves a limit farther than is usual, and what it becomes.

    `usual_moves` are the largest of new studies, in closed form.
    """
    statistics = subjects.density.statistics
    names = statistics.subjects
    moves = limit_moves(statistics.cell_means, level, _usual_sd(subjects))
    usual_closed = np.quantile(usual_moves, 1.0 - FALSE_ALARM)
    usual = _REFIT_RATIO * usual_closed
    for i in np.argsort(-moves)[:_MOST_REFITS]:
        other = refit(names[i]) if moves[i] > _CANDIDATE * usual_closed else None
        if other is None:
            continue
        largest = usual
        said = ""
        columns = [fit.column[cell] for cell in other.column]
        for kind, limits in fit.limits.items():
            ends = np.array([np.array(limits)[:, columns], other.limits[kind]])
            before, after = np.log(ends) if fit.scale.log else ends
            by_limit = np.abs(after - before).max(axis=0) / (0.5 * (before[1] - before[0]))
            c = int(by_limit.argmax())
            if by_limit[c] > largest:
                largest = by_limit[c]
                parameter, environment = list(other.column)[c]
                quantity = fit.quantities[parameter]
                who = USERS[kind].format(user=users[0], users=users[1])
                said = (
                    f"without {names[i]} a limit moves by {largest:.2f} of its half-width, more"
                    f" than in 95 % of such studies ({usual:.2f}). The interval of"
                    f" {quantity.label} in {environment} for {who} becomes"
                    f" {quantity.amounts(ends[1, :, c])} instead of"
                    f" {quantity.amounts(ends[0, :, c])}."
                )
        if said:
            yield names[i], said


def _usual_sd(subjects: SubjectDensity) -> float:
    """SD between subjects that the prior is centred at."""
    return float(np.exp(subjects.density.priors.log_s_mean))


def subject_tables(
    fit: Fit,
    subjects: SubjectDensity,
    loo: Loo,
    predicted: Predicted,
    influential: Mapping[str, str],
) -> LeftOut:
    """Name the subjects and cells that lie far from the others, and those the results lean on."""
    statistics = subjects.density.statistics
    names = statistics.subjects
    own = []
    for i, name in enumerate(names):
        check = SubjectCheck(
            subject=name,
            elpd=float(loo.pointwise[i]),
            pareto_k=float(loo.pareto_k[i]),
            influential=name in influential,
            farther=float(predicted.farther[i]),
            outlier=bool(predicted.farther[i] < FALSE_ALARM / len(names)),
        )
        own.append(check)
    means = statistics.cell_means
    by_cell = means.reshape(len(means), -1)
    value = fit.scale.native(by_cell).reshape(means.shape)
    cells = []
    present = np.argwhere(np.isfinite(means)).tolist()
    for i, p, j in present:
        below = float(predicted.below[i, p, j])
        cell = CellOutlier(
            subject=names[i],
            environment=statistics.environments[j],
            parameter=statistics.parameters[p],
            value=float(value[i, p, j]),
            below=below,
            outlier=2.0 * min(below, 1.0 - below) < FALSE_ALARM / len(present),
        )
        cells.append(cell)
    messages = tuple(_messages(own, cells, influential, fit.quantities))
    return LeftOut(loo.elpd, loo.se, loo.good_k, tuple(own), tuple(cells), messages)


def _messages(
    subjects: Sequence[SubjectCheck],
    cells: Sequence[CellOutlier],
    influential: Mapping[str, str],
    quantities: Quantities,
) -> Iterator[str]:
    """Say which subjects the results lean on and which lie far off."""
    for subject, said in influential.items():
        rule = json.dumps([subject], ensure_ascii=False)
        yield (
            f"{subject} is influential: {said} To leave {subject} out, set"
            f' exclude = [{{ column = "subject", equals = {rule} }}] in [sessions].'
        )
    for check in subjects:
        if check.outlier:
            yield (
                f"{check.subject} lies far from what the others predict, all cells together: as far"
                f" or farther with a probability of {100.0 * check.farther:.2g} %. See whether the"
                " session went wrong before believing the spread."
            )
    for cell in cells:
        if cell.outlier:
            side = "below" if cell.below < 0.5 else "above"
            quantity = quantities[cell.parameter]
            yield (
                f"{cell.subject} set {quantity.label} in {cell.environment} to "
                f"{quantity.amount(cell.value)}, far {side} what the others predict."
            )


def _statistics(
    subjects: SubjectDensity, points: Array, *, level: float, seed: int
) -> tuple[tuple[PredictiveCheck, ...], Array]:
    """Compare each cell's mean, SD and farthest subject with new studies from the posterior.

    Gives the largest move of a limit in some of the new studies too.
    """
    stride = max(1, len(points) // _REPLICATES)
    rng = generator(seed, Stream.CHECKED_STATISTICS)
    parts = []
    moves = []
    for studies in new_studies(subjects, points[::stride], rng):
        parts.append(statistics_of(studies))
        moves.append(limit_moves(studies[::_EVERY], level, _usual_sd(subjects)).max(axis=-1))
    drawn = np.concatenate(parts)
    statistics = subjects.density.statistics
    observed = statistics_of(statistics.cell_means)
    ends = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    lower, upper = np.quantile(drawn, ends, axis=0)
    above = (drawn > observed).mean(axis=0)
    unusual = ~((lower <= observed) & (observed <= upper))
    known = np.isfinite(observed).transpose(2, 1, 0)
    checks = []
    for j, p, s in np.argwhere(known).tolist():
        index = (s, p, j)
        check = PredictiveCheck(
            environment=statistics.environments[j],
            parameter=statistics.parameters[p],
            statistic=STATISTICS[s],
            observed=float(observed[index]),
            lower=float(lower[index]),
            upper=float(upper[index]),
            above=float(above[index]),
            unusual=bool(unusual[index]),
        )
        checks.append(check)
    return tuple(checks), np.concatenate(moves)


def _prior_quantiles(fit: Fit, subjects: SubjectDensity, *, seed: int) -> Iterator[PriorQuantiles]:
    """Yield quantiles of the average and the next user before any data."""
    prior = subjects.density.draw_prior(_PRIOR_DRAWS, generator(seed, Stream.PRIOR))
    kinds: dict[Kind, Array] = {"mean": prior.means, "user": prior.users}
    for kind, drawn in kinds.items():
        # The map to the quantity is increasing, so quantiles pass through it; far tails may be
        # infinite.
        with np.errstate(over="ignore"):
            native = fit.scale.native(np.quantile(drawn, _PRIOR_QUANTILES, axis=0))
        for (parameter, environment), c in fit.column.items():
            names = [f"{100 * probability:g}" for probability in _PRIOR_QUANTILES]
            yield PriorQuantiles(
                environment=environment,
                parameter=parameter,
                kind=kind,
                quantiles=dict(zip(names, native[:, c].tolist(), strict=True)),
                unit=fit.quantities[parameter].unit,
            )


def bias_pull(fit: Fit, *, level: float, user: str) -> tuple[str, ...]:
    """Say how far the prior of the common bias moves average users, against a flat one."""
    said = []
    for model, points in fit.model.pooled_parts(_some_draws(fit)):
        moved = _moved_by_bias_prior(model, points, level)
        cells = []
        parameters: dict[str, None] = {}
        for c in np.argsort(-np.abs(moved), kind="stable"):
            if abs(moved[c]) > _MOVED:
                parameter, environment = model.cells[c]
                label = fit.quantities[parameter].label
                moved_by = f"{moved[c]:+.2f}".replace("-", "−")
                cells.append(f"{label} in {environment} ({moved_by})")
                parameters[parameter] = None
        if not cells:
            continue
        more = f" and {len(cells) - _MOST_CELLS} more" if len(cells) > _MOST_CELLS else ""
        matched = any(fit.quantities[parameter].is_matched for parameter in parameters)
        expected = "settings near their references" if matched else "means near zero"
        said.append(
            f"The prior of the common bias, N(0, {model.priors.alpha_sd:g}²), moves the"
            f" estimate of the average {user}, in half-widths of the interval:"
            f" {', '.join(cells[:_MOST_CELLS])}{more}. It expects {expected}."
            f" {_remedy(fit, list(parameters))}"
        )
    return tuple(said)


def _moved_by_bias_prior(model: Pooled, points: Array, level: float) -> Array:
    """How far the prior moves each cell's mean, in half-widths of its interval, (C,)."""
    free = model.with_bias_prior(_FLAT * model.priors.alpha_sd)
    own = model.laws(points)
    other = free.laws(points)
    # Locations are integrated out of both densities, whose ratio tells how likely draws are under
    # the other.
    weights = special.softmax(free(points) - model(points))
    sd = np.hypot(own.sd, own.mean.std(axis=0)).mean(axis=0)
    half_width = special.ndtri(0.5 * (1.0 + level)) * sd
    free_mean = weights @ other.mean
    return np.asarray((own.mean.mean(axis=0) - free_mean) / half_width)


def _remedy(fit: Fit, parameters: list[str]) -> str:
    """Name what to set: the scale of a quantity whose responses it divides, or the prior."""
    scales = []
    for parameter in parameters:
        cells = [c for (name, _), c in fit.column.items() if name == parameter]
        # A reference that is not positive takes the scene's scale, and so do its neighbours.
        if not fit.scale.log and min(fit.scale.origin[cells]) <= 0.0:
            scale = float(fit.scale.unit[cells[0]])
            unit = fit.quantities[parameter].unit
            scales.append(f"scale.{parameter} = {scale:g}{f' ({unit})' if unit else ''}")
    if scales:
        return (
            f"Its unit is [model] {' and '.join(scales)}. Set a scale about as large as the"
            " differences from the reference, or a larger alpha_sd in [model.priors]."
        )
    return "Where these or their unit are arbitrary, set a larger alpha_sd in [model.priors]."


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
    fit: Fit, model: Pooled, points: Array, level: float, users: tuple[str, str]
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
    """Widths of the next user's intervals on the response scale, by all draws or by some."""
    mean = laws.mean[:, cells]
    sd = np.hypot(laws.sd, laws.population_sd)[:, cells]
    if draws is not None:
        mean = mean[draws]
        sd = sd[draws]
    tail = 0.5 * (1.0 - level)
    lower, _ = mixture_quantile(mean, sd, tail, upper=False)
    upper, _ = mixture_quantile(mean, sd, tail, upper=True)
    return upper - lower


def _by_scatter(model: Pooled, p: int, level: float) -> tuple[Array, float]:
    """Widths of classical prediction intervals (J,), 0 without scatter, and the mean log SD."""
    sd = model.statistics.sd[p]
    df = model.statistics.df[p]
    scatters = (sd > 0) & (df > 0)
    freedom = np.where(scatters, df, 1.0)
    t = -special.stdtrit(freedom, 0.5 * (1.0 - level))
    prediction = np.sqrt(1.0 + 1.0 / (freedom + 1.0))
    widths = np.where(scatters, 2.0 * t * sd * prediction, 0.0)
    logs = np.log(sd[scatters])
    return widths, float(logs.mean()) if logs.size else float(model.priors.log_s_mean)
