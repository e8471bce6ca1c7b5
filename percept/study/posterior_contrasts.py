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

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from percept.inference.model.gaussian import Moments
from percept.inference.model.limits import Limits, level_together, limits_of
from percept.inference.record import Kind
from percept.results import ContrastRow, Skipped
from percept.study.basics import Array, Stream, generator
from percept.study.contrasts import contrast_row
from percept.study.fit import Fit
from percept.study.linear import Contrast, rows_of
from percept.study.posterior_psychophysics import DrawLimits

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
    first = len(fit.model.cells)
    for contrasts, kinds in fit.sums:
        last = first + len(contrasts)
        yield from _rows(fit, contrasts, kinds, fit.all_moments.of(slice(first, last)))
        first = last
    for contrast in fit.contrasts:
        if contrast.comparison.is_ratio:
            yield _ratio(fit, contrast)


def _rows(
    fit: Fit, contrasts: Sequence[Contrast], kinds: Sequence[Kind], laws: Moments
) -> Iterator[ContrastRow]:
    """Yield the rows of L contrasts of locations, from their laws at every draw."""
    names = [contrast.name for contrast in contrasts]
    found = fit.run.estimates
    estimate = laws.mean.mean(axis=0)
    limits_together = _limits_together(fit, contrasts, kinds, laws)
    for kind in kinds:
        lower, upper = limits_of(found.names, found.value, kind, names)
        user_sd = laws.population_sd if kind == "user" else 0.0
        above = special.ndtr(laws.mean / np.hypot(laws.sd, user_sd)).mean(axis=0)
        for i, contrast in enumerate(contrasts):
            evidence = {}
            if kind != "share":
                evidence["probability_above"] = float(above[i])
            if kind == "mean" and contrast.comparison.is_of_users:
                d_z = np.median(laws.mean[:, i] / laws.population_sd[:, i])
                evidence["d_z"] = float(d_z)
            yield contrast_row(
                fit.data,
                contrast.parameter,
                contrast.comparison,
                [lower[i], upper[i], estimate[i]],
                contrast.subjects,
                kind=kind,
                method="bayesian",
                together=limits_together.get((kind, i)),
                **evidence,
            )


def _limits_together(
    fit: Fit, contrasts: Sequence[Contrast], kinds: Sequence[Kind], laws: Moments
) -> dict[tuple[Kind, int], Array]:
    """Limits within which all contrasts of a family lie, by kind and number of the contrast."""
    families = _families(contrasts)
    if not families:
        return {}
    asked = fit.data.asked
    weights = rows_of(contrasts)
    gap = max(1, len(fit.points) // _LEAST_KEPT)
    points = fit.points[::gap]
    affordable = _MOST_NUMBERS // (len(weights) * len(points))
    repeats = min(max(1, affordable), _MOST_REPEATS)
    rng = generator(asked.seed, Stream.CONTRASTS)
    average_users, next_users = fit.model.draw(points, rng, weights, repeats=repeats)
    of_points = fit.model.moments(points, weights)
    found: dict[tuple[Kind, int], Array] = {}
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
        limits = Limits(fit.model, level=level)
        lower, upper, _ = limits.of(kind, laws.of(members))
        ends = np.stack([lower, upper], axis=1)
        for number, of_member in zip(members, ends, strict=True):
            found[kind, number] = of_member
    return found


def _families(contrasts: Sequence[Contrast]) -> list[list[int]]:
    """Return the numbers of each family's contrasts; levels, slopes and lone ones have none."""
    families: dict[tuple[str, str], list[int]] = {}
    for number, contrast in enumerate(contrasts):
        if contrast.comparison.of in ("bias", "interaction"):
            term = (contrast.parameter, contrast.comparison.factor)
            families.setdefault(term, []).append(number)
    return [members for members in families.values() if len(members) > 1]


def _ratio(fit: Fit, contrast: Contrast) -> ContrastRow:
    """Make the row of a ratio of SDs, from every draw."""
    comparison = contrast.comparison
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    if comparison.of == "spread":
        second = np.maximum(contrast.row, 0.0)
        first = np.maximum(-contrast.row, 0.0)
        sds = fit.model.user_sds(points, np.stack([second, first]))
        ratios = sds[:, 0] / sds[:, 1]
    else:
        # Geometric means of trial SDs; locations that are no cells have none.
        log_sds = []
        for model, coordinates in fit.model.split(points):
            of_locations = np.zeros((len(points), model.locations))
            scales = model.scales(coordinates)
            if "sigma_e" in scales:
                _, sd = scales["sigma_e"]
                of_locations[:, : len(model.cells)] = np.log(sd).reshape(len(points), -1)
            log_sds.append(of_locations)
        ratios = np.exp(np.hstack(log_sds) @ contrast.row)
    limits = DrawLimits(fit.data.asked.level, fit.run.batches(every=True)).of(ratios)
    return contrast_row(
        fit.data,
        contrast.parameter,
        comparison,
        [limits.lower, limits.upper, limits.estimate],
        contrast.subjects,
        method="bayesian",
        error=limits.error,
    )
