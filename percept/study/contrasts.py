"""Contrasts of factors and groups by both methods, levels, and the analysis of variance.

Classically a subject's value in a cell is the mean of their trials there, on the response scale. In
a fit a contrast is a weighted sum of the model's locations, or a ratio of SDs. Sums of which each
user has one have limits of every kind (the average user, the next one, a share of users); sums over
groups of subjects, and slopes of covariates, have limits of the average user only.

A family is the contrasts of one term in one quantity: what a reader compares at a glance. Its
limits hold together if, with the level asked for, all its true values lie within them at once. They
are single limits at a higher level. Joint draws of the L sums say how high that level must be; the
limits themselves rest on every draw of the scales, as all single limits do.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.contrasts import (
    Effect,
    TwoSamples,
    anova,
    group_contrast,
    group_spread_ratio,
    paired_contrast,
    spread_ratio,
)
from percept.inference.classical.moments import Moments
from percept.inference.classical.variability import Bounded, log_sd
from percept.inference.record import Interval, Kind, Method
from percept.results import AnovaRow, ContrastRow, LevelValues, Skipped
from percept.study.basics import Array, Stream, claim_of, generator, known
from percept.study.comparisons import (
    ENVIRONMENT,
    Contrast,
    SubjectCells,
    compared,
    level_means,
    subject_cells,
)
from percept.study.data import Data
from percept.study.responses import Trials

# The classical method does without the model.
if TYPE_CHECKING:
    from percept.inference.model import gaussian
    from percept.study.fit import Fit

#: Draws of the scales, S, that joint draws are made for. Every k-th draw of the fit is kept, with k
#: a whole number: up to twice as many stay.
_LEAST_KEPT = 4096
#: Joint draws for each draw of the scales, at most. With 16 times 4096 in all, limits that hold
#: together at 99 % are known to 1 % of their half-widths.
_MOST_REPEATS = 16
#: Numbers in an array of joint draws, (N, L), at most: 32 MB. There are two, of average users and
#: of next users.
_MOST_NUMBERS = 1 << 22
#: Fields of a row that are those of its contrast.
_SAME = ("parameter", "factor", "first", "second", "of", "within", "environment", "references")


def contrast_row(
    data: Data,
    contrast: Contrast,
    ends: ArrayLike,
    n: int,
    *,
    kind: Kind = "mean",
    method: Method,
    unit: str | None = None,
    **evidence: Any,
) -> ContrastRow:
    """Make a row of lower limit, upper limit and estimate, and of limits that hold together.

    They are ratios of SDs, or numbers in a unit that is given, or else differences of responses.
    `evidence` are p-value, probability, d_z and error by their names in the row.
    """
    asked = data.asked
    numbers = np.asarray(ends)
    if unit is None and not contrast.is_ratio:
        numbers, unit = data.differences(contrast.parameter, numbers)
    lower, upper, estimate, *together = numbers.tolist()
    lower_together, upper_together = map(known, together or (math.nan, math.nan))
    further: Any = {name: getattr(contrast, name) for name in _SAME} | evidence
    return ContrastRow(
        **further,
        kind=None if contrast.is_ratio else kind,
        method=method,
        family=asked.family,
        level=asked.level,
        share=asked.share if kind == "share" else None,
        confidence=asked.confidence if kind == "share" else None,
        lower=lower,
        upper=upper,
        estimate=estimate,
        lower_together=lower_together,
        upper_together=upper_together,
        unit=unit or "",
        n=n,
    )


def ends_of(found: TwoSamples | Interval | Bounded) -> Array:
    """Lower limit, upper limit and estimate."""
    return np.array([found.lower, found.upper, found.estimate])


def classical_contrasts(data: Data) -> Iterator[ContrastRow | Skipped]:
    """Yield intervals of subjects' own contrasts, and of groups of subjects."""
    conditions = data.conditions
    for parameter in data.parameters:
        label = data.quantities[parameter].label
        for column in conditions.covariates:
            why = "only the hierarchical model estimates slopes"
            yield Skipped(f"classical slope of {label} on {column}", why)
        if data.sessions.factors is None:
            continue
        try:
            trials = data.trials(parameter)
        except RefusalError as refused:
            yield Skipped(f"contrasts of {label}", str(refused))
            continue
        means = subject_cells(data, trials, trials.statistics.cell_means[:, 0])
        log_sds = means
        if conditions.precision:
            values, equal = _log_sds(trials, label)
            yield from equal
            log_sds = subject_cells(data, trials, values)
        for found in compared(data, trials, parameter):
            if isinstance(found, Skipped):
                yield found
            elif found.of == "precision":
                yield from _classical(data, f"precision of {label}", found, log_sds)
            else:
                yield from _classical(data, label, found, means)


def _log_sds(trials: Trials, label: str) -> tuple[Array, list[Skipped]]:
    """Log SDs between each subject's trials in each cell, (N, C), and those there are none of."""
    counts = trials.statistics.counts
    log_sds = np.full(counts.shape, np.nan)
    skipped = []
    for i, j in np.argwhere(counts > 1.0).tolist():
        responses = trials.response[(trials.subject == i) & (trials.environment == j), 0]
        # Of equal values the SD may be rounding of their mean.
        if np.ptp(responses) > 0.0:
            log_sds[i, j] = log_sd(responses.std(ddof=1), counts[i, j] - 1.0)
            continue
        what = f"{trials.subjects[i]} in the precision of {label}"
        why = f"all trials in {trials.environments[j]} are equal, and zero has no logarithm"
        skipped.append(Skipped(what, why))
    return log_sds, skipped


#: A test of a contrast: the kind of its interval, the interval, and what else it says.
_Tested = Iterator[tuple[Kind, TwoSamples | Interval, dict[str, Any]]]


def _classical(
    data: Data, label: str, contrast: Contrast, cells: SubjectCells
) -> Iterator[ContrastRow | Skipped]:
    """Yield the intervals of a contrast; or say why it has none."""
    is_paired = contrast.within or contrast.of == "level"
    if not is_paired and len(cells.groups) > 1:
        what = f"classical contrasts of groups in {label}"
        yield Skipped(what, "Welch's test compares the groups of one column only")
        return
    tests = _paired if is_paired else _of_groups
    try:
        for kind, found, evidence in tests(data, contrast, cells):
            ends = ends_of(found)
            # Values that are log SDs differ by the logarithm of a ratio.
            ends = np.exp(ends) if contrast.of == "precision" else ends
            n = int(found.n)
            yield contrast_row(data, contrast, ends, n, kind=kind, method="classical", **evidence)
    except RefusalError as refused:
        where = f"in {contrast.environment}" if contrast.environment else "overall"
        yield Skipped(f"contrast of {label}, {contrast.versus}, {where}", str(refused))


def _paired(data: Data, contrast: Contrast, cells: SubjectCells) -> _Tested:
    """Test subjects' own contrasts, of subjects who have every cell."""
    values = cells.at_level(contrast)
    is_complete = np.isfinite(values)
    if is_complete.sum() < 2:
        raise RefusalError("fewer than two subjects have all its levels")
    asked = data.asked
    if contrast.of == "spread":
        second = cells.weighed(np.maximum(contrast.weights, 0.0))[is_complete]
        first = cells.weighed(np.maximum(-contrast.weights, 0.0))[is_complete]
        ratio = spread_ratio(first, second, level=asked.level)
        yield "mean", ratio, {"p_value": ratio.p_value}
        return
    for kind in ("mean",) if contrast.is_ratio else asked.kinds:
        interval, p_value, d_z = paired_contrast(values[is_complete], kind, **claim_of(asked))
        yield kind, interval, {"p_value": p_value, "d_z": d_z} if kind == "mean" else {}


def _of_groups(data: Data, contrast: Contrast, cells: SubjectCells) -> _Tested:
    """Take Welch's interval, or the F interval, of subjects' values in two groups."""
    ((column, groups),) = cells.groups.items()
    # Both groups' values weigh the same cells, which the second one's part of the contrast tells.
    is_second = cells.cells[column].to_numpy() == contrast.groups[1]
    values = cells.weighed(contrast.weights * is_second)
    samples = [values[np.isfinite(values) & (groups == group)] for group in contrast.groups]
    if min(map(len, samples)) < 2:
        raise RefusalError("a group has fewer than two subjects with all cells")
    moments = [Moments.from_values(sample) for sample in samples]
    if min(float(group.sd) for group in moments) == 0.0:
        raise RefusalError("all subjects of a group have one value")
    test = group_spread_ratio if contrast.of == "spread" else group_contrast
    found = test(*moments, level=data.asked.level)
    yield "mean", found, {"p_value": found.p_value}


def posterior_contrasts(fit: Fit) -> Iterator[ContrastRow | Skipped]:
    """Yield every contrast of a fit that passed."""
    if fit.contrasts is None:
        what = " and ".join(fit.data.quantities[p].label for p in fit.parameters)
        yield Skipped(f"Bayesian contrasts of {what}", 'they need [model] pooling = "partial"')
        return
    first = len(fit.model.cells)
    for contrasts, kinds in fit.sums:
        last = first + len(contrasts)
        yield from _rows(fit, contrasts, kinds, fit.all_moments.of(slice(first, last)))
        first = last
    for of, ratios_of in (("spread", _spread_ratios), ("precision", _trial_sd_ratios)):
        ratios = [contrast for contrast in fit.contrasts if contrast.of == of]
        for contrast, draws in zip(ratios, ratios_of(fit, ratios), strict=True):
            limits = fit.limits_of_draws(draws)
            ends = ends_of(limits)
            n = contrast.subjects
            yield contrast_row(fit.data, contrast, ends, n, method="bayesian", error=limits.error)


def _rows(
    fit: Fit, contrasts: Sequence[Contrast], kinds: Sequence[Kind], laws: gaussian.Moments
) -> Iterator[ContrastRow]:
    """Yield the rows of L contrasts of locations, from their laws at every draw."""
    from percept.inference.model.limits import limits_of

    names = [contrast.name for contrast in contrasts]
    found = fit.run.estimates
    estimate = laws.mean.mean(axis=0)
    together = _limits_together(fit, contrasts, kinds, laws)
    for kind in kinds:
        limits = limits_of(found.names, found.value, kind, names)
        ends = np.column_stack([*limits, estimate, together[kind]])
        user_sd = laws.population_sd if kind == "user" else 0.0
        above = special.ndtr(laws.mean / np.hypot(laws.sd, user_sd)).mean(axis=0)
        for i, contrast in enumerate(contrasts):
            evidence: Any = {}
            if kind != "share":
                evidence["probability_above"] = float(above[i])
            if kind == "mean" and contrast.is_of_users:
                d_z = np.median(laws.mean[:, i] / laws.population_sd[:, i])
                evidence["d_z"] = float(d_z)
            n = contrast.subjects
            yield contrast_row(
                fit.data, contrast, ends[i], n, kind=kind, method="bayesian", **evidence
            )


def _limits_together(
    fit: Fit, contrasts: Sequence[Contrast], kinds: Sequence[Kind], laws: gaussian.Moments
) -> dict[Kind, Array]:
    """Limits within which all contrasts of a family lie, (L, 2) by kind; NaN without a family."""
    from percept.inference.model.limits import Limits, level_together

    found = {kind: np.full((len(contrasts), 2), np.nan) for kind in kinds}
    # Levels and slopes have no family.
    by_term: dict[tuple[str, str], list[int]] = {}
    for number, contrast in enumerate(contrasts):
        if contrast.of in ("bias", "interaction"):
            by_term.setdefault((contrast.parameter, contrast.factor), []).append(number)
    families = [members for members in by_term.values() if len(members) > 1]
    if not families:
        return found
    asked = fit.data.asked
    weights = np.array([contrast.row for contrast in contrasts])
    gap = max(1, len(fit.points) // _LEAST_KEPT)
    points = fit.points[::gap]
    affordable = _MOST_NUMBERS // (len(weights) * len(points))
    repeats = min(max(1, affordable), _MOST_REPEATS)
    rng = generator(asked.seed, Stream.CONTRASTS)
    average_users, next_users = fit.model.draw(points, rng, weights, repeats=repeats)
    of_points = fit.model.moments(points, weights)
    for kind, members in itertools.product(kinds, families):
        # Limits of a share hold for one contrast only.
        if kind == "share":
            continue
        drawn = of_points.of(members)
        sd = drawn.sd
        values = average_users
        if kind == "user":
            sd = np.hypot(drawn.sd, drawn.population_sd)
            values = next_users
        level = level_together(drawn.mean, sd, values[:, members], asked.level)
        lower, upper, _ = Limits(fit.model, level=level).of(kind, laws.of(members))
        found[kind][members] = np.stack([lower, upper], axis=1)
    return found


def _spread_ratios(fit: Fit, contrasts: Sequence[Contrast]) -> Sequence[Array]:
    """Draws (S,) of each contrast's ratio of SDs between users."""
    if not contrasts:
        return []
    rows = np.array([contrast.row for contrast in contrasts])
    above = fit.model.moments(fit.points, np.maximum(rows, 0.0))
    below = fit.model.moments(fit.points, np.maximum(-rows, 0.0))
    return list((above.population_sd / below.population_sd).T)


def _trial_sd_ratios(fit: Fit, contrasts: Sequence[Contrast]) -> Iterator[Array]:
    """Draws (S,) of each contrast's ratio of geometric means of SDs between trials."""
    for contrast in contrasts:
        of_cells = [sd for cell, sd in fit.trial_sds.items() if cell[0] == contrast.parameter]
        yield np.exp(contrast.weights @ np.log(of_cells))


def _with_means(data: Data) -> Iterator[tuple[str, Trials, SubjectCells]]:
    """Yield the quantities with trials and subjects' means; the contrasts say why others lack."""
    for parameter in data.parameters if data.sessions.factors else ():
        with suppress(RefusalError):
            trials = data.trials(parameter)
            yield parameter, trials, subject_cells(data, trials, trials.statistics.cell_means[:, 0])


def level_values(data: Data) -> Iterator[LevelValues]:
    """Yield subjects' means at every level of the factors, over all references and at each one."""
    for parameter, trials, cells in _with_means(data):
        for *at_references, overall in level_means(data, trials, parameter):
            for mean in (dataclasses.replace(overall, environment=None), *at_references):
                values, _ = data.differences(parameter, cells.at_level(mean))
                yield LevelValues(
                    factor=mean.factor,
                    level=mean.second,
                    parameter=parameter,
                    environment=mean.environment,
                    within=mean.within,
                    values=tuple(map(known, values.tolist())),
                )


def anova_rows(data: Data) -> Iterator[AnovaRow | Skipped]:
    """Yield the analysis of variance of the model's terms, unless the method is Bayesian alone.

    Each term is tested by itself, and as it differs between references.
    """
    if not data.conditions.factors or data.asked.method == "bayesian":
        return
    # As sets: a:b and b:a are one term.
    terms = {frozenset(term) for term in data.conditions.terms}
    for parameter, trials, cells in _with_means(data):
        try:
            effects = _effects(data, trials, cells)
        except RefusalError as refused:
            what = f"analysis of variance of {data.quantities[parameter].label}"
            yield Skipped(what, str(refused))
            continue
        for effect in effects:
            model_term = frozenset(effect.factors) - {ENVIRONMENT}
            if not model_term or model_term in terms:
                numbers = {**vars(effect), "factor": ":".join(effect.factors)}
                del numbers["factors"]
                n = len(trials.subjects)
                yield AnovaRow(parameter=parameter, family=data.asked.family, n=n, **numbers)


def _effects(data: Data, trials: Trials, cells: SubjectCells) -> Sequence[Effect]:
    """Test subjects' means: an axis for the references, and one for each factor within subjects.

    The factor between subjects, of which there is one at most, puts each into a group.
    """
    factors = data.sessions.factors
    assert factors is not None
    if len(cells.groups) > 1:
        raise RefusalError("it compares the groups of one column only")
    axes = {ENVIRONMENT: tuple(factors.environments), **factors.levels}
    between = next(iter(cells.groups), "")
    group = None
    if between:
        del axes[between]
        group, _ = pd.factorize(cells.groups[between])
    names = cells.cells[[*axes]].itertuples(index=False, name=None)
    by_cell = dict(zip(names, cells.values.T, strict=True))
    keys = list(itertools.product(*axes.values()))
    lacking = np.full(len(trials.subjects), np.nan)
    values = np.stack([by_cell.get(key, lacking) for key in keys], axis=1)
    missing = np.argwhere(np.isnan(values))
    if len(missing):
        row, column = missing[0].tolist()
        environment, *at_levels = keys[column]
        subject = trials.subjects[row]
        count = len(np.unique(missing[:, 0]))
        more = f" Cells are missing for {count} subjects in all." if count > 1 else ""
        cell = factors.cell(environment, at_levels) if at_levels else environment
        name = json.dumps(subject, ensure_ascii=False)  # JSON's texts are TOML's, too
        rule = f'{{ column = "subject", equals = {name}, why = "incomplete" }}'
        raise RefusalError(
            f"{subject} has no trial in {cell}, and the analysis needs complete cells.{more}",
            hint=f"To leave {subject} out: [sessions] exclude = [{rule}]. The contrasts use all"
            " data.",
        )
    if len(factors.environments) == 1:
        del axes[ENVIRONMENT]
    values = values.reshape(len(values), *map(len, axes.values()))
    return anova(values, tuple(axes), group=group, between=between)
