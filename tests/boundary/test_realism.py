"""Realism over posterior draws, against a loop over draws and frequencies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from percept.boundary.realism import Displayed, Populations, realism
from percept.errors import UsageError
from percept.haptics import Device, Environment, magnitude_envelope, perceived_impedance


def test_realism_equals_a_loop_over_draws_and_frequencies() -> None:
    rng = np.random.default_rng(5)
    device, period, omega = Device(1.0, 5.0), 1e-3, np.geomspace(0.1, 100.0, 9)
    k_low, b_low = np.exp(rng.normal(6.85, 0.06, 200)), rng.normal(0.5, 0.3, 200)
    k_high, b_high = k_low * 1.15, b_low + 1.0
    shown = Environment(950.0, 1.2)
    displayed = Displayed(
        omega, np.abs(perceived_impedance(omega, device, shown, period)), np.full(9, 950.0), np.full(9, 1.2)
    )
    elsewhere = dataclasses.replace(displayed, magnitude=10.0 * displayed.magnitude)
    users = Populations((k_low, k_high), (b_low, b_high))
    far, found = realism([elsewhere, displayed], users, device, period)
    plane = (k_low <= 950) & (k_high >= 950) & (b_low <= 1.2) & (b_high >= 1.2)
    inside = np.empty((9, 200), dtype=bool)
    for m, s in np.ndindex(inside.shape):
        box = (k_low[s], k_high[s]), (b_low[s], b_high[s])
        lower, upper = magnitude_envelope(omega[m], device, *box, period)
        inside[m, s] = lower <= displayed.magnitude[m] <= upper
    assert found.plane_throughout == plane.mean()
    np.testing.assert_array_equal(found.plane, np.full(9, plane.mean()))
    np.testing.assert_array_equal(found.magnitude, inside.mean(axis=1))
    assert found.magnitude_throughout == inside.all(axis=0).mean()
    assert 0.1 < found.plane_throughout < found.magnitude_throughout < 0.9
    assert far.magnitude_throughout == 0.0
    assert far.plane_throughout == found.plane_throughout


def test_realism_throughout_counts_every_frequency_however_many_draws() -> None:
    draws = 1 << 17  # too many for three frequencies at once
    device, omega, ones = Device(1.0, 5.0), np.array([1.0, 10.0, 100.0]), np.ones(3)
    users = Populations(
        (np.full(draws, 900.0), np.full(draws, 1100.0)), (np.full(draws, 1.0), np.full(draws, 3.0))
    )
    stiffness = np.array([2000.0, 1000.0, 1000.0])  # outside at the first omega alone
    shown = np.abs(perceived_impedance(omega, device, Environment(stiffness, 2.0), 1e-3))
    (found,) = realism([Displayed(omega, shown, stiffness, 2.0 * ones)], users, device, 1e-3)
    assert found.magnitude.tolist() == found.plane.tolist() == [0.0, 1.0, 1.0]
    assert (found.magnitude_throughout, found.plane_throughout) == (0.0, 0.0)


def test_the_limits_of_a_population_are_real_themselves() -> None:
    users = Populations((np.array([900.0]), np.array([1100.0])), (np.array([1.0]), np.array([3.0])))
    device, omega = Device(1.0, 5.0), np.ones(1)
    limits = magnitude_envelope(omega, device, users.stiffness, users.damping, 1e-3)
    for magnitude, stiffness, damping in zip(limits, users.stiffness, users.damping, strict=True):
        (found,) = realism([Displayed(omega, magnitude, stiffness, damping)], users, device, 1e-3)
        assert (found.magnitude_throughout, found.plane_throughout) == (1.0, 1.0)


def test_realism_needs_draws() -> None:
    nothing = (np.empty(0), np.empty(0))
    displayed = Displayed(*(np.ones(1) for _ in range(4)))
    with pytest.raises(UsageError, match="at least one posterior draw"):
        realism([displayed], Populations(nothing, nothing), Device(1.0, 5.0), 1e-3)


def test_displays_are_judged_at_the_same_frequencies() -> None:
    one, other = (Displayed(np.full(1, omega), *(np.ones(1) for _ in range(3))) for omega in (1.0, 2.0))
    limits = (np.zeros(3), np.ones(3))
    with pytest.raises(UsageError, match="need the same omega"):
        realism([one, other], Populations(limits, limits), Device(1.0, 5.0), 1e-3)
