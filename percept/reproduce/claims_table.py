"""Claims on Table 1, and on what the text says of users."""

from __future__ import annotations

import math
from decimal import Decimal
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.haptics import Device
from percept.haptics.ellipse import magnitude_envelope_ellipse
from percept.inference import Moments, bias, t_interval, tolerance_factor
from percept.reproduce.published import (
    ENOUGH_SUBJECTS,
    LOOKED_AT,
    Judgement,
    Published,
    Quantity,
    judged,
    listed,
    unjudged,
)
from percept.reproduce.squares import VARIABLE, crossings, felt_square

_SHARE_CONFIDENCE = 0.95
_CORRELATIONS = (-0.9, 0.0, 0.9)
_DIGITS_PRINTED = 4  # of most limits of Table 1
# Where thresholds of vibration are usually measured, Hz: the fast and slow mechanoreceptors of the hand.
_TOUCH_HERTZ = (40.0, 250.0)
_HEAVIEST = 100.0  # kg; no m_e above it is looked at


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


def table_1(published: Published) -> Judgement:
    """Say why nobody can judge whether Table 1 holds t-intervals (Eq. 15)."""
    limits = published.limits
    printed = np.array([limits.lower, limits.upper]).astype(str).reshape(2, -1).T
    agree = printed == [limit[2:] for limit in limits_printed(published)]
    return unjudged(
        needs="each subject’s adjusted k and b, or their means and standard deviations",
        finding=f"{agree.sum()} of {agree.size} limits come out to the last printed digit from a mean and a "
        "standard deviation per row. Two limits always fix such a pair, so limits made at random come out "
        "too.",
        numbers=[
            Quantity("limits that agree", int(agree.sum())),
            Quantity("limits printed", agree.size),
            Quantity("half-width in SDs", limits.factor),
        ],
    )


def reference_inside(published: Published) -> Judgement:
    """Judge whether what was shown lies among what feels like it (Fig. 5)."""
    references = np.array(published.limits.reference, dtype=float)
    found = bias(published.moments, references, level=published.limits.level)
    held = ((np.asarray(found.lower) <= 1.0) & (np.asarray(found.upper) >= 1.0)).ravel()
    inside, outside = _cells_by(published, held)
    return judged(
        cases=held,
        condition=f"the dashed line shows {listed(inside)}",
        finding=f"The dashed line is the reference. {len(outside)} of {held.size} references lie outside "
        f"their own limits: {listed(outside)}. What subjects set is biased, and a band of equal feeling need "
        "not hold the reference.",
        margin=Quantity("references outside", len(outside)),
    )


def users_covered(published: Published) -> Judgement:
    """Judge the reading of a 99 % interval of the mean as 99 % of users."""
    n, level, own = published.limits.n, published.limits.level, published.limits.factor
    share = _expected_share(n, level)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    return judged(
        cases=[share >= level],
        finding=f"A {level:.0%} interval of the mean of {n} subjects holds an expected {share:.1%} of users. "
        f"To hold {level:.0%} of them with {_SHARE_CONFIDENCE:.0%} confidence it must be {factor / own:.3g} "
        "times as wide.",
        margin=Quantity("expected share of users minus level", share - level, "1"),
        numbers=[
            Quantity("expected share of users", share, "1"),
            Quantity("half-width for the mean, SDs", own),
            Quantity("half-width for the share of users, SDs", factor),
        ],
    )


def thirty_subjects(published: Published) -> Judgement:
    """Judge whether thirty subjects represent everybody where the data are normal."""
    level = published.limits.level
    t = -float(special.stdtrit(ENOUGH_SUBJECTS - 1, (1 - level) / 2))
    z = -float(special.ndtri((1 - level) / 2))
    share = _expected_share(ENOUGH_SUBJECTS, level)
    factor = float(tolerance_factor(ENOUGH_SUBJECTS, level, _SHARE_CONFIDENCE))
    return judged(
        cases=[share >= level, published.limits.n >= ENOUGH_SUBJECTS],
        condition="it means the law of t and no share of the population",
        finding=f"Take the data as normal. With {ENOUGH_SUBJECTS} subjects t is {t / z - 1:.1%} above its "
        f"normal limit. The interval of the mean then holds {share:.1%} of users, fewer than with "
        f"{published.limits.n}: more subjects narrow it. Limits for {level:.0%} of users take {factor:.4g} "
        f"SDs at n = {ENOUGH_SUBJECTS}, against {z:.4g} with mean and SD known. The study had "
        f"{published.limits.n}.",
        margin=Quantity(f"expected share of users at n = {ENOUGH_SUBJECTS} minus level", share - level, "1"),
        numbers=[Quantity("t over its normal limit", t / z), Quantity("subjects", published.limits.n)],
    )


def normal_values(published: Published) -> Judgement:
    """Judge the premise of a normal law for stiffness and damping, which are positive."""
    level = published.limits.level
    mean, sd = (np.ravel(part) for part in (published.moments.mean, published.moments.sd))
    below = special.ndtr(-mean / sd)
    fits = mean - float(tolerance_factor(published.limits.n, level, _SHARE_CONFIDENCE)) * sd > 0
    positive, negative = _cells_by(published, fits)
    worst = _cells(published)[int(below.argmax())]
    return judged(
        cases=fits,
        condition=f"one means {listed(positive)}, where {level:.0%} of users stay above zero",
        finding="The paper does not say that the data are normal, but its Eq. 15 takes them so. Under a "
        f"normal law {below.max():.1%} of users set a negative {worst}. Limits for {level:.0%} of users are "
        f"negative for {listed(negative)}. A lognormal law has neither.",
        margin=Quantity(f"users below zero, {worst}", float(below.max()), "1"),
    )


def joint_level(published: Published) -> Judgement:
    """Judge limits of k and of b used together as if they held together."""
    level = published.limits.level
    # Bonferroni's inequality, and limits that hold or fail together.
    least, most = 1.0 - 2.0 * (1.0 - level), level
    stiffness, _ = _moments_of(published, 0)
    alone = t_interval(stiffness, level=level)
    wider = t_interval(stiffness, level=level, joint="bonferroni")
    widening = (wider.upper - wider.estimate) / (alone.upper - alone.estimate)
    return judged(
        cases=[least >= level, level**2 >= level, most >= level],
        condition="the errors of k and b are perfectly dependent",
        finding=f"Two limits at {level:.0%} hold together with probability {least:.4g} to {most:.4g}, "
        f"{level**2:.4g} if independent. Bonferroni’s correction keeps {level:.0%} with limits "
        f"{float(widening):.4g} times as wide.",
        margin=Quantity("joint level, worst case, minus level", least - level, "1"),
        numbers=[Quantity("joint level if independent", level**2, "1")],
    )


def limits_suffice(published: Published) -> Judgement:
    """Judge whether limits alone fix a boundary of k and b together."""
    spreads = {}
    for row, wall in enumerate(published.walls):
        k, b = _moments_of(published, row)
        uppers = [_upper_of_ellipse(published, k, b, correlation) for correlation in _CORRELATIONS]
        spreads[wall.name] = max(uppers) / min(uppers) - 1
    worst = max(spreads, key=spreads.__getitem__)
    return judged(
        # Corners of limits can always be drawn; a joint region only where the correlation does not matter.
        cases=[True, spreads[worst] < 5 * 10.0**-_DIGITS_PRINTED],
        condition="k and b are taken one at a time: their correlation was not published",
        finding=f"The joint {published.limits.level:.0%} region of k and b depends on a correlation nobody "
        f"printed. From {_CORRELATIONS[0]:g} to {_CORRELATIONS[-1]:g} it moves the upper |Z_e| of {worst} at "
        f"{LOOKED_AT:g} rad/s by {spreads[worst]:.1%}. percept refuses joint regions of published limits.",
        margin=Quantity("upper |Z_e|, largest change with the correlation", spreads[worst], "1"),
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


def mass_left_out(published: Published) -> Judgement:
    """Judge whether Fig. 7d follows from k_e and b_e, the mass m_e being left out."""
    wall, _ = published.drawn[1]
    device, period = published.device, published.period
    rate = 2 / period * math.tan(LOOKED_AT * period / 2)
    lower, upper = zip(wall.stiffness, wall.damping, strict=True)
    shown = [(wall.k, wall.b, None), (wall.k, wall.b, published.tuned), (*lower, None), (*upper, None)]
    squares = [
        felt_square(device, k, b, period, coupling=coupling, rate=rate, mass=VARIABLE)
        for k, b, coupling in shown
    ]

    def kept(mass: float) -> bool:
        direct, coupled, *ends = (float(one.over(mass) / one.under(mass)) for one in squares)
        return min(ends) <= coupled < direct <= max(ends)

    edges = np.concatenate([[0.0], crossings(squares, 0.0, _HEAVIEST), [_HEAVIEST]])
    until = next((low for low, high in pairwise(edges.tolist()) if not kept((low + high) / 2)), _HEAVIEST)
    return judged(
        cases=[until > 0, until == _HEAVIEST],
        condition=f"m_e is at most {until:.3g} kg; percept takes 0",
        finding=f"Eq. 7 has a mass m_e, and the paper gives none. What Fig. 7d shows of {wall.name} stays "
        f"true at {LOOKED_AT:g} rad/s for an m_e up to {until:.4g} kg with the scene’s device.",
        margin=Quantity("largest m_e that keeps Fig. 7d", until, "kg"),
    )


def perceivable_range(published: Published) -> Judgement:
    """Judge the statement that forces are felt below 100 rad/s only."""
    _, top = published.span
    felt = [2 * np.pi * hertz for hertz in _TOUCH_HERTZ]
    pairs = zip(_TOUCH_HERTZ, felt, strict=True)
    thresholds = " and ".join(f"{hertz:g} Hz ({omega:.4g} rad/s)" for hertz, omega in pairs)
    return judged(
        cases=[omega <= top for omega in felt],
        condition="the vibration is slow",
        finding=f"Thresholds of touch are measured at {thresholds}, beyond {top:g} rad/s. The range is a "
        "setting; this page uses the paper’s.",
        margin=Quantity("touch beyond the range, lowest", min(felt) / top),
    )
