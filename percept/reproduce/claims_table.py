"""Claims on Table 1 and on what the text prints, leaves out, or says of perception."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.haptics import Coupling, Device, Environment, environment_impedance, magnitude_envelope_ellipse
from percept.inference import Moments, bias, t_interval, tolerance_factor
from percept.reproduce.published import (
    ENOUGH_SUBJECTS,
    LOOKED_AT,
    TEXT_REFERENCES,
    Claim,
    Published,
    Quantity,
    listed,
)

_SHARE_CONFIDENCE = 0.95
_CORRELATIONS = (-0.9, 0.0, 0.9)
_DIGITS_PRINTED = 4  # of most limits of Table 1
# Where thresholds of vibration are usually measured, Hz: the fast and slow mechanoreceptors of the hand.
_TOUCH_HERTZ = (40.0, 250.0)
_SAME = 1e-3
_MASSES = (0.0, *np.geomspace(1e-4, 100.0, 121))


def limits_printed(published: Published) -> list[tuple[str, str, str, str]]:
    """Return Table 1 as percept prints it: name, parameter, lower and upper limit as text."""
    limits = published.limits
    interval = t_interval(published.moments, level=limits.level)
    lower, upper = np.asarray(interval.lower), np.asarray(interval.upper)
    return [
        (
            limits.environments[i],
            limits.parameters[p],
            str(Decimal(float(lower[i, p])).quantize(limits.lower[i][p])),
            str(Decimal(float(upper[i, p])).quantize(limits.upper[i][p])),
        )
        for i, p in np.ndindex(lower.shape)
    ]


def _limits_agree(published: Published) -> list[bool]:
    """Say of each limit whether percept prints it as the paper does, from a mean and an SD per row."""
    limits = published.limits
    printed = [
        str(part[i][p])
        for i, p in np.ndindex(len(limits.environments), len(limits.parameters))
        for part in (limits.lower, limits.upper)
    ]
    found = [text for *_, lower, upper in limits_printed(published) for text in (lower, upper)]
    return [one == other for one, other in zip(found, printed, strict=True)]


def reprinted(published: Published) -> Claim:
    """Judge Table 1 itself: whether its limits are those of a t-interval (Eq. 15)."""
    limits, cases = published.limits, _limits_agree(published)
    return Claim.judged(
        "table-1",
        place="Table 1, Eq. 15",
        paper=f"The limits are t-intervals of the mean of {limits.n} subjects at {limits.level:.0%}.",
        cases=cases,
        condition=f"{len(cases) - sum(cases)} limits are left out",
        finding=f"{sum(cases)} of {len(cases)} limits come out to the last printed digit from a mean and a "
        "standard deviation per row.",
        margin=Quantity("limits that agree", sum(cases)),
        numbers=[Quantity("limits printed", len(cases)), Quantity("half-width in SDs", limits.factor)],
        source="percept.inference.t_interval(Moments.from_limits(...))",
    )


def reference_inside(published: Published) -> Claim:
    """Judge whether what was shown lies among what feels like it (Fig. 5)."""
    references = np.array(published.limits.reference, dtype=float)
    found = bias(published.moments, references, level=published.limits.level)
    held = ((np.asarray(found.lower) <= 1.0) & (np.asarray(found.upper) >= 1.0)).ravel()
    inside, outside = _cells_by(published, held)
    width = (np.asarray(found.upper) - np.asarray(found.lower)) / 2
    half_widths = (np.abs(1 - np.asarray(found.estimate)) / width).ravel()
    farthest = int(half_widths.argmax())
    return Claim.judged(
        "reference-inside",
        place="Section 3.1, Fig. 5",
        paper="The reference runs between the boundaries of what feels like it.",
        cases=held,
        condition=f"the reference is that of {listed(inside)}",
        finding=f"{len(outside)} of {held.size} references lie outside their own limits: {listed(outside)}. "
        "What subjects set is biased, and a band of equal feeling need not hold the reference.",
        margin=Quantity("references outside", len(outside)),
        numbers=[
            Quantity(f"farthest, {_cells(published)[farthest]}, in half-widths", float(half_widths[farthest]))
        ],
        source="percept.inference.bias(moments, references)",
    )


def users_covered(published: Published) -> Claim:
    """Judge the reading of a 99 % interval of the mean as 99 % of users."""
    n, level, own = published.limits.n, published.limits.level, published.limits.factor
    share = _expected_share(n, level)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    return Claim.judged(
        "users-covered",
        place="Section 3.1",
        paper="99 percent of users feel realism while the impedance stays inside the boundary.",
        cases=[share >= level],
        finding=f"A {level:.0%} interval of the mean of {n} subjects holds an expected {share:.1%} of users. "
        f"To hold {level:.0%} of them with {_SHARE_CONFIDENCE:.0%} confidence it must be "
        f"{factor / own:.3g} times as wide.",
        margin=Quantity("expected share of users minus level", share - level, "1"),
        numbers=[
            Quantity("expected share of users", share, "1"),
            Quantity("half-width for the mean, SDs", own),
            Quantity("half-width for the share of users, SDs", factor),
        ],
        source="percept.inference.t_interval(...).expected_share, tolerance_factor(n, level, 0.95)",
    )


def thirty_subjects(published: Published) -> Claim:
    """Judge whether thirty subjects represent everybody."""
    level = published.limits.level
    t = -float(special.stdtrit(ENOUGH_SUBJECTS - 1, (1 - level) / 2))
    z = -float(special.ndtri((1 - level) / 2))
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
    level = published.limits.level
    mean, sd = (np.ravel(part) for part in (published.moments.mean, published.moments.sd))
    below = special.ndtr(-mean / sd)
    fits = mean - float(tolerance_factor(published.limits.n, level, _SHARE_CONFIDENCE)) * sd > 0
    positive, negative = _cells_by(published, fits)
    worst = _cells(published)[int(below.argmax())]
    return Claim.judged(
        "normal-values",
        place="Section 3.1, Eq. 15",
        paper="Adjusted stiffness and damping are normally distributed.",
        cases=fits,
        condition=f"nobody looks below zero: {listed(positive)}",
        finding=f"Under a normal law {below.max():.3g} of users set a negative {worst}, and limits for "
        f"{level:.0%} of users are negative for {listed(negative)}. A lognormal law has neither.",
        margin=Quantity(f"users below zero, {worst}", float(below.max()), "1"),
        numbers=[Quantity("largest coefficient of variation", float((sd / mean).max()))],
        source="percept.inference.tolerance_interval(moments, family='normal' or 'lognormal')",
    )


def joint_level(published: Published) -> Claim:
    """Judge limits of k and of b used together as if they held together."""
    level = published.limits.level
    # Bonferroni's inequality, and limits that hold or fail together.
    least, most = 1.0 - 2.0 * (1.0 - level), level
    stiffness, _ = _moments_of(published, 0)
    alone = t_interval(stiffness, level=level)
    wider = t_interval(stiffness, level=level, joint="bonferroni")
    widening = (wider.upper - wider.estimate) / (alone.upper - alone.estimate)
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
        source="percept.inference.t_interval(k, joint='marginal' or 'bonferroni')",
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
        cases=[all(_limits_agree(published)), spreads[worst] < 5 * 10.0**-_DIGITS_PRINTED],
        condition="k and b are taken one at a time: their correlation was not published",
        finding=f"The joint {published.limits.level:.0%} region of k and b depends on a correlation nobody "
        f"printed: from {_CORRELATIONS[0]:g} to {_CORRELATIONS[-1]:g} the upper |Z_e| of {worst} at "
        f"{LOOKED_AT:g} rad/s moves by {spreads[worst]:.1%}. percept refuses joint regions of published "
        f"limits.",
        margin=Quantity("upper |Z_e|, largest change with the correlation", spreads[worst], "1"),
        source="percept.haptics.magnitude_envelope_ellipse; percept.inference.regions.ellipse_region",
    )


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


def _cells_by(published: Published, true: NDArray[np.bool_]) -> tuple[list[str], list[str]]:
    """Return the cells of which something is true, and the others."""
    pairs = list(zip(_cells(published), true, strict=True))
    return [name for name, one in pairs if one], [name for name, one in pairs if not one]


def _moments_of(published: Published, row: int) -> tuple[Moments, Moments]:
    """Return the moments of k and of b of one environment."""
    mean, sd = np.asarray(published.moments.mean), np.asarray(published.moments.sd)
    k, b = (Moments(float(mean[row, p]), float(sd[row, p]), published.limits.n) for p in (0, 1))
    return k, b


def environments_in_text(published: Published) -> Claim:
    """Judge whether section 4 lists the environments of Table 1."""
    table = {(wall.k, wall.b) for wall in published.walls}
    text = set(TEXT_REFERENCES)
    return Claim.judged(
        "environments-in-text",
        place="Section 4",
        paper="The text lists five cases of the reference environment.",
        cases=[wall in text for wall in sorted(table)],
        condition="the case printed twice is replaced by the one Table 1 has instead",
        finding=f"The text prints {len(text)} different environments, Table 1 has {len(table)}; "
        f"{len(table - text)} of them is not in the text. Table 1’s are used.",
        margin=Quantity("environments the text lacks", len(table - text)),
        numbers=[Quantity("different environments in the text", len(text))],
        source="percept.reproduce.published.TEXT_REFERENCES; datasets/hbfd_table1.csv",
    )


def substitution(published: Published) -> Claim:
    """Judge the substitution of Tustin's method as Eqs 5 and 7 print it, where Fig. 7 looks closely."""
    period = published.period
    z = np.exp(1j * LOOKED_AT * period)
    printed = complex(2 / period * (z - 1 / z + 1))
    meant = complex(2 / period * (z - 1) / (z + 1))
    true = 1j * (2 / period) * np.tan(LOOKED_AT * period / 2)
    return Claim.judged(
        "substitution",
        place="Eqs 5, 7",
        paper="Tustin’s method replaces s by (2/T)(z − 1/z + 1).",
        cases=[abs(printed - true) <= _SAME * abs(true), abs(meant - true) <= _SAME * abs(true)],
        condition="it is read as (2/T)(z − 1)/(z + 1), as Eq. 12 prints it",
        finding=f"At {LOOKED_AT:g} rad/s the printed form gives |s| = {abs(printed):.4g} 1/s, Eq. 12’s "
        f"{abs(meant):.6g}, as it should be.",
        margin=Quantity("printed |s| over the true one", abs(printed) / abs(true)),
        source="percept.haptics.environment_impedance (Eq. 12's form throughout)",
    )


def felt_and_rendered(published: Published) -> Claim:
    """Judge the conclusion's Z_e in the place of Z_h."""
    ratios = {}
    for wall in published.walls:
        rendered = np.abs(environment_impedance(LOOKED_AT, wall.environment, published.period))
        ratios[wall.name] = float(abs(published.felt(LOOKED_AT, wall.environment) / rendered - 1))
    worst = max(ratios, key=ratios.__getitem__)
    return Claim.judged(
        "felt-and-rendered",
        place="Section 6",
        paper="The boundaries are of the perceived impedance, written Z_e.",
        cases=[ratio <= _SAME for ratio in ratios.values()],
        condition="the environment outweighs the device",
        finding=f"Z_h is meant. With the scene’s device |Z_h| differs from |Z_e| at {LOOKED_AT:g} rad/s by "
        f"{min(ratios.values()):.2%} to {ratios[worst]:.1%} ({worst}).",
        margin=Quantity("largest difference of |Z_h| from |Z_e|", ratios[worst], "1"),
        source="percept.haptics.perceived_impedance, environment_impedance",
    )


def mass_left_out(published: Published) -> Claim:
    """Judge whether the figures follow from the numbers given, the mass m_e being left out."""
    wall, _ = published.drawn[1]

    def felt(k: float, b: float, mass: float, coupling: Coupling | None = None) -> float:
        return float(published.felt(LOOKED_AT, Environment(k, b, mass), coupling=coupling))

    kept = []
    for mass in _MASSES:
        low, high = sorted(felt(k, b, mass) for k, b in zip(wall.stiffness, wall.damping, strict=True))
        kept.append(low <= felt(wall.k, wall.b, mass, published.tuned) < felt(wall.k, wall.b, mass) <= high)
    until = _MASSES[max(kept.index(False) - 1, 0)] if False in kept else _MASSES[-1]
    return Claim.judged(
        "mass-left-out",
        place="Eq. 7, section 4",
        paper="The figures follow from the numbers given; no mass m_e is.",
        cases=kept,
        condition=f"m_e is at most about {until:.3g} kg; percept takes 0",
        finding=f"What Fig. 7d shows of {wall.name} stays true at {LOOKED_AT:g} rad/s for an m_e up to about "
        f"{until:.3g} kg with the scene’s device.",
        margin=Quantity("largest m_e tried that keeps Fig. 7d", until, "kg"),
        source="percept.haptics.perceived_impedance(omega, device, Environment(k, b, mass), period)",
    )


def perceivable_range(published: Published) -> Claim:
    """Judge the statement that forces are felt below 100 rad/s only."""
    top = published.scene.frequency.upper
    felt = [2 * np.pi * hertz for hertz in _TOUCH_HERTZ]
    pairs = zip(_TOUCH_HERTZ, felt, strict=True)
    thresholds = " and ".join(f"{hertz:g} Hz, {omega:.4g} rad/s" for hertz, omega in pairs)
    return Claim.judged(
        "perceivable-range",
        place="Section 5",
        paper=f"People perceive force feedback below {top:g} rad/s.",
        cases=[omega <= top for omega in felt],
        condition="the vibration is slow",
        finding=f"Thresholds of touch are measured at {thresholds}, beyond {top:g} rad/s. The range is "
        "a setting; the paper’s is used here.",
        margin=Quantity("touch beyond the range, lowest", min(felt) / top),
        source="[frequency] of the scene",
    )
