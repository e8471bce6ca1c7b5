"""Contrasts of a fit that passed: limits of each, and limits that hold for a whole term at once.

A contrast is a weighted sum of the model's locations. A plan has L of them in this order:

- `users`, within subjects: limits of every kind (the average user, the next one, a share of users);
- `groups`, between groups of subjects, and slopes of covariates: limits of the average user only.

A family is the contrasts of one term in one quantity: what a reader compares at a glance. Its
limits hold together if, with the level asked for, all its true values lie within them at once. They
are single limits at a higher level. Joint draws of the L contrasts say how high that level must be;
the limits themselves rest on every draw of the scales, as all single limits do.

Shapes: S draws of the scales, a few joint draws for each of them, N in all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Self

import numpy as np
from scipy import special

from percept.inference.model.laws import Moments
from percept.inference.model.limits import Limits, level_together, limits_of
from percept.inference.record import Kind
from percept.inference.sampling.lines import line_limits
from percept.results import ContrastRow, Skipped
from percept.scene import InferenceTable
from percept.study.basics import Array, Stream, generator
from percept.study.contrast_table import ContrastTable
from percept.study.fit import Fit
from percept.study.linear import Compared, ContrastPlan

#: Draws of the scales, S, that joint draws are made for. Every k-th draw of the fit is kept, with k
#: a whole number: up to twice as many stay.
_LEAST_KEPT = 4096
#: Joint draws for each draw of the scales, at most. With 16 times 4096 in all, limits that hold
#: together at 99 % are known to 1 % of their half-widths.
_MOST_REPEATS = 16
#: Numbers in an array of joint draws, (N, L), at most: 32 MB. There are two, of average users and
#: of next users.
_MOST_NUMBERS = 1 << 22


@dataclasses.dataclass(frozen=True)
class _Ends:
    """Limits of one contrast on the response scale."""

    kind: Kind
    lower: float
    upper: float
    estimate: float
    probability_above: float | None  # That it exceeds zero; None for a share of users
    d_z: float | None  # Of the average user; None where users have no contrast of their own
    together: tuple[float, float] | None  # Limits that hold with its family; None without one


def posterior_contrasts(
    fit: Fit, tables: Mapping[str, ContrastTable]
) -> Iterator[ContrastRow | Skipped]:
    """Yield every contrast of a fit that passed, by the table of each quantity."""
    if fit.contrasts is None:
        what = " and ".join(fit.data.quantities[p].label for p in fit.parameters)
        yield Skipped(f"Bayesian contrasts of {what}", 'they need [model] pooling = "partial"')
        return
    plan = fit.contrasts
    first_table = next(iter(tables.values()))
    contrasts = _Contrasts(fit, plan, first_table.data.asked)
    for compared, ends in contrasts.limits():
        # A slope of the model is for one SD of its covariate, and a row's for one unit of it:
        # `unit` is that SD. It is 1 for all other contrasts, and slopes are in no family.
        limits = np.array([ends.lower, ends.upper, ends.estimate]) / compared.comparison.unit
        yield tables[compared.parameter].row(
            compared.comparison,
            limits.tolist(),
            compared.subjects,
            "bayesian",
            ends.kind,
            probability_above=ends.probability_above,
            d_z=ends.d_z,
            together=ends.together,
        )
    for compared in plan.spreads:
        table = tables[compared.parameter]
        yield from _ratio(fit, compared, plan.log_ratio(compared), table)
    for compared in plan.precisions:
        table = tables[compared.parameter].of_trials
        yield from _ratio(fit, compared, plan.log_precision(compared), table)


class _Contrasts:
    """Limits of all contrasts of a plan but ratios of SDs."""

    def __init__(self, fit: Fit, plan: ContrastPlan, inference: InferenceTable) -> None:
        self._fit = fit
        self._plan = plan
        self._inference = inference
        self._joint = _JointDraws.of(fit, plan, inference.seed)

    def limits(self) -> Iterator[tuple[Compared, _Ends]]:
        """Yield every contrast with its limits: all kinds of one contrast, then the next one."""
        users = self._plan.users
        groups = self._plan.groups
        ends_by_kind = []
        for kind in self._inference.kinds:
            ends_by_kind.append(self._ends(users, kind, first_column=0))
        for index, compared in enumerate(users):
            for ends in ends_by_kind:
                yield compared, ends[index]
        ends_of_groups = self._ends(groups, "mean", first_column=len(users))
        yield from zip(groups, ends_of_groups, strict=True)

    def _ends(self, compared: Sequence[Compared], kind: Kind, *, first_column: int) -> list[_Ends]:
        """Join single limits of one kind with the limits that hold together.

        `first_column` is the column of the first of these contrasts in the joint draws.
        """
        found = self._fit.run.estimates
        names = [own.place for own in compared]
        lowers, uppers = limits_of(found.names, found.value, kind, names)
        first = len(self._fit.model.cells) + first_column
        moments = self._fit.all_moments.of(slice(first, first + len(compared)))
        together: dict[int, tuple[float, float]] = {}
        # Limits of a share hold for one contrast only.
        families = [] if kind == "share" else _families(compared)
        for members in families:
            columns = [first_column + member for member in members]
            level = self._joint.level_of_single(columns, kind, self._inference.level)
            joint = Limits(self._fit.model, level=level)
            lower_ends, upper_ends, _ = joint.of(kind, moments.of(members))
            pairs = zip(lower_ends.tolist(), upper_ends.tolist(), strict=True)
            together |= zip(members, pairs, strict=True)
        estimates = moments.mean.mean(axis=0)
        rows = np.stack([lowers, uppers, estimates], axis=1).tolist()
        user_sd = moments.population_sd if kind == "user" else 0.0
        above = special.ndtr(moments.mean / np.hypot(moments.sd, user_sd)).mean(axis=0)
        ends = []
        for index, (lower, upper, estimate) in enumerate(rows):
            probability = None if kind == "share" else float(above[index])
            d_z = None
            if kind == "mean" and compared[index].comparison.of_users:
                d_z = float(np.median(moments.mean[:, index] / moments.population_sd[:, index]))
            joint_ends = together.get(index)
            ends.append(_Ends(kind, lower, upper, estimate, probability, d_z, joint_ends))
        return ends


@dataclasses.dataclass(frozen=True, eq=False)
class _JointDraws:
    """Joint draws of all L contrasts of a plan."""

    laws: Moments  # (S, L) Of each contrast, given a draw of the scales
    average_users: Array  # (N, L)
    next_users: Array  # (N, L)

    @classmethod
    def of(cls, fit: Fit, plan: ContrastPlan, seed: int) -> Self:
        """Draw all contrasts of a plan."""
        stride = max(1, len(fit.points) // _LEAST_KEPT)
        points = fit.points[::stride]
        weights = plan.rows([*plan.users, *plan.groups])
        numbers_per_repeat = max(1, len(weights) * len(points))
        affordable = max(1, _MOST_NUMBERS // numbers_per_repeat)
        repeats = min(affordable, _MOST_REPEATS)
        rng = generator(seed, Stream.CONTRASTS)
        laws = plan.model.moments(points, weights)
        average_users, next_users = plan.model.draw(points, rng, weights, repeats=repeats)
        return cls(laws, average_users, next_users)

    def level_of_single(self, columns: list[int], kind: Kind, level: float) -> float:
        """Level of single limits at which these contrasts all hold with the given level."""
        laws = self.laws.of(columns)
        if kind == "user":
            sd = np.hypot(laws.sd, laws.population_sd)
            return level_together(laws.mean, sd, self.next_users[:, columns], level)
        return level_together(laws.mean, laws.sd, self.average_users[:, columns], level)


def _families(compared: Sequence[Compared]) -> list[list[int]]:
    """Return the indices of each family's contrasts; levels, slopes and lone ones have none."""
    families: dict[tuple[str, str], list[int]] = {}
    for index, contrast in enumerate(compared):
        comparison = contrast.comparison
        if comparison.of in ("bias", "interaction"):
            term = (contrast.parameter, comparison.factor)
            families.setdefault(term, []).append(index)
    return [members for members in families.values() if len(members) > 1]


def _ratio(
    fit: Fit, compared: Compared, log_ratio: Callable[[Array], Array], table: ContrastTable
) -> Iterator[ContrastRow | Skipped]:
    """Yield a ratio of SDs, and where its limits miss the tolerance."""
    asked = table.data.asked
    comparison = compared.comparison
    limits = line_limits(fit.model, fit.run, log_ratio, asked.level)
    ends = np.exp([limits.lower, limits.upper, limits.median])
    yield table.row(comparison, ends.tolist(), compared.subjects, "bayesian")
    if limits.error > asked.tolerance:
        where = comparison.environment or "overall"
        levels = f"{comparison.second} against {comparison.first}"
        what = f"{table.label}, {levels}, {where}"
        error = f"{100.0 * limits.error:.2g} %"
        why = f"the Monte Carlo error of its limits is {error} of a half-width"
        yield Skipped(f"the tolerance in the ratio of SDs of {what}", why)
