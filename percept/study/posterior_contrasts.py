"""Contrasts of a fit: each at the level asked for, and all of a term together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from percept.inference.hierarchy.contrasts import ContrastLimits
from percept.inference.hierarchy.families import level_together
from percept.inference.hierarchy.laws import ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.record import Kind
from percept.inference.sampling.lines import line_limits
from percept.scene import InferenceTable
from percept.study.basics import Skipped, Stream, generator
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
        stride = max(1, len(fit.points) // _MOST_DRAWS)
        points = fit.points[::stride]
        rows = plan.rows([*plan.users, *plan.groups])
        numbers_per_repeat = max(1, rows.shape[0] * len(points))
        affordable = max(1, _MOST_NUMBERS // numbers_per_repeat)
        rng = generator(inference.seed, Stream.CONTRASTS)
        repeats = min(affordable, _MOST_REPEATS)
        self._laws = plan.model.laws_of(rows, points)
        self._draws = plan.model.draw_of(rows, points, rng, repeats=repeats)

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
            limits = estimands.of_users(kind, value, components)
            by_kind.append(self._of_kind(users, kind, limits, first=0))
        for compared, *ends_by_kind in zip(users, *by_kind, strict=True):
            for ends in ends_by_kind:
                yield compared, ends
        limits = estimands.of_groups(value, components)
        ends_of_groups = self._of_kind(groups, "mean", limits, first=len(users))
        yield from zip(groups, ends_of_groups, strict=True)

    def _of_kind(
        self, compared: Sequence[Compared], kind: Kind, limits: ContrastLimits, *, first: int
    ) -> list[_Ends]:
        """Limits of one kind, with those that hold together.

        `first` is the number of the first of these contrasts among users' and groups' contrasts.
        """
        together: dict[int, tuple[float, float]] = {}
        # No family of shares has limits that hold together.
        families = [] if kind == "share" else _families(compared)
        for family in families:
            numbers = [first + number for number in family]
            level = self._level_together(numbers, kind)
            together |= self._together(family, kind, level, limits.laws)
        estimates = limits.laws.mean.mean(axis=0).tolist()
        ends = []
        for number, estimate in enumerate(estimates):
            lower = float(limits.lower[number])
            upper = float(limits.upper[number])
            ends.append(_Ends(kind, lower, upper, estimate, together.get(number)))
        return ends

    def _level_together(self, numbers: list[int], kind: Kind) -> float:
        """Level of single limits at which a family holds together."""
        laws = self._laws.of(numbers)
        locations, users = self._draws
        if kind == "user":
            sd = np.hypot(laws.sd, laws.population_sd)
            return level_together(laws.mean, sd, users[:, numbers], self._inference.level)
        return level_together(laws.mean, laws.sd, locations[:, numbers], self._inference.level)

    def _together(
        self, family: list[int], kind: Kind, level: float, laws: ConditionalMoments
    ) -> dict[int, tuple[float, float]]:
        """Limits of a family that hold together, by the number of the contrast.

        They rest on all draws, as the limits of single contrasts, which lie within them.
        """
        intervals = IntervalEstimands(self._fit.model, level=level)
        limits = intervals.limits(kind, laws.of(family))
        lower = limits.lower.tolist()
        upper = limits.upper.tolist()
        pairs = zip(lower, upper, strict=True)
        return dict(zip(family, pairs, strict=True))


def _families(compared: Sequence[Compared]) -> list[list[int]]:
    """Numbers of the contrasts of each term in each quantity, where there are several."""
    families: dict[tuple[str, str], list[int]] = {}
    for number, contrast in enumerate(compared):
        comparison = contrast.comparison
        if comparison.of in ("bias", "interaction"):
            term = (contrast.parameter, comparison.factor)
            families.setdefault(term, []).append(number)
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
