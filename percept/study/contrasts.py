"""Contrasts of conditions within subjects: of bias and of spread, per reference and overall."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from percept.errors import RefusalError, counted
from percept.inference.classical.contrasts import paired_contrast, spread_ratio
from percept.inference.classical.trials import subject_means
from percept.inference.record import percent
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantity
from percept.sessions.records import Factor
from percept.study.basics import Array, Skipped, claim_of
from percept.study.intervals import Row
from percept.study.responses import Trials, by_difference, lacking_scatter, trials

# The classical contrasts do without the model.
if TYPE_CHECKING:
    from percept.inference.hierarchy.within import WithinSubjects
    from percept.inference.sampling.gate import Run

__all__ = ["contrast_rows", "within_model"]


@dataclasses.dataclass(frozen=True)
class _Pair:
    """Two levels of a factor that one quantity is compared at: the second against the first."""

    factor: Factor
    levels: tuple[str, str]
    quantity: Quantity
    asked: InferenceTable
    alone: bool  # Whether it is the only quantity analysed
    scale: float | None  # Of differences in the quantity's unit; None for ratios and for references
    subjects: int  # In the study, with both levels or not
    users: tuple[str, str]  # What the study calls one user and several

    def __str__(self) -> str:
        return f"{self.quantity.label}, {self.levels[1]} against {self.levels[0]}"

    def row(
        self,
        references: Sequence[str],
        ends: Sequence[float] | Array,
        n: int,
        *,
        method: str,
        kind: str | None = None,
        overall: bool = False,
        p_value: float | None = None,
        error: float | None = None,
    ) -> Row:
        """Make a row of lower, upper and estimate on the response scale; of spread where there is no kind.

        The `error` is that of Monte Carlo, where no stopping rule bounds it.
        """
        asked = self.asked
        share = kind == "share"
        log = asked.family == "lognormal"
        limits = np.asarray(ends, dtype=float)
        if kind and log:
            with np.errstate(over="ignore"):
                limits = np.exp(limits)
        elif kind and self.scale is not None:
            limits = limits * self.scale
        lower, upper, estimate = limits.tolist()
        unit = "" if log or not kind else self.unit
        return {
            "factor": self.factor.name,
            "first": self.levels[0],
            "second": self.levels[1],
            "environment": None if overall else references[0],
            "references": list(references),
            "parameter": self.quantity.name,
            "of": "bias" if kind else "spread",
            "kind": kind,
            "method": method,
            "family": asked.family,
            "level": asked.level,
            "share": asked.held_share if share else None,
            "confidence": asked.confidence if share else None,
            "lower": lower,
            "upper": upper,
            "estimate": estimate,
            "unit": unit,
            "p_value": p_value,
            "error": error,
            "n": n,
            "of_subjects": self.subjects,
            "of_references": len(self.factor.environments),
            "covers": self._covers(kind, method, self._basis(n, references, overall=overall)),
        }

    @property
    def unit(self) -> str:
        """Unit of differences."""
        return "references" if self.scale is None else self.quantity.unit or "units"

    def _basis(self, n: int, references: Sequence[str], *, overall: bool) -> str:
        """Say which subjects and references a contrast rests on."""
        users = f"from {n} of {counted(self.subjects, *self.users)}, with both levels"
        if not overall:
            return users
        every = len(self.factor.environments)
        if len(references) == every:
            return f"{users}, over all {every} references"
        return f"{users}, over {len(references)} of {every} references: {', '.join(references)}"

    def _covers(self, kind: str | None, method: str, basis: str) -> str:
        """Say in a sentence what a contrast's limits hold."""
        first, second = self.levels
        log = self.asked.family == "lognormal"
        user, users = self.users
        how = (
            f"{second} over {first}"
            if log or not kind
            else f"{second} less {first}, in {self.unit}"
        )
        sure = percent(self.asked.confidence if kind == "share" else self.asked.level)
        sure += (
            " confidence"
            if method == "classical"
            else " probability under the model and its priors"
        )
        what = f"{'ratio' if log else 'difference'} of {self.quantity.label} ({how})"
        if not kind:
            start = f"The ratio of SDs between {users} of {self.quantity.label} ({how})"
        elif kind == "share":
            start = f"For at least {percent(self.asked.held_share)} of all {users} the {what}"
        else:
            who = "next" if kind == "user" else "typical" if log else "average"
            start = f"The {who} {user}'s {what}"
        said = f"{start} lies between the limits, with {sure} ({basis})."
        return (
            said
            if self.alone
            else f"{said} Each quantity is compared by itself, without correlations."
        )


def contrast_rows(
    sessions: Sessions, parameters: tuple[str, ...], scene: Scene, **how: Any
) -> Iterator[Row | Skipped]:
    """Yield the contrasts of every method asked for; `how` is the sampler's progress and store."""
    factor = sessions.factor
    asked = scene.inference
    assert factor is not None
    pairs: dict[str, list[_Pair]] = {}
    for p in parameters:
        scale = scene.model.scale.get(p) if by_difference(sessions, p) else None
        alone = len(parameters) == 1
        subjects = len(sessions.subjects)
        pairs[p] = [
            _Pair(
                factor,
                levels,
                sessions.quantities[p],
                asked,
                alone,
                scale,
                subjects,
                scene.user_noun,
            )
            for levels in factor.pairs
        ]
    for p, of_quantity in pairs.items() if asked.method != "bayesian" else ():
        try:
            data = trials(sessions, scene, (p,))
        except RefusalError as refused:
            yield Skipped(f"contrasts of {sessions.quantities[p].label}", str(refused))
            continue
        values = _subject_means(data)
        for pair in of_quantity:
            yield from _classical(values, pair)
    for pair in (
        (pair for own in pairs.values() for pair in own) if asked.method != "classical" else ()
    ):
        try:
            yield from _bayesian(sessions, scene, pair, **how)
        except RefusalError as refused:
            yield Skipped(f"Bayesian contrast of {pair}", str(refused))
        except np.linalg.LinAlgError:
            why = "both levels hold nearly the same values, so the model cannot tell them apart"
            yield Skipped(f"Bayesian contrast of {pair}", why)


def _subject_means(data: Trials) -> pd.DataFrame:
    """Subjects' means on the model's scale, a column per cell."""
    means = {}
    for at, cell in enumerate(data.environments):
        own = data.environment == at
        who = data.subject[own]
        values = subject_means(data.response[own, 0], who).values
        means[cell] = pd.Series(values, index=list(dict.fromkeys(who.tolist())))
    return pd.DataFrame(means)


def _classical(values: pd.DataFrame, pair: _Pair) -> Iterator[Row | Skipped]:
    """Yield paired t intervals and ratios of SDs, of each reference and of subjects' averages."""
    names = pair.factor.environments
    first, second = (
        values.reindex(columns=[pair.factor.cell(e, level) for e in names]).set_axis(names, axis=1)
        for level in pair.levels
    )
    both = first.notna() & second.notna()
    paired = both.any(axis=1)
    if unpaired := int((~paired).sum()):
        who = counted(unpaired, "subject")
        yield Skipped(f"{who} in contrasts of {pair}", "no reference has both levels")
    for name in names:
        ends = [level.loc[both[name], name].to_numpy(dtype=float) for level in (first, second)]
        yield from _of_subjects(ends, pair, [name], f"{pair}, in {name}")
    if len(names) == 1:
        return
    shared = [str(e) for e in both.columns[both[paired].all(axis=0)]] if paired.any() else []
    if not shared:
        yield Skipped(
            f"overall contrast of {pair}", "no reference has both levels for every subject"
        )
        return
    if left := [e for e in names if e not in shared]:
        why = "some subjects lack a level there"
        yield Skipped(f"{', '.join(left)} in the overall contrast of {pair}", why)
    ends = [
        level.loc[paired, shared].mean(axis=1).to_numpy(dtype=float) for level in (first, second)
    ]
    yield from _of_subjects(ends, pair, shared, f"{pair}, overall", overall=True)


def _of_subjects(
    ends: Sequence[Array],
    pair: _Pair,
    references: Sequence[str],
    what: str,
    *,
    overall: bool = False,
) -> Iterator[Row | Skipped]:
    """Yield the rows of subjects' values at both levels."""
    (first, second), asked = ends, pair.asked
    n = len(first)
    if n < 2:
        yield Skipped(f"contrast of {what}", "fewer than two subjects have both levels")
        return
    of_subjects: dict[str, Any] = {"method": "classical", "overall": overall}
    try:
        for kind in asked.kinds:
            found, p_value = paired_contrast(second - first, kind, **claim_of(asked))
            p = p_value if kind == "mean" else None
            limits = np.array([found.lower, found.upper, found.estimate], dtype=float)
            yield pair.row(references, limits, n, kind=kind, p_value=p, **of_subjects)
        ratio = spread_ratio(first, second, level=asked.level)
    except RefusalError as refused:
        yield Skipped(f"contrast of {what}", str(refused))
        return
    limits = np.array([ratio.lower, ratio.upper, ratio.estimate])
    yield pair.row(references, limits, ratio.n, p_value=ratio.p_value, **of_subjects)


def within_model(
    sessions: Sessions, parameter: str, scene: Scene, levels: tuple[str, str]
) -> WithinSubjects:
    """Build the model of one quantity at two levels, of the references that have both."""
    from percept.inference.hierarchy.priors import Priors
    from percept.inference.hierarchy.within import WithinSubjects

    if scene.model.pooling == "none":
        raise RefusalError('it needs [model] pooling = "partial".')
    factor = sessions.factor
    assert factor is not None
    known = sessions.table[sessions.table[f"{parameter}_adj"].notna()]
    present = set(known["environment"])
    names = [
        e for e in factor.environments if all(factor.cell(e, level) in present for level in levels)
    ]
    if len(names) < 2:
        raise RefusalError("it needs two references that have both levels.")
    cells = [factor.cell(e, level) for e in names for level in levels]
    both = known[known["environment"].isin(cells)]
    scaled = [parameter] if by_difference(sessions, parameter) else []
    data = trials(dataclasses.replace(sessions, table=both), scene, (parameter,), scaled=scaled)
    statistics = data.statistics
    lacking_scatter(statistics, (), sessions.quantities)
    at = [factor.cells[cell] for cell in statistics.environments]
    return WithinSubjects(
        statistics,
        np.array([names.index(environment) for environment, _ in at]),
        np.array([level == levels[1] for _, level in at]),
        names=tuple(names),
        priors=Priors(**scene.model.priors),
    )


def _bayesian(sessions: Sessions, scene: Scene, pair: _Pair, **how: Any) -> Iterator[Row | Skipped]:
    """Yield the rows of a model of its own, whose SDs of subjects hold at both levels."""
    from percept.inference.hierarchy.density import ConditionalMoments
    from percept.study.fit import sampled

    asked = pair.asked
    model = within_model(sessions, pair.quantity.name, scene, pair.levels)
    run = sampled(model, asked, **how)
    if not run.gate.passed:
        yield Skipped(f"Bayesian contrast of {pair}", " ".join(run.gate.reasons))
        return
    laws = ConditionalMoments.unpack(run.components.reshape(-1, run.components.shape[-1]))
    limits = run.estimates.value.reshape(len(asked.kinds), 2, -1)
    spreads, errors = _spread_limits(model, run, asked.level)
    there = np.isfinite(model.statistics.cell_means[:, 0])
    names = [name for _, name in model.cells[:-1]]
    paired = [there[:, model.reference == j].all(axis=1) for j in range(len(names))]
    for c, own in enumerate([*paired, np.any(paired, axis=0)]):
        overall = c == len(names)
        references = names if overall else [names[c]]
        n = int(own.sum())
        of_model: dict[str, Any] = {"method": "bayesian", "overall": overall}
        for kind, (lower, upper) in zip(asked.kinds, limits[..., c], strict=True):
            ends = [lower, upper, laws.mean[:, c].mean()]
            yield pair.row(references, ends, n, kind=kind, **of_model)
        if not overall:
            yield pair.row(references, spreads[:, c], n, error=float(errors[c]), **of_model)
    yield Skipped(
        f"Bayesian overall ratio of SDs of {pair}",
        "the model has one SD of the subject effect for both levels, which makes the overall ratio"
        " falsely certain",
    )


def _spread_limits(model: WithinSubjects, run: Run, level: float) -> tuple[Array, Array]:
    """Lower, upper and middle ratio of SDs of each contrast (3, J + 1), and their Monte Carlo errors.

    The errors (J + 1,) are the larger of both limits', in half-widths on the log scale, by the
    jackknife over batches of draws: quantiles of draws lie outside the sampler's stopping rule.
    """
    kept = run.independent()
    ratios = model.spread_ratios(kept.reshape(-1, kept.shape[-1]))
    tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    limits = np.quantile(ratios, [*tails, 0.5], axis=0)
    batch = run.batches()
    names = np.unique(batch)
    without = [np.quantile(np.log(ratios[batch != name]), tails, axis=0) for name in names]
    variance = (names.size - 1) * np.var(without, axis=0)
    half_width = 0.5 * np.log(limits[1] / limits[0])
    return limits, np.sqrt(variance).max(axis=0) / half_width
