"""Contrasts of a fit: each at the level asked for, and all of a term together.

A plan lists contrasts as weights of the model's locations. Those within subjects ("users") have all
kinds: of the average user, the next one, and a share of them. Those between groups, and slopes of
covariates ("groups"), have the average's only. Contrasts are numbered: users' first, then groups'.

A family is what a reader compares at a glance: all contrasts of one term in one quantity. Its
limits hold together if all its true values lie within theirs at once, with the level asked for.
Joint draws say how much wider single limits must be for that; the limits themselves rest on all
draws of the scales, as those of single contrasts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Self

import numpy as np

from percept.inference.hierarchy.contrasts import ContrastLimits
from percept.inference.hierarchy.families import level_together
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.record import Kind
from percept.inference.sampling.lines import line_limits
from percept.scene import InferenceTable
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.contrast_table import ContrastTable
from percept.study.fit import Fit
from percept.study.intervals import Row
from percept.study.linear import Compared, ContrastPlan

__all__ = ["posterior_contrasts"]

#: Draws of the scales on which families rest: thinned in whole steps, fewer than twice as many.
_MOST_DRAWS = 4096
#: Joint draws of a family for each draw of the scales, at most. With 65,536 in all, the limits that
#: hold together at 99 % are known to 1 % of their half-widths.
_MOST_REPEATS = 16
#: Numbers in all joint draws of a quantity, at most: 32 MB for locations, and 32 MB for users.
_MOST_NUMBERS = 1 << 22


@dataclasses.dataclass(frozen=True)
class _Ends:
    """Limits of one contrast on the response scale."""

    kind: Kind
    lower: float
    upper: float
    estimate: float
    together: tuple[float, float] | None  # Limits that hold with the rest of its family


def posterior_contrasts(fit: Fit, tables: Mapping[str, ContrastTable]) -> Iterator[Row | Skipped]:
    """Yield every contrast of a fit that passed, by the table of each quantity."""
    if fit.contrasts is None:
        what = " and ".join(fit.quantities[p].label for p in fit.parameters)
        yield Skipped(f"Bayesian contrasts of {what}", 'they need [model] pooling = "partial"')
        return
    plan = fit.contrasts
    first_table = next(iter(tables.values()))
    contrasts = _Contrasts(fit, plan, first_table.inference)
    for compared, ends in contrasts.limits():
        # The model's slope is for an SD of its covariate, which `unit` is; elsewhere it is one.
        unit = compared.comparison.unit
        limits = np.array([ends.lower, ends.upper, ends.estimate]) / unit
        yield tables[compared.parameter].row(
            compared.comparison,
            limits,
            compared.subjects,
            method="bayesian",
            kind=ends.kind,
            together=ends.together,
        )
    yield from _spreads(fit, plan, tables)


class _Contrasts:
    """Contrasts of bias and slopes, all kinds of a contrast after each other."""

    def __init__(self, fit: Fit, plan: ContrastPlan, inference: InferenceTable) -> None:
        self._fit = fit
        self._plan = plan
        self._inference = inference
        self._joint = _JointDraws.of(fit, plan, inference.seed)

    def limits(self) -> Iterator[tuple[Compared, _Ends]]:
        """Yield every contrast with its limits, kind by kind."""
        users = self._plan.users
        groups = self._plan.groups
        estimands = self._plan.estimands(self._inference)
        value = self._fit.run.estimates.value
        components = self._fit.run.components
        components = components.reshape(-1, components.shape[-1])
        by_kind = []
        for kind in self._inference.kinds:
            single = estimands.of_users(kind, value, components)
            by_kind.append(self._with_families(users, kind, single, first_number=0))
        for compared, *ends_by_kind in zip(users, *by_kind, strict=True):
            for ends in ends_by_kind:
                yield compared, ends
        single = estimands.of_groups(value, components)
        ends_of_groups = self._with_families(groups, "mean", single, first_number=len(users))
        yield from zip(groups, ends_of_groups, strict=True)

    def _with_families(
        self, compared: Sequence[Compared], kind: Kind, single: ContrastLimits, *, first_number: int
    ) -> list[_Ends]:
        """Put single limits of one kind beside those that hold together.

        `first_number` is that of the first of these contrasts.
        """
        together: dict[int, tuple[float, float]] = {}
        # No family of shares has limits that hold together.
        families = [] if kind == "share" else _families(compared)
        for members in families:
            numbers = [first_number + member for member in members]
            level = self._joint.level_together(numbers, kind, self._inference.level)
            together |= self._wider(members, kind, level, single.laws)
        estimates = single.laws.mean.mean(axis=0).tolist()
        ends = []
        for member, estimate in enumerate(estimates):
            lower = float(single.lower[member])
            upper = float(single.upper[member])
            ends.append(_Ends(kind, lower, upper, estimate, together.get(member)))
        return ends

    def _wider(
        self, members: list[int], kind: Kind, level: float, laws: ConditionalMoments
    ) -> dict[int, tuple[float, float]]:
        """Limits of a family's members at a higher level, by member."""
        intervals = IntervalEstimands(self._fit.model, level=level)
        limits = intervals.limits(kind, laws.of(members))
        lower = limits.lower.tolist()
        upper = limits.upper.tolist()
        pairs = zip(lower, upper, strict=True)
        return dict(zip(members, pairs, strict=True))


@dataclasses.dataclass(frozen=True, eq=False)
class _JointDraws:
    """Joint draws of L contrasts, repeated for some draws of the scales."""

    laws: ConditionalMoments  # (S, L) Given each of these draws of the scales
    locations: Array  # (N, L) Of the average user
    users: Array  # (N, L) Of the next user

    @classmethod
    def of(cls, fit: Fit, plan: ContrastPlan, seed: int) -> Self:
        """Draw all contrasts of a plan."""
        stride = max(1, len(fit.points) // _MOST_DRAWS)
        points = fit.points[::stride]
        rows = plan.rows([*plan.users, *plan.groups])
        numbers_per_repeat = max(1, rows.shape[0] * len(points))
        affordable = max(1, _MOST_NUMBERS // numbers_per_repeat)
        repeats = min(affordable, _MOST_REPEATS)
        rng = generator(seed, Stream.CONTRASTS)
        laws = plan.model.laws_of(rows, points)
        locations, users = plan.model.draw_of(rows, points, rng, repeats=repeats)
        return cls(laws, locations, users)

    def level_together(self, numbers: list[int], kind: Kind, level: float) -> float:
        """Level of single limits at which some contrasts hold together."""
        laws = self.laws.of(numbers)
        if kind == "user":
            sd = np.hypot(laws.sd, laws.population_sd)
            return level_together(laws.mean, sd, self.users[:, numbers], level)
        return level_together(laws.mean, laws.sd, self.locations[:, numbers], level)


def _families(compared: Sequence[Compared]) -> list[list[int]]:
    """Members of each family of several: their places among these contrasts."""
    families: dict[tuple[str, str], list[int]] = {}
    for member, contrast in enumerate(compared):
        comparison = contrast.comparison
        if comparison.of in ("bias", "interaction"):
            term = (contrast.parameter, comparison.factor)
            families.setdefault(term, []).append(member)
    return [family for family in families.values() if len(family) > 1]


def _spreads(
    fit: Fit, plan: ContrastPlan, tables: Mapping[str, ContrastTable]
) -> Iterator[Row | Skipped]:
    """Yield the ratios of SDs between users."""
    for compared in plan.spreads:
        table = tables[compared.parameter]
        comparison = compared.comparison
        log_ratio = plan.log_ratio(compared)
        limits = line_limits(fit.model, fit.run, log_ratio, table.inference.level)
        ends = np.exp([limits.lower, limits.upper, limits.median])
        yield table.row(comparison, ends, compared.subjects, method="bayesian")
        if limits.error > table.inference.tolerance:
            where = comparison.environment or "overall"
            levels = f"{comparison.second} against {comparison.first}"
            what = f"{table.quantity.label}, {levels}, {where}"
            error = f"{100.0 * limits.error:.2g} %"
            why = f"the Monte Carlo error of its limits is {error} of a half-width"
            yield Skipped(f"the tolerance in the ratio of SDs of {what}", why)
