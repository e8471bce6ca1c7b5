"""Verdicts over a range of ω: against grids, 50-digit arithmetic, and cases in closed form."""

import numpy as np
import pytest

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    TabulatedDevice,
    effective_impedance,
)
from percept.haptics.containment import ON_LIMIT, Boxes, departures, plane_departures
from percept.haptics.records import Display
from tests import LONG
from tests.haptics.scenes import (
    LOWER,
    PERIOD,
    UPPER,
    Scene,
    box,
    contradiction,
    heavy_tables,
    scenes,
)

OMEGA = np.geomspace(LOWER, UPPER, 20_000 if LONG else 10_000)


@pytest.mark.evidence(reduced=True)
def test_no_point_of_a_grid_contradicts_a_verdict():
    every = list(scenes(200 if LONG else 20, 11))
    found = [contradiction(scene, OMEGA) for scene in every]
    assert [wrong for wrong, _ in found if wrong] == []
    planted = {scene.planted for scene in every}
    assert planted == {"", "excursion", "tie"}
    # Excursions that the grid misses are the point.
    assert any(outside == 0 for _, outside in found)


def test_verdicts_hold_for_measured_devices_and_coupled_environments_with_a_mass():
    marginal = []
    for scene in heavy_tables(60, 5):
        rows = scene.display.device.omega
        inside = rows[(rows > LOWER) & (rows < UPPER)]
        seen = float(scene.on_grid(np.union1d(OMEGA, inside)).max())
        found = scene.judged()
        assert seen <= found.bound[0] + 1e-12
        if found.verdict() == "marginal":
            marginal.append(seen)
    # Only a display that touches its limits may be marginal.
    assert [seen for seen in marginal if abs(seen) > 1e-6] == []


@pytest.mark.evidence(reduced=True)
def test_the_largest_departure_is_that_of_a_fine_grid():
    for scene in scenes(6 if LONG else 2, 3):
        found, seen = scene.judged(), float(scene.on_grid(OMEGA).max())
        assert found.largest[0] == pytest.approx(
            scene.in_fifty_digits(float(found.omega[0])), abs=1e-11
        )
        assert seen <= found.bound[0]
        assert found.bound[0] - found.largest[0] <= 1.01 * max(
            ON_LIMIT, 1e-4 * abs(found.largest[0])
        )


def test_a_spike_of_a_table_between_close_rows_is_seen():
    omega = np.array([0.1, 10.0, 10.0001, 10.0002, 100.0])
    limits = box((900.0, 1100.0), (0.5, 4.0))
    # Above its limits in damping alone, the display leaves only where the device's own damping is
    # large.
    for spike, verdict in ((0.0, "inside"), (300.0, "inside"), (1000.0, "outside")):
        table = TabulatedDevice(omega, np.array([5, 5, 5 + spike, 5, 5], dtype=complex))
        display = Display(table, Environment(1000.0, 6.0), PERIOD)
        found = departures(display, limits, LOWER, 50.0)
        assert found.verdict() == verdict
    assert 10.0 < found.omega[0] < 10.0002
    assert Scene(display, limits, "").in_fifty_digits(float(found.omega[0])) > 0


def test_a_rigid_device_on_one_corner_s_curve_is_marginal_throughout():
    display = Display(Device(1.0, 5.0), Environment(1100.0, 4.0), PERIOD)
    found = departures(display, box((900.0, 1100.0), (0.5, 4.0)), LOWER, UPPER)
    assert found.verdict() == "marginal"
    assert abs(found.largest[0]) < ON_LIMIT


def test_corner_curves_that_cross_leave_nothing_inside():
    display = Display(Device(1.0, 5.0), Environment(1000.0, 3.0), PERIOD)
    limits = (900.0, 1100.0), (2.0, 4.0)
    assert departures(display, Boxes.of(*limits), LOWER, UPPER).verdict() == "inside"
    assert departures(display, Boxes.of(*limits, corners=True), LOWER, UPPER).verdict() == "outside"
    assert departures(display, Boxes.of(*limits, corners=True), LOWER, 1.0).verdict() == "inside"


def test_a_mass_of_the_environment_belongs_to_what_users_adjust():
    """A coupling so stiff that it hides nothing leaves a reference as far inside as none."""
    own = Environment(1000.0, 3.0, 0.7)
    limits = box((900.0, 1100.0), (2.0, 4.0))
    direct = departures(Display(Device(1.0, 5.0), own, PERIOD), limits, LOWER, UPPER)
    through = departures(
        Display(Device(1.0, 5.0), own, PERIOD, Coupling(1e12, 1.0)), limits, LOWER, UPPER
    )
    assert direct.verdict() == through.verdict() == "inside"
    assert through.largest[0] == pytest.approx(direct.largest[0], rel=1e-3)


@pytest.mark.parametrize("mass", [0.0, 0.5, 20.0])
def test_departures_of_what_couplings_show(mass):
    """Two couplings at once, one of them soft, against limits of their own, on a fine grid."""
    own, couplings = (
        Environment(5e3, 3.0, mass),
        Coupling(np.array([2e4, 9e3]), np.array([6.0, 40.0])),
    )
    k, b = (
        (np.array([3500.0, 3000.0]), np.array([5500.0, 6000.0])),
        (np.full(2, 1.0), np.array([2.5, 7.0])),
    )
    display = Display(Device(1.0, 5.0), own, PERIOD, couplings)
    found = plane_departures(display, Boxes.of(k, b), LOWER, UPPER)
    omega = np.geomspace(LOWER, UPPER, 400_001)
    for n in (0, 1):

        def off(omega, n=n):
            coupling = Coupling(couplings.stiffness[n], couplings.damping[n])
            stiffness, damping = effective_impedance(omega, own, coupling, PERIOD)
            stiffness = stiffness + mass * (2 / PERIOD * np.tan(omega * PERIOD / 2)) ** 2
            sides = [
                np.maximum(low[n] - value, value - high[n]) / (high[n] - low[n])
                for value, (low, high) in ((stiffness, k), (damping, b))
            ]
            return np.maximum(*sides)

        assert found.largest[n] >= off(omega).max() - 1e-12
        assert found.largest[n] == pytest.approx(off(omega).max(), rel=1e-4, abs=1e-6)
        assert off(found.omega[n]) == pytest.approx(found.largest[n], rel=1e-9)
