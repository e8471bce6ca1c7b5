"""Claims on Table 1, and on what the text says of users."""

from __future__ import annotations

import math
from decimal import Decimal
from itertools import pairwise

import numpy as np
from scipy import special

from percept.haptics import Device
from percept.haptics.envelope import magnitude_envelope_ellipse
from percept.inference import Moments, bias, t_interval, tolerance_factor
from percept.reproduce.devices import direct_inside, share_true
from percept.reproduce.published import LOOKED_AT, Evidence, Published
from percept.reproduce.squares import VARIABLE, crossings, felt_square

_SHARE_CONFIDENCE = 0.95
_ENOUGH_SUBJECTS = 30  # Section 3.1: this number of subjects is said to represent everybody
_CORRELATIONS = (-0.9, 0.0, 0.9)
# Where thresholds of vibration are usually measured, Hz: the fast and slow mechanoreceptors of the
# hand.
_TOUCH_HERTZ = (40.0, 250.0)
_HEAVIEST = 100.0  # kg; no m_e above it is looked at


def limits_printed(published: Published) -> list[tuple[str, str, str, str]]:
    """Return Table 1 as percept prints it: name, parameter, lower and upper limit as text."""
    limits = published.limits
    interval = t_interval(published.limits.moments, level=limits.level)
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


def table_1(published: Published) -> Evidence:
    """Say why nobody can judge whether Table 1 holds t-intervals (Eq. 15)."""
    limits = published.limits
    printed = np.array([limits.lower, limits.upper]).astype(str).reshape(2, -1).T
    agree = printed == [limit[2:] for limit in limits_printed(published)]
    return {"agree": int(agree.sum()), "printed": agree.size, "factor": limits.factor}


def reference_inside(published: Published) -> Evidence:
    """Judge whether the reference's curve runs between the boundaries (Fig. 5)."""
    references = np.array(published.limits.reference, dtype=float)
    found = bias(published.limits.moments, references, level=published.limits.level)
    held = ((np.asarray(found.lower) <= 1.0) & (np.asarray(found.upper) >= 1.0)).ravel()
    outside = np.array(_cells(published))[~held].tolist()
    shares = {wall.name: share_true(published, wall, direct_inside) for wall in published.walls}
    return {
        "cases": [case for part in shares.values() for case in (part > 0, part == 1.0)],
        "shares": shares,
        "least": min(shares.values()),
        "outside": outside,
        "lost": len(outside),
        "of": held.size,
    }


def users_covered(published: Published) -> Evidence:
    """Judge the reading of a 99 % interval of the mean as 99 % of users."""
    n, level, own = published.limits.n, published.limits.level, published.limits.factor
    share = _expected_share(n, level)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    return {
        "cases": [share >= level],
        "confidence": _SHARE_CONFIDENCE, "less": share - level, "share": share, "own": own,
        "factor": factor, "ratio": factor / own,
    }  # fmt: skip


def thirty_subjects(published: Published) -> Evidence:
    """Judge whether thirty subjects represent everybody where the data are normal."""
    n, level = published.limits.n, published.limits.level
    t = -float(special.stdtrit(_ENOUGH_SUBJECTS - 1, (1 - level) / 2))
    z = -float(special.ndtri((1 - level) / 2))
    share = _expected_share(_ENOUGH_SUBJECTS, level)
    return {
        "cases": [share >= level, n >= _ENOUGH_SUBJECTS],
        "z": z, "over": t / z, "above": t / z - 1, "share": share, "less": share - level, "n": n,
        "factor": float(tolerance_factor(_ENOUGH_SUBJECTS, level, _SHARE_CONFIDENCE)),
    }  # fmt: skip


def normal_values(published: Published) -> Evidence:
    """Say why nobody can judge whether the data are normal: limits alone fit any such law."""
    mean = np.ravel(published.limits.moments.mean)
    sd = np.ravel(published.limits.moments.sd)
    n, level = published.limits.n, published.limits.level
    names = np.array(_cells(published))
    below = special.ndtr(-mean / sd)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    negative = mean - factor * sd <= 0
    return {
        "negative": names[negative].tolist(),
        "below": float(below.max()),
        "worst": names[below.argmax()],
        "unseen": float((1 - below.max()) ** n),
    }


def joint_level(published: Published) -> Evidence:
    """Judge limits of k and of b used together as if they held together."""
    level = published.limits.level
    # Bonferroni's inequality, and limits that hold or fail together.
    least, most = 1.0 - 2.0 * (1.0 - level), level
    stiffness, _ = _moments_of(published, 0)
    alone = t_interval(stiffness, level=level)
    wider = t_interval(stiffness, level=level, joint="bonferroni")
    return {
        # The worst dependence, none, the best one, and either parameter by itself.
        "cases": [least >= level, level**2 >= level, most >= level, alone.level >= level],
        "least": least, "most": most, "independent": level**2, "less": least - level,
        "widening": float((wider.upper - wider.estimate) / (alone.upper - alone.estimate)),
    }  # fmt: skip


def limits_suffice(published: Published) -> Evidence:
    """Say why nobody can judge whether limits alone bound k and b together."""
    spreads = {}
    for row, wall in enumerate(published.walls):
        k, b = _moments_of(published, row)
        uppers = [_upper_of_ellipse(published, k, b, correlation) for correlation in _CORRELATIONS]
        spreads[wall.name] = max(uppers) / min(uppers) - 1
    worst = max(spreads, key=spreads.__getitem__)
    return {
        "low": _CORRELATIONS[0], "high": _CORRELATIONS[-1], "worst": worst, "spread": spreads[worst],
    }  # fmt: skip


def _upper_of_ellipse(published: Published, k: Moments, b: Moments, correlation: float) -> float:
    """Return the largest |Z_e| over Hotelling's region of the mean, two parameters, N·s/m."""
    n, level = published.limits.n, published.limits.level
    radius = math.sqrt((n - 1) * math.expm1(-2.0 * math.log1p(-level) / (n - 2)) / n)
    sd = np.array([k.sd, b.sd], dtype=float)
    covariance = np.outer(sd, sd) * np.array([[1.0, correlation], [correlation, 1.0]])
    _, upper = magnitude_envelope_ellipse(
        LOOKED_AT,
        Device(0.0, 0.0),
        (float(k.mean), float(b.mean)),
        covariance,
        radius,
        published.period,
    )
    return float(upper)


def _expected_share(n: int, level: float) -> float:
    return float(np.asarray(t_interval(Moments(0.0, 1.0, n), level=level).expected_share))


def _cells(published: Published) -> list[str]:
    return [f"{parameter} of {wall.name}" for wall in published.walls for parameter in "kb"]


def _moments_of(published: Published, row: int) -> tuple[Moments, Moments]:
    """Return the moments of k and of b of one environment."""
    mean, sd = np.asarray(published.limits.moments.mean), np.asarray(published.limits.moments.sd)
    k, b = (Moments(float(mean[row, p]), float(sd[row, p]), published.limits.n) for p in (0, 1))
    return k, b


def mass_left_out(published: Published) -> Evidence:
    """Judge whether Fig. 7d follows from k_e and b_e, the mass m_e being left out."""
    wall, _ = published.drawn[1]
    device, period = published.device, published.period
    rate = 2 / period * math.tan(LOOKED_AT * period / 2)
    lower, upper = zip(wall.stiffness, wall.damping, strict=True)
    shown = [
        (wall.k, wall.b, None),
        (wall.k, wall.b, published.tuned),
        (*lower, None),
        (*upper, None),
    ]
    squares = [
        felt_square(device, k, b, period, coupling=coupling, rate=rate, mass=VARIABLE)
        for k, b, coupling in shown
    ]

    def kept(mass: float) -> bool:
        direct, coupled, *ends = (float(one.over(mass) / one.under(mass)) for one in squares)
        return min(ends) <= coupled < direct <= max(ends)

    edges = np.concatenate([[0.0], crossings(squares, 0.0, _HEAVIEST), [_HEAVIEST]])
    until = next(
        (low for low, high in pairwise(edges.tolist()) if not kept((low + high) / 2)), _HEAVIEST
    )
    return {"cases": [until > 0, until == _HEAVIEST], "wall": wall, "until": until}


def perceivable_range(published: Published) -> Evidence:
    """Judge the statement that forces are felt below 100 rad/s only."""
    _, top = published.span
    felt = {hertz: 2 * np.pi * hertz for hertz in _TOUCH_HERTZ}
    thresholds = [f"{hertz:g} Hz ({omega:.4g} rad/s)" for hertz, omega in felt.items()]
    lowest = min(felt.values()) / top
    return {"cases": [x <= top for x in felt.values()], "thresholds": thresholds, "lowest": lowest}
