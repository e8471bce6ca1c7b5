from __future__ import annotations

import numpy as np
import pytest

from percept.boundary.grid import FLOOR, adaptive_grid, adaptive_grids
from percept.errors import UsageError
from percept.haptics import Device, magnitude_envelope


def envelope(omega: np.ndarray) -> np.ndarray:
    return np.stack(magnitude_envelope(omega, Device(1.0, 5.0), (8000.0, 10500.0), (7.0, 14.0), 1e-3))


def dense_error(omega: np.ndarray, values: np.ndarray) -> float:
    """Independent of the module's own measure: log-log interpolation on a fine grid, curve by curve."""
    fine = np.geomspace(omega[0], omega[-1], 20_011)
    true = envelope(fine)
    floor = FLOOR * true.max(axis=0)
    worst = 0.0
    for curve, points in zip(true, values, strict=True):
        line = np.exp(np.interp(np.log(fine), np.log(omega), np.log(np.maximum(points, 1e-300))))
        kept = curve > floor
        worst = max(worst, float(np.abs(line / curve - 1.0)[kept].max()))
    return worst


def test_lines_between_the_points_follow_a_resonant_envelope() -> None:
    grid = adaptive_grid(envelope, 0.1, 1000.0)
    assert dense_error(grid.omega, grid.values) < grid.departure <= 1e-3
    uniform = np.geomspace(0.1, 1000.0, grid.omega.size)
    assert dense_error(uniform, envelope(uniform)) > 3e-3  # the same number of points, evenly spread


def test_fewer_points_for_a_looser_tolerance() -> None:
    loose, tight = (adaptive_grid(envelope, 0.1, 1000.0, tolerance=t).omega for t in (1e-2, 1e-4))
    assert loose.size < tight.size / 2


def test_a_narrow_peak_is_found_where_it_is_pointed_at() -> None:
    def peak(omega: np.ndarray) -> np.ndarray:
        return 1.0 + 5.0 / (1.0 + (np.log(omega / 3.21) / 1e-3) ** 2)[None]

    blind = adaptive_grid(peak, 0.1, 100.0).omega
    seen = adaptive_grid(peak, 0.1, 100.0, including=np.array([3.21, 1e9])).omega
    assert seen.size > blind.size + 10
    assert 3.21 in seen
    assert seen[-1] == 100.0


def test_rows_that_are_not_followed_ask_for_no_points() -> None:
    def rough(omega: np.ndarray) -> np.ndarray:
        return np.stack([omega, omega * (1.0 + 0.1 * np.sin(1e4 * omega))])

    grid = adaptive_grid(rough, 0.1, 100.0, followed=np.array([True, False]))
    assert grid.omega.size < 60
    np.testing.assert_array_equal(grid.values, rough(grid.omega))


def test_a_corner_anywhere_in_an_interval_stays_within_the_tolerance() -> None:
    fine = np.geomspace(0.1, 100.0, 200_001)
    for corner in np.geomspace(2.0, 2.7, 40):

        def bent(omega: np.ndarray, corner: float = corner) -> np.ndarray:
            return np.maximum(1.0, omega / corner)[None]

        grid = adaptive_grid(bent, 0.1, 100.0)
        line = np.interp(np.log(fine), np.log(grid.omega), np.log(grid.values[0]))
        assert np.abs(line - np.log(bent(fine)[0])).max() <= grid.departure <= 1e-3


def test_what_no_number_of_points_can_follow_is_admitted() -> None:
    def rough(omega: np.ndarray) -> np.ndarray:
        return (1.0 + 0.1 * np.sin(1e6 * omega))[None]

    grid = adaptive_grid(rough, 0.1, 100.0)
    assert grid.departure > 1e-2
    assert 4096 <= grid.omega.size < 3 * 4096


def test_departure_is_twice_what_was_seen_in_the_middle() -> None:
    bend = 5e-4
    start = adaptive_grid(lambda omega: np.ones((1, omega.size)), 0.1, 10.0).omega[::2]

    def bent(omega: np.ndarray) -> np.ndarray:
        return np.where(np.isin(omega, start), 1.0, np.exp(0.5 * bend))[None]

    grid = adaptive_grid(bent, 0.1, 10.0)
    assert grid.omega.size == 2 * start.size - 1
    assert grid.departure == pytest.approx(bend)


def test_sets_of_curves_are_chosen_for_as_if_alone() -> None:
    corners = np.array([0.5, 2.3, 40.0])

    def bent(which: np.ndarray, omega: np.ndarray) -> np.ndarray:
        return np.stack([np.maximum(1.0, omega / corners[which]), np.sin(30.0 * omega) + 2.0])

    options = {"including": np.array([0.7, 2.3]), "followed": np.array([True, False])}
    together = adaptive_grids(bent, corners.size, 0.1, 100.0, **options)
    sizes = set()
    for one, grid in enumerate(together):
        alone = adaptive_grid(
            lambda omega, one=one: bent(np.full(omega.size, one), omega), 0.1, 100.0, **options
        )
        np.testing.assert_array_equal(grid.omega, alone.omega)
        np.testing.assert_array_equal(grid.values, alone.values)
        assert grid.departure == alone.departure
        sizes.add(grid.omega.size)
    assert len(sizes) > 1


def test_sets_that_nothing_can_follow_take_no_points_from_each_other() -> None:
    def rough(which: np.ndarray, omega: np.ndarray) -> np.ndarray:
        return (1.0 + 0.1 * np.sin(1e6 * (1 + which) * omega))[None]

    for one, grid in enumerate(adaptive_grids(rough, 2, 0.1, 100.0)):
        alone = adaptive_grid(lambda omega, one=one: rough(np.full(omega.size, one), omega), 0.1, 100.0)
        np.testing.assert_array_equal(grid.omega, alone.omega)
        np.testing.assert_array_equal(grid.values, alone.values)


@pytest.mark.parametrize(("lower", "upper"), [(0.0, 1.0), (2.0, 1.0)])
def test_wrong_range(lower: float, upper: float) -> None:
    with pytest.raises(UsageError, match="0 < lower < upper"):
        adaptive_grid(envelope, lower, upper)


def test_wrong_tolerance() -> None:
    with pytest.raises(UsageError, match="tolerance must lie in"):
        adaptive_grid(envelope, 1.0, 2.0, tolerance=0.0)


def test_around_a_pole_no_halving_goes_on_for_ever() -> None:
    """An undamped mode: endless at its frequency, which is pointed at."""
    pole = 50.0

    def curve(omega: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return (1.0 + omega / np.abs(1.0 - (omega / pole) ** 2))[None]

    grid = adaptive_grid(curve, 0.1, 1000.0, including=np.array([pole]))
    assert np.all(np.diff(grid.omega) > 0)
    assert np.isfinite(grid.values).all()
    assert grid.omega.size < 2500
    assert grid.departure <= 1e-3
    fine = np.geomspace(0.1, 1000.0, 40_001)
    fine = fine[np.abs(fine / pole - 1.0) > 1e-8]
    line = np.exp(np.interp(np.log(fine), np.log(grid.omega), np.log(grid.values[0])))
    assert np.abs(line / curve(fine)[0] - 1.0).max() < 1e-3
