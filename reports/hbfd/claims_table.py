"""Claims on Table 1, and on what the text says of users."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
from scipy import special

from percept.haptics import Coupling, Environment
from percept.inference import Moments, t_interval, tolerance_factor
from reports.hbfd.devices import BoolArray, direct_inside, largest, share_true
from reports.hbfd.published import LOOKED_AT, Array, Evidence, Published, evidence

_SHARE_CONFIDENCE = 0.95
_ENOUGH_SUBJECTS = 30  # Section 3.1: this number of subjects is said to represent everybody
# Where thresholds of vibration are usually measured, Hz: the fast and slow mechanoreceptors of the
# hand.
_TOUCH_HERTZ = (40.0, 250.0)
_HEAVIEST = 100.0  # kg; no m_e above it is looked at
_MASSES = 1001  # Tried up to there


def limits_printed(published: Published) -> list[list[str]]:
    """Return rows of Table 1: names, reference, both limits as printed, and as percept prints them.

    percept's have as many digits as the paper's.
    """
    limits = published.limits
    interval = t_interval(limits.moments, level=limits.level)
    rows = []
    for i, environment in enumerate(limits.environments):
        for p, parameter in enumerate(limits.parameters):
            printed = [limits.lower[i][p], limits.upper[i][p]]
            ends = [np.asarray(interval.lower)[i, p], np.asarray(interval.upper)[i, p]]
            pairs = zip(ends, printed, strict=True)
            ours = [Decimal(float(end)).quantize(limit) for end, limit in pairs]
            numbers = [limits.reference[i][p], *printed, *ours]
            rows.append([environment, parameter, *map(str, numbers)])
    return rows


def table_1(published: Published) -> Evidence:
    """Say why nobody can judge whether Table 1 holds t-intervals (Eq. 15)."""
    limits = published.limits
    rows = limits_printed(published)
    agree = sum((lower == low) + (upper == high) for *_, low, high, lower, upper in rows)
    return evidence(None, agree=agree, printed=2 * len(rows), factor=limits.factor)


def reference_inside(published: Published) -> Evidence:
    """Judge whether the reference's curve runs between the boundaries (Fig. 5)."""
    references = np.array(published.limits.reference, dtype=float)
    mean = t_interval(published.limits.moments, level=published.limits.level)
    below = mean.upper < references
    above = mean.lower > references
    outside_limits = below | above
    outside = _names(published)[outside_limits.ravel()].tolist()
    shares = {}
    cases = []
    for wall in published.walls:
        fraction = share_true(published, wall, direct_inside)
        shares[wall.name] = fraction
        cases += [fraction > 0, fraction == 1.0]
    return evidence(
        cases,
        shares=shares,
        least=min(shares.values()),
        outside=outside,
        lost=len(outside),
        of=outside_limits.size,
    )


def users_covered(published: Published) -> Evidence:
    """Judge the reading of a 99 % interval of the mean as 99 % of users."""
    n = published.limits.n
    level = published.limits.level
    mean_factor = published.limits.factor
    share = _expected_share(n, level)
    factor = float(tolerance_factor(n, level, _SHARE_CONFIDENCE))
    return evidence(
        [share >= level],
        confidence=_SHARE_CONFIDENCE,
        less=share - level,
        share=share,
        mean_factor=mean_factor,
        factor=factor,
        ratio=factor / mean_factor,
    )


def thirty_subjects(published: Published) -> Evidence:
    """Judge whether thirty subjects represent everybody where the data are normal."""
    n = published.limits.n
    level = published.limits.level
    tail = (1 - level) / 2
    t = -float(special.stdtrit(_ENOUGH_SUBJECTS - 1, tail))
    z = -float(special.ndtri(tail))
    share = _expected_share(_ENOUGH_SUBJECTS, level)
    return evidence(
        [share >= level, n >= _ENOUGH_SUBJECTS],
        z=z,
        over=t / z,
        above=t / z - 1,
        share=share,
        less=share - level,
        n=n,
        factor=float(tolerance_factor(_ENOUGH_SUBJECTS, level, _SHARE_CONFIDENCE)),
    )


def normal_values(published: Published) -> Evidence:
    """Say why nobody can judge whether the data are normal: limits alone fit any such law."""
    mean = np.ravel(published.limits.moments.mean)
    sd = np.ravel(published.limits.moments.sd)
    n = published.limits.n
    names = _names(published)
    below = special.ndtr(-mean / sd)
    most = float(below.max())
    factor = float(tolerance_factor(n, published.limits.level, _SHARE_CONFIDENCE))
    negative = mean - factor * sd <= 0
    return evidence(
        None,
        negative=names[negative].tolist(),
        below=most,
        worst=names[below.argmax()],
        unseen=(1 - most) ** n,
    )


def joint_level(published: Published) -> Evidence:
    """Judge limits of k and of b used together as if they held together."""
    level = published.limits.level
    least = 1.0 - 2.0 * (1.0 - level)  # Bonferroni's inequality
    independent = level**2
    most = level  # Limits that hold or fail together
    moments = published.limits.moments
    stiffness = Moments(np.ravel(moments.mean)[0], np.ravel(moments.sd)[0], published.limits.n)
    alone = t_interval(stiffness, level=level)
    wider = t_interval(stiffness, level=level, joint="bonferroni")
    widening = (wider.upper - wider.estimate) / (alone.upper - alone.estimate)
    return evidence(
        # The worst dependence, none, the best one, and either parameter by itself.
        [least >= level, independent >= level, most >= level, alone.level >= level],
        least=least,
        most=most,
        independent=independent,
        less=least - level,
        widening=float(widening),
    )


def _expected_share(n: int, level: float) -> float:
    standard = Moments(0.0, 1.0, n)
    interval = t_interval(standard, level=level)
    return float(np.asarray(interval.expected_share))


def _names(published: Published) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Return the names of the table's cells, row by row."""
    return np.array([f"{name} of {wall.name}" for wall in published.walls for name in "kb"])


def mass_left_out(published: Published) -> Evidence:
    """Judge whether Fig. 7d follows from k_e and b_e, the mass m_e being left out."""
    wall, _ = published.drawn[1]

    def felt(environment: Environment, mass: Array, coupling: Coupling | None = None) -> Array:
        with_mass = Environment(environment.stiffness, environment.damping, mass)
        return published.felt(LOOKED_AT, with_mass, coupling=coupling)

    def as_drawn(mass: Array) -> BoolArray:
        ends = [felt(wall.lower, mass), felt(wall.upper, mass)]
        direct = felt(wall.environment, mass)
        coupled = felt(wall.environment, mass, published.tuned)
        low = np.minimum(*ends)
        high = np.maximum(*ends)
        inside = (low <= coupled) & (coupled < direct) & (direct <= high)
        # Beyond the first mass with which it is otherwise, none counts.
        return np.logical_and.accumulate(inside)

    until = largest(as_drawn, np.linspace(0.0, _HEAVIEST, _MASSES)) or 0.0
    return evidence([until > 0, until == math.inf], wall=wall, until=min(until, _HEAVIEST))


def perceivable_range(published: Published) -> Evidence:
    """Judge the statement that forces are felt below 100 rad/s only."""
    _, top = published.span
    cases = []
    thresholds = []
    for hertz in _TOUCH_HERTZ:
        omega = 2 * np.pi * hertz
        cases.append(omega <= top)
        thresholds.append(f"{hertz:g} Hz ({omega:.4g} rad/s)")
    lowest = 2 * np.pi * min(_TOUCH_HERTZ) / top
    return evidence(cases, thresholds=thresholds, lowest=lowest)
