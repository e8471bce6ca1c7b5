"""Realism over posterior draws, against a loop over draws and a fine grid of frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.realism import realism
from percept.haptics import Coupling, Device, Environment, effective_impedance, magnitude_envelope
from percept.haptics import perceived_impedance as perceived
from percept.haptics.containment import ON_LIMIT, Boxes
from percept.haptics.records import Display

LOWER, UPPER, PERIOD, DEVICE = 0.1, 100.0, 1e-3, Device(1.0, 5.0)


@pytest.mark.parametrize("coupling", [None, Coupling(2e4, 50.0)])
def test_realism_is_that_of_a_loop_over_draws_and_a_fine_grid(coupling: Coupling | None) -> None:
    rng = np.random.default_rng(5)
    omega = np.sort(
        np.concatenate([np.geomspace(LOWER, UPPER, 2000), np.linspace(25.0, 40.0, 2000)])
    )
    k_low, b_low = np.exp(rng.normal(6.85, 0.06, 200)), rng.normal(0.5, 0.3, 200)
    k_high, b_high = k_low * 1.15, b_low + 1.0
    own = Environment(950.0, 1.2)
    users = Boxes.of((k_low, k_high), (b_low, b_high))
    found = realism(Display(DEVICE, own, PERIOD, coupling), users, LOWER, UPPER)
    shown = np.abs(perceived(omega, DEVICE, own, PERIOD, coupling=coupling))
    k, b = np.full(omega.size, 950.0), np.full(omega.size, 1.2)
    if coupling is not None:
        k, b = effective_impedance(omega, own, coupling, PERIOD)
    magnitude, plane = np.empty(200, dtype=bool), np.empty(200, dtype=bool)
    for s in range(200):
        box = (k_low[s], k_high[s]), (b_low[s], b_high[s])
        lower, upper = magnitude_envelope(omega, DEVICE, *box, PERIOD)
        magnitude[s] = ((lower <= shown) & (shown <= upper)).all()
        plane[s] = all(
            ((low <= v) & (v <= high)).all() for v, (low, high) in zip((k, b), box, strict=True)
        )
    assert found.plane == plane.mean()
    # Between the grid's points a draw may leave that its points do not show.
    assert magnitude.mean() - 0.005 <= found.magnitude <= magnitude.mean()
    assert 0.1 < found.plane < found.magnitude < 0.9
    p = found.magnitude
    assert found.magnitude_error == pytest.approx(np.sqrt(p * (1 - p) / 200))
    assert found.draws == 200


def test_the_limits_of_a_population_are_real_themselves() -> None:
    users = Boxes.of((900.0, 1100.0), (1.0, 3.0))
    for k, b in ((900.0, 1.0), (1100.0, 3.0), (900.0, 3.0)):
        found = realism(Display(DEVICE, Environment(k, b), PERIOD), users, LOWER, UPPER)
        assert (found.magnitude, found.plane) == (1.0, 1.0)
        assert found.plane_error == 1.0


def test_a_display_far_away_is_real_to_nobody() -> None:
    users = Boxes.of((900.0, 1100.0), (1.0, 3.0), count=9)
    found = realism(Display(DEVICE, Environment(9e3, 2.0), PERIOD), users, LOWER, UPPER)
    assert (found.magnitude, found.plane) == (0.0, 0.0)


def test_a_draw_that_no_search_decides_is_in_the_error() -> None:
    """A spring alone departs evenly: at the tolerance itself rounding hides on which side it is."""
    k, count = 1000.0, 100
    off = ON_LIMIT + np.linspace(-2e-15, 2e-15, count)
    for shift, undecided in ((0.0, True), (-1e-12, False)):
        users = Boxes.of((900.0, k * np.exp(-off - shift)), (0.0, 0.0))
        found = realism(Display(Device(0.0, 0.0), Environment(k, 0.0), PERIOD), users, LOWER, UPPER)
        binomial = np.sqrt(found.magnitude * (1 - found.magnitude) / count)
        assert (found.magnitude_error > max(binomial, 1 / count)) == undecided
        assert found.plane_error == 1 / count
