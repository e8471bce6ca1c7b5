from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.grid import adaptive_grid, departure
from percept.errors import UsageError
from percept.haptics import Device, magnitude_envelope


def envelope(omega: np.ndarray) -> np.ndarray:
    return np.stack(magnitude_envelope(omega, Device(1.0, 5.0), (8000.0, 10500.0), (7.0, 14.0), 1e-3))


def dense_error(omega: np.ndarray, values: np.ndarray) -> float:
    """Independent of the module's own measure: log-log interpolation on a fine grid, curve by curve."""
    fine = np.geomspace(omega[0], omega[-1], 20_011)
    true = envelope(fine)
    floor = 0.02 * true.max(axis=0)
    worst = 0.0
    for curve, points in zip(true, values, strict=True):
        line = np.exp(np.interp(np.log(fine), np.log(omega), np.log(np.maximum(points, 1e-300))))
        kept = curve > floor
        worst = max(worst, float(np.abs(line / curve - 1.0)[kept].max()))
    return worst


def test_lines_between_the_points_follow_a_resonant_envelope() -> None:
    omega, values = adaptive_grid(envelope, 0.1, 1000.0)
    assert dense_error(omega, values) < 1e-3
    uniform = np.geomspace(0.1, 1000.0, omega.size)
    assert dense_error(uniform, envelope(uniform)) > 3e-3  # the same number of points, evenly spread


def test_fewer_points_for_a_looser_tolerance() -> None:
    loose, _ = adaptive_grid(envelope, 0.1, 1000.0, tolerance=1e-2)
    tight, _ = adaptive_grid(envelope, 0.1, 1000.0, tolerance=1e-4)
    assert loose.size < tight.size / 2


def test_a_narrow_peak_is_found_where_it_is_pointed_at() -> None:
    def peak(omega: np.ndarray) -> np.ndarray:
        return 1.0 + 5.0 / (1.0 + (np.log(omega / 3.21) / 1e-3) ** 2)[None]

    blind, _ = adaptive_grid(peak, 0.1, 100.0)
    seen, _ = adaptive_grid(peak, 0.1, 100.0, including=np.array([3.21, 1e9]))
    assert seen.size > blind.size + 10
    assert 3.21 in seen
    assert seen[-1] == 100.0


def test_rows_that_are_not_followed_ask_for_no_points() -> None:
    def rough(omega: np.ndarray) -> np.ndarray:
        return np.stack([omega, omega * (1.0 + 0.1 * np.sin(1e4 * omega))])

    omega, values = adaptive_grid(rough, 0.1, 100.0, followed=np.array([True, False]))
    assert omega.size < 60
    np.testing.assert_array_equal(values, rough(omega))


def test_departure_of_a_known_bend() -> None:
    omega = np.array([1.0, np.e**2])
    values = np.array([[1.0, 1.0]])
    assert departure(omega, values, np.array([np.e]), np.array([[2.0]]))[0] == pytest.approx(np.log(2.0))


@pytest.mark.parametrize(("lower", "upper"), [(0.0, 1.0), (2.0, 1.0)])
def test_wrong_range(lower: float, upper: float) -> None:
    with pytest.raises(UsageError, match="0 < lower < upper"):
        adaptive_grid(envelope, lower, upper)


def test_wrong_tolerance() -> None:
    with pytest.raises(UsageError, match="tolerance must lie in"):
        adaptive_grid(envelope, 1.0, 2.0, tolerance=0.0)
