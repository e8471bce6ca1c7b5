"""Frequencies for curves, against turns and crossings of a fine grid."""

from __future__ import annotations

import numpy as np

from percept.boundary.curves import drawing_grid
from percept.haptics import (
    Device,
    Environment,
    Loop,
    corner_curves,
    magnitude_envelope,
    perceived_impedance,
)


def drawn(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One own curve with a dip at 31.6 rad/s, and an envelope and a pair of corners about it."""
    device, limits = Device(1.0, 5.0), ((800.0, 1200.0), (2.0, 8.0))
    own = np.abs(perceived_impedance(Loop(device, 1e-3), omega, Environment(1000.0, 4.0)))[None]
    outlines = [
        magnitude_envelope(Loop(device, 1e-3), omega, *limits),
        corner_curves(Loop(device, 1e-3), omega, *limits),
    ]
    return own, np.array(outlines)


def test_lines_between_the_points_follow_the_curves() -> None:
    grid = drawing_grid(drawn, 0.1, 1000.0, np.array([np.sqrt(1000.0)]))
    fine = np.geomspace(0.1, 1000.0, 20_011)
    for curve, points in zip(
        drawn(fine)[1].reshape(-1, fine.size), drawn(grid)[1].reshape(-1, grid.size), strict=True
    ):
        line = np.interp(np.log(fine), np.log(grid), np.log(points))
        assert np.abs(line - np.log(curve)).max() < 0.03


def test_a_pole_is_left_out() -> None:
    def curve(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(divide="ignore"):
            own = (1.0 + omega / np.abs(1.0 - (omega / 50.0) ** 2))[None]
        return own, np.stack([0.5 * own, 2.0 * own], axis=1)

    grid = drawing_grid(curve, 0.1, 1000.0, np.array([50.0]))
    assert 50.0 not in grid
    assert np.isfinite(curve(grid)[0]).all()
