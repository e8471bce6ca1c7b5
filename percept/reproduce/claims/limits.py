"""Claims on Table 1: what a 99 % interval of ten subjects covers."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
from scipy import special

from percept.haptics import Device, magnitude_envelope_ellipse
from percept.inference import (
    Moments,
    bias,
    rectangle_region,
    t_interval,
    tolerance_factor,
)
from percept.inference.classical.quantiles import normal_upper, t_upper
from percept.reproduce.claims.record import Claim, Quantity, listed
from percept.reproduce.published import ENOUGH_SUBJECTS, LOOKED_AT, Published

_SHARE_CONFIDENCE = 0.95
_CORRELATIONS = (-0.9, 0.0, 0.9)
_DIGITS_PRINTED = 4  # of most limits of Table 1


def limits_printed(published: Published) -> list[tuple[str, str, str, str]]:
    """Return Table 1 as percept prints it: name, parameter, lower and upper limit as text."""
    interval = t_interval(published.moments, level=published.limits.level)
    lower, upper = np.asarray(interval.lower), np.asarray(interval.upper)
    rows: list[tuple[str, str, str, str]] = []
    for row, name in enumerate(published.limits.environments):
        for column, parameter in enumerate(published.limits.parameters):
            printed = published.limits.lower[row][column], published.limits.upper[row][column]
            found = lower[row, column], upper[row, column]
            rows.append(
                (name, parameter, _as_printed(found[0], printed[0]), _as_printed(found[1], printed[1]))
            )
    return rows


def _as_printed(value: float, like: Decimal) -> str:
    return str(Decimal(float(value)).quantize(like))


def reprinted(published: Published) -> Claim:
    """Judge Table 1 itself: whether its limits are those of a t-interval (Eq. 15)."""
    limits = published.limits
    cases = [
        text == str(printed)
        for row, (_, _, *found) in zip(
            np.ndindex(len(limits.environments), len(limits.parameters)),
            limits_printed(published),
            strict=True,
        )
        for text, printed in zip(
            found, (limits.lower[row[0]][row[1]], limits.upper[row[0]][row[1]]), strict=True
        )
    ]
    return Claim.judged(
        "table-1",
        place="Table 1, Eq. 15",
        paper=f"The limits are t-intervals of the mean of {limits.n} subjects at {limits.level:.0%}.",
        cases=cases,
        condition=f"{len(cases) - sum(cases)} limits are left out",
        finding=f"{sum(cases)} of {len(cases)} limits come out to the last printed digit from a mean and a "
        "standard deviation per row.",
        margin=Quantity("limits that agree", sum(cases)),
        numbers=[
            Quantity("limits printed", len(cases)),
            Quantity("half-width in SDs", published.limits.factor),
        ],
        source="percept.inference.t_interval(Moments.from_limits(...))",
    )


def reference_inside(published: Published) -> Claim:
    """Judge whether what was shown lies among what feels like it (Fig. 5)."""
    references = np.array(published.limits.reference, dtype=float)
    found = bias(published.moments, references, level=published.limits.level)
    held = np.asarray(found.holds_reference)
    names = _cells(published)
    half_widths = np.abs(1 - np.asarray(found.ratio)) / (
        (np.asarray(found.upper) - np.asarray(found.lower)) / 2
    )
    farthest = np.unravel_index(half_widths.argmax(), half_widths.shape)
    return Claim.judged(
        "reference-inside",
        place="Section 3.1, Fig. 5",
        paper="The reference runs between the boundaries of what feels like it.",
        cases=held.ravel(),
        condition=f"the reference is that of "
        f"{listed([n for n, ok in zip(names, held.ravel(), strict=True) if ok])}",
        finding=f"{int((~held).sum())} of {held.size} references lie outside their own limits: "
        f"{listed([n for n, ok in zip(names, held.ravel(), strict=True) if not ok])}. What subjects set is "
        "biased, and a band of equal feeling need not hold the reference.",
        margin=Quantity("references outside", int((~held).sum())),
        numbers=[
            Quantity(
                f"farthest, {names[int(np.ravel_multi_index(farthest, held.shape))]}, in half-widths",
                float(half_widths[farthest]),
            ),
        ],
        source="percept.inference.bias(moments, references)",
    )


def users_covered(published: Published) -> Claim:
    """Judge the reading of a 99 % interval of the mean as 99 % of users."""
    n, level = published.limits.n, published.limits.level
    share = _expected_share(n, level)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    return Claim.judged(
        "users-covered",
        place="Section 3.1",
        paper="99 percent of users feel realism while the impedance stays inside the boundary.",
        cases=[share >= level],
        finding=f"A {level:.0%} interval of the mean of {n} subjects holds an expected {share:.1%} of users. "
        f"To hold {level:.0%} of them with {_SHARE_CONFIDENCE:.0%} confidence it must be "
        f"{factor / published.limits.factor:.3g} times as wide.",
        margin=Quantity("expected share of users minus level", share - level, "1"),
        numbers=[
            Quantity("expected share of users", share, "1"),
            Quantity("half-width for the mean, SDs", published.limits.factor),
            Quantity("half-width for the share of users, SDs", factor),
        ],
        source="percept.inference.t_interval(...).expected_share, tolerance_factor(n, level, 0.95)",
    )


def thirty_subjects(published: Published) -> Claim:
    """Judge whether thirty subjects represent everybody."""
    level = published.limits.level
    t = float(t_upper((1 - level) / 2, ENOUGH_SUBJECTS - 1))
    z = float(normal_upper(np.asarray((1 - level) / 2)))
    share = _expected_share(ENOUGH_SUBJECTS, level)
    factor = float(tolerance_factor(ENOUGH_SUBJECTS, level, _SHARE_CONFIDENCE))
    return Claim.judged(
        "thirty-subjects",
        place="Section 3.1",
        paper="Thirty subjects are enough to represent everybody, t being normal by then.",
        cases=[share >= level, published.limits.n >= ENOUGH_SUBJECTS],
        condition="one asks for a normal t and not for a share of users",
        finding=f"With {ENOUGH_SUBJECTS} subjects t is still {t / z - 1:.1%} above its normal limit, and the "
        f"interval of the mean then holds fewer users than with {published.limits.n}: {share:.1%}. More "
        f"subjects narrow it. Limits for {level:.0%} of users take {factor:.4g} SDs at n = "
        f"{ENOUGH_SUBJECTS}, against {z:.4g} if mean and SD were known. The study had {published.limits.n}.",
        margin=Quantity(f"expected share of users at n = {ENOUGH_SUBJECTS} minus level", share - level, "1"),
        numbers=[Quantity("t over its normal limit", t / z), Quantity("subjects", published.limits.n)],
        source="percept plan; percept.inference.tolerance_factor(30, 0.99, 0.95)",
    )


def normal_values(published: Published) -> Claim:
    """Judge a normal model for stiffness and damping, which are positive."""
    moments = published.moments
    mean, sd = np.asarray(moments.mean), np.asarray(moments.sd)
    below = special.ndtr(-mean / sd)
    factor = float(tolerance_factor(published.limits.n, published.limits.level, _SHARE_CONFIDENCE))
    fits = (mean - factor * sd > 0).ravel()
    names = _cells(published)
    worst = int(below.argmax())
    return Claim.judged(
        "normal-values",
        place="Section 3.1, Eq. 15",
        paper="Adjusted stiffness and damping are normally distributed.",
        cases=fits,
        condition=f"nobody looks below zero: {listed([n for n, ok in zip(names, fits, strict=True) if ok])}",
        finding=f"Under a normal law {below.ravel()[worst]:.3g} of users set a negative {names[worst]}, and "
        f"limits for {published.limits.level:.0%} of users are negative for "
        f"{listed([n for n, ok in zip(names, fits, strict=True) if not ok])}. A lognormal law has neither.",
        margin=Quantity(f"users below zero, {names[worst]}", float(below.max()), "1"),
        numbers=[Quantity("largest coefficient of variation", float((sd / mean).max()))],
        source="percept.inference.tolerance_interval(moments, family='normal' or 'lognormal')",
    )


def joint_level(published: Published) -> Claim:
    """Judge limits of k and of b used together as if they held together."""
    level = published.limits.level
    wall = _moments_of(published, 0)
    region = rectangle_region(*wall, kind="mean", level=level)
    wider = rectangle_region(*wall, kind="mean", level=level, joint="bonferroni")
    least, most = region.joint_level
    widening = wider.stiffness.upper - wider.stiffness.estimate
    widening /= region.stiffness.upper - region.stiffness.estimate
    return Claim.judged(
        "joint-level",
        place="Eqs 16, 17",
        paper="A boundary made of the limits of k and of b has their level.",
        cases=[least >= level, level**2 >= level, most >= level],
        condition="the errors of k and b are perfectly dependent",
        finding=f"Two limits at {level:.0%} hold together with {least:.4g} to {most:.4g}, and with "
        f"{level**2:.4g} where independent. Bonferroni’s correction keeps {level:.0%} with limits "
        f"{float(widening):.4g} times as wide.",
        margin=Quantity("joint level, worst case, minus level", least - level, "1"),
        numbers=[Quantity("joint level if independent", level**2, "1")],
        source="percept.inference.rectangle_region(k, b, kind='mean').joint_level",
    )


def published_limits_suffice(published: Published) -> Claim:
    """Judge whether limits alone fix a region of k and b together."""
    spreads = {}
    for row, wall in enumerate(published.walls):
        k, b = _moments_of(published, row)
        uppers = [_upper_of_ellipse(published, k, b, correlation) for correlation in _CORRELATIONS]
        spreads[wall.name] = max(uppers) / min(uppers) - 1
    worst = max(spreads, key=spreads.__getitem__)
    return Claim.judged(
        "limits-suffice",
        place="Table 1, section 3.1",
        paper="The published limits delineate the boundaries.",
        cases=[_limits_come_back(published), spreads[worst] < 5 * 10.0**-_DIGITS_PRINTED],
        condition="k and b are taken one at a time: their correlation was not published",
        finding=f"The joint {published.limits.level:.0%} region of k and b depends on a correlation nobody "
        f"printed: from {_CORRELATIONS[0]:g} to {_CORRELATIONS[-1]:g} the upper |Z_e| of {worst} at "
        f"{LOOKED_AT:g} rad/s moves by {spreads[worst]:.1%}. percept refuses joint regions of published "
        f"limits.",
        margin=Quantity("upper |Z_e|, largest change with the correlation", spreads[worst], "1"),
        source="percept.haptics.magnitude_envelope_ellipse; percept.inference.ellipse_region",
    )


def _limits_come_back(published: Published) -> bool:
    """Say whether each parameter's limits, alone, lead to a mean and SD that lead back to them."""
    limits = published.limits
    printed = [
        tuple(str(part[row][column]) for part in (limits.lower, limits.upper))
        for row in range(len(limits.environments))
        for column in range(len(limits.parameters))
    ]
    return [(lower, upper) for *_, lower, upper in limits_printed(published)] == printed


def _upper_of_ellipse(published: Published, k: Moments, b: Moments, correlation: float) -> float:
    """Return the largest |Z_e| over Hotelling's region of the mean, two parameters, N·s/m."""
    n, level = published.limits.n, published.limits.level
    radius = math.sqrt((n - 1) * math.expm1(-2.0 * math.log1p(-level) / (n - 2)) / n)
    sd = np.array([k.sd, b.sd], dtype=float)
    covariance = np.outer(sd, sd) * np.array([[1.0, correlation], [correlation, 1.0]])
    _, upper = magnitude_envelope_ellipse(
        LOOKED_AT, Device(0.0, 0.0), (float(k.mean), float(b.mean)), covariance, radius, published.period
    )
    return float(upper)


def _expected_share(n: int, level: float) -> float:
    return float(np.asarray(t_interval(Moments(0.0, 1.0, n), level=level).expected_share))


def _cells(published: Published) -> list[str]:
    return [f"{parameter} of {wall.name}" for wall in published.walls for parameter in "kb"]


def _moments_of(published: Published, row: int) -> tuple[Moments, Moments]:
    """Return the moments of k and of b of one environment."""
    mean, sd = np.asarray(published.moments.mean), np.asarray(published.moments.sd)
    k, b = (Moments(float(mean[row, p]), float(sd[row, p]), published.limits.n) for p in (0, 1))
    return k, b
