"""Contrasts of a fit that passed: limits of each, and limits that hold for a whole term at once.

A contrast is a weighted sum of the model's locations, or a ratio of SDs. Sums of which each user
has one have limits of every kind (the average user, the next one, a share of users); sums over
groups of subjects, and slopes of covariates, have limits of the average user only.

A family is the contrasts of one term in one quantity: what a reader compares at a glance. Its
limits hold together if, with the level asked for, all its true values lie within them at once. They
are single limits at a higher level. Joint draws of the L sums say how high that level must be; the
limits themselves rest on every draw of the scales, as all single limits do.

Shapes: S draws of the scales, a few joint draws for each of them, N in all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from percept.inference.model.laws import Moments
from percept.inference.model.limits import Limits, level_together, limits_of
from percept.inference.record import Kind
from percept.inference.sampling.lines import line_limits
from percept.results import ContrastRow, Skipped
from percept.study.basics import Array, Stream, generator
from percept.study.contrasts import contrast_row
from percept.study.fit import Fit
from percept.study.linear import Contrast, rows_of

#: Draws of the scales, S, that joint draws are made for. Every k-th draw of the fit is kept, with k
#: a whole number: up to twice as many stay.
_LEAST_KEPT = 4096
#: Joint draws for each draw of the scales, at most. With 16 times 4096 in all, limits that hold
#: together at 99 % are known to 1 % of their half-widths.
_MOST_REPEATS = 16
#: Numbers in an array of joint draws, (N, L), at most: 32 MB. There are two, of average users and
#: of next users.
_MOST_NUMBERS = 1 << 22


def posterior_contrasts(fit: Fit) -> Iterator[ContrastRow | Skipped]:
    """Yield every contrast of a fit that passed."""
    if fit.contrasts is None:
        what = " and ".join(fit.data.quantities[p].label for p in fit.parameters)
        yield Skipped(f"Bayesian contrasts of {what}", 'they need [model] pooling = "partial"')
        return
    users = [one for one in fit.contrasts if one.is_of_users]
    groups = [one for one in fit.contrasts if one.is_of_groups]
    if users or groups:
        joint = _joint_draws(fit, [*users, *groups])
        of_fit = fit.all_moments.of(slice(len(fit.model.cells), None))
        for kind in fit.data.asked.kinds:
            yield from _rows(fit, users, kind, of_fit, joint)
        later = slice(len(users), None)
        yield from _rows(fit, groups, "mean", of_fit.of(later), joint.of(later))
    for contrast in fit.contrasts:
        if contrast.is_ratio:
            yield from _ratio(fit, contrast)


class _JointDraws(NamedTuple):
    """Joint draws of L contrasts."""

    laws: Moments  # (S, L) Of each contrast, given a draw of the scales
    average_users: Array  # (N, L)
    next_users: Array  # (N, L)

    def of(self, numbers: slice | list[int]) -> _JointDraws:
        """Draws of some of the contrasts."""
        laws = self.laws.of(numbers)
        return _JointDraws(laws, self.average_users[:, numbers], self.next_users[:, numbers])

    def level_of_single(self, kind: Kind, level: float) -> float:
        """Level of single limits at which these contrasts all hold with the given level."""
        mean = self.laws.mean
        if kind == "user":
            sd = np.hypot(self.laws.sd, self.laws.population_sd)
            return level_together(mean, sd, self.next_users, level)
        return level_together(mean, self.laws.sd, self.average_users, level)


def _joint_draws(fit: Fit, contrasts: Sequence[Contrast]) -> _JointDraws:
    """Draw contrasts jointly."""
    stride = max(1, len(fit.points) // _LEAST_KEPT)
    points = fit.points[::stride]
    weights = rows_of(contrasts)
    affordable = max(1, _MOST_NUMBERS // max(1, len(weights) * len(points)))
    repeats = min(affordable, _MOST_REPEATS)
    rng = generator(fit.data.asked.seed, Stream.CONTRASTS)
    average_users, next_users = fit.model.draw(points, rng, weights, repeats=repeats)
    return _JointDraws(fit.model.moments(points, weights), average_users, next_users)


def _rows(
    fit: Fit, contrasts: Sequence[Contrast], kind: Kind, moments: Moments, joint: _JointDraws
) -> Iterator[ContrastRow]:
    """Yield the rows of one kind, from the contrasts' moments (S, L) at every draw."""
    found = fit.run.estimates
    lower, upper = limits_of(found.names, found.value, kind, [one.place for one in contrasts])
    estimate = moments.mean.mean(axis=0)
    user_sd = moments.population_sd if kind == "user" else 0.0
    above = special.ndtr(moments.mean / np.hypot(moments.sd, user_sd)).mean(axis=0)
    together: dict[int, Array] = {}
    # Limits of a share hold for one contrast only.
    for members in [] if kind == "share" else _families(contrasts):
        level = joint.of(members).level_of_single(kind, fit.data.asked.level)
        lowers, uppers, _ = Limits(fit.model, level=level).of(kind, moments.of(members))
        together |= zip(members, np.stack([lowers, uppers], axis=1), strict=True)
    for i, contrast in enumerate(contrasts):
        evidence: dict[str, float | None] = {}
        if kind != "share":
            evidence["probability_above"] = float(above[i])
        if kind == "mean" and contrast.is_of_users:
            d_z = np.median(moments.mean[:, i] / moments.population_sd[:, i])
            evidence["d_z"] = float(d_z)
        # A slope of the model is for one SD of its covariate, and a row's for one unit of it:
        # `unit` is that SD. It is 1 for all other contrasts, and slopes are in no family.
        ends = np.array([lower[i], upper[i], estimate[i]]) / contrast.comparison.unit
        yield contrast_row(
            fit.data,
            contrast.parameter,
            contrast.comparison,
            contrast.of,
            ends,
            contrast.subjects,
            "bayesian",
            evidence,
            kind,
            together.get(i),
        )


def _families(contrasts: Sequence[Contrast]) -> list[list[int]]:
    """Return the indices of each family's contrasts; levels, slopes and lone ones have none."""
    families: dict[tuple[str, str], list[int]] = {}
    for index, contrast in enumerate(contrasts):
        if contrast.of in ("bias", "interaction"):
            term = (contrast.parameter, contrast.comparison.factor)
            families.setdefault(term, []).append(index)
    return [members for members in families.values() if len(members) > 1]


def _ratio(fit: Fit, contrast: Contrast) -> Iterator[ContrastRow | Skipped]:
    """Yield a ratio of SDs, and where its limits miss the tolerance."""
    second = np.maximum(contrast.row, 0.0)
    first = np.maximum(-contrast.row, 0.0)

    def log_ratio(points: Array) -> Array:
        """Log ratio of SDs between users, or of geometric means of cells' trial SDs, (W,)."""
        if contrast.of == "spread":
            sds = fit.model.user_sds(points, np.stack([second, first]))
            return np.asarray(np.log(sds[:, 0] / sds[:, 1]))
        log_sds = []
        for model, own in fit.model.split(points):
            of_locations = np.zeros((len(points), model.locations))
            scales = model.scales(own)
            if "sigma_e" in scales:
                _, sd = scales["sigma_e"]
                of_locations[:, : len(model.cells)] = np.log(sd).reshape(len(points), -1)
            log_sds.append(of_locations)
        return np.asarray(np.hstack(log_sds) @ contrast.row)

    data = fit.data
    comparison = contrast.comparison
    limits = line_limits(fit.model, fit.run, log_ratio, data.asked.level)
    ends = np.exp([limits.lower, limits.upper, limits.median])
    yield contrast_row(
        data, contrast.parameter, comparison, contrast.of, ends, contrast.subjects, "bayesian", {}
    )
    if limits.error > data.asked.tolerance:
        label = data.quantities[contrast.parameter].label
        where = comparison.environment or "overall"
        what = f"the tolerance in the {contrast.of} of {label}, {comparison.versus}, {where}"
        why = f"the Monte Carlo error of its limits is {limits.error:.2%} of a half-width"
        yield Skipped(what, why)
