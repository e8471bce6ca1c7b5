"""Verdicts averaged over what is known of the device, and the part of the doubt that it makes.

A verdict is found with the device at its point. Each of a few devices is then judged by draws of
the users of its own, and so is the point by the same draws: the difference has far less noise than
either, and is added to the verdict.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from percept.boundary.feels_real import judge, rough_probability, share_error
from percept.boundary.users import Users
from percept.haptics.records import Display
from percept.results import DeviceAverage, Verdict
from percept.study.basics import Array
from percept.study.device import Setup
from percept.study.device_draws import DeviceDraws, smallest_margins

__all__ = ["with_device_draws"]

#: Devices that a verdict is averaged over: the first of Sobol's points are an even net.
_DEVICES = 16
#: Draws of the users for each.
_USERS = 64
#: Stable devices from which on their own probability is taken for that of all stable ones.
_FEWEST_STABLE = 4


def with_device_draws(
    verdict: Verdict, setup: Setup, users: Users, omega: Array, decision: float
) -> Verdict:
    """Average a verdict over the device's posterior; without one return it as it is.

    Parameters
    ----------
    verdict : Verdict
        Of one environment, with the device at its point.
    setup : Setup
        Device, coupling and references.
    users : Users
        D populations, in random order.
    omega : ndarray, shape (M,)
        rad/s, dense where margins dip.
    decision : float
        Probability from which a display is said to feel real.

    Returns
    -------
    Verdict
        With the averaged probability, and the outcome by it.
    """
    draws = setup.draws
    if draws is None or verdict.bayesian is None:
        return verdict
    display = setup.display(verdict.environment, coupled=verdict.coupled)
    shifts = _shifts(display, draws, users, omega, verdict.level)
    shift_error = float(shifts.std(ddof=1)) / np.sqrt(shifts.size)
    # Where no device moves the probability, the error counts as one user of all.
    shift_error = max(shift_error, share_error(0.0, shifts.size * _USERS))
    at_point = verdict.bayesian.probability
    probability = float(np.clip(at_point + shifts.mean(), 0.0, 1.0))
    average = DeviceAverage(
        probability=probability,
        error=float(np.hypot(verdict.bayesian.error, shift_error)),
        devices=shifts.size,
        share=_device_share(shifts, probability),
    )
    together = None
    if verdict.coupled and setup.coupling is not None:
        margins = smallest_margins(draws, setup.coupling, setup.period, setup.hold)
        with_each = np.clip(at_point + shifts, 0.0, 1.0)
        together = _stable_and_real(with_each, margins, probability)
    return dataclasses.replace(
        verdict,
        outcome=judge(probability, decision),
        probability=probability,
        stable_and_real=together,
        by_device=average,
    )


def _shifts(
    display: Display, draws: DeviceDraws, users: Users, omega: Array, level: float
) -> Array:
    """Return how each device moves the probability from that of the point."""
    shifts = np.empty(min(_DEVICES, draws.count))
    for index in range(shifts.size):
        rows = np.arange(index * _USERS, (index + 1) * _USERS) % users.size
        judges = users.select(rows)
        at_point = rough_probability(display, judges, omega, level=level)
        other = dataclasses.replace(display, device=draws.device(index))
        shifts[index] = rough_probability(other, judges, omega, level=level) - at_point
    return shifts


def _device_share(shifts: Array, probability: float) -> float:
    """Return the share of the answer's variance, p(1 - p), that lies between devices.

    Flips of single users make shifts vary too: their variance is taken off.
    """
    whole = probability * (1.0 - probability)
    if not whole:
        return 0.0
    chance = float(np.mean(np.abs(shifts) * (1.0 - np.abs(shifts)))) / _USERS
    between = max(float(shifts.var(ddof=1)) - chance, 0.0)
    return min(between / whole, 1.0)


def _stable_and_real(probabilities: Array, margins: Array, average: float) -> float:
    """Return P(stable) over all devices times P(real) over the stable ones of the first devices."""
    stable = margins >= 1.0
    of_stable = probabilities[stable[: probabilities.size]]
    real = float(of_stable.mean()) if of_stable.size >= _FEWEST_STABLE else average
    return float(stable.mean()) * real
