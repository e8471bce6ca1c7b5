"""What propagating draws to curves costs: time, memory, and the error of fewer draws and frequencies."""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.boundary.draws import MEMORY, DrawCurves
from percept.boundary.grid import adaptive_grid
from percept.haptics import AnyDevice, perceived_magnitude

__all__ = ["PropagationCost", "propagation_cost", "propagation_memory"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PropagationCost:
    """Pointwise bands through fewer draws at chosen omega, against all draws at all omega.

    Attributes
    ----------
    seconds, naive_seconds : float
        Processor time of both; the naive way is np.quantile of every curve.
    ratio : float
        seconds/naive_seconds.
    points, naive_points : int
        Frequencies.
    draws, naive_draws : int
        Draws propagated.
    error : float
        Largest difference of the limits, as a fraction of the band's half-width in log abs(Z_h), over a fine
        grid: Monte Carlo error of the fewer draws and lines between the points together.
    """

    seconds: float
    naive_seconds: float
    ratio: float
    points: int
    naive_points: int
    draws: int
    naive_draws: int
    error: float


def propagation_cost(
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    kept: int,
    level: float = 0.99,
    frequencies: tuple[float, float, int] = (0.1, 100.0, 1000),
) -> PropagationCost:
    """Time both ways on draws of one environment.

    Parameters
    ----------
    device : Device or TabulatedDevice
        The device.
    stiffness, damping : ndarray, shape (N,)
        All draws, N/m and N·s/m, in an order in which the first `kept` are independent of each other.
    period : float
        Sampling period, s.
    kept : int
        Draws there is information for.
    level : float
        Of the bands.
    frequencies : tuple of (float, float, int)
        Range, rad/s, and points of the naive grid.

    Returns
    -------
    PropagationCost
    """
    lower, upper, points = frequencies
    tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    started = time.process_time()
    ensemble = DrawCurves(device, stiffness[:kept], damping[:kept], period, level=level)

    def curves(omega: Array) -> Array:
        bands = ensemble.at(omega)
        out = 3.0 * bands.sd
        return np.stack([bands.lower, bands.upper, np.exp(bands.mean - out), np.exp(bands.mean + out)])

    grid = adaptive_grid(curves, lower, upper, followed=np.array([False, False, True, True]))
    seconds = time.process_time() - started
    started = time.process_time()
    fine = np.geomspace(lower, upper, points)
    every = perceived_magnitude(fine[:, None], device, stiffness, damping, period)
    naive = np.log(np.quantile(every, tails, axis=1))
    naive_seconds = time.process_time() - started
    ours = np.stack([np.interp(np.log(fine), np.log(grid.omega), np.log(row)) for row in grid.values[:2]])
    error = np.abs(ours - naive) / (0.5 * (naive[1] - naive[0]))
    return PropagationCost(
        seconds=seconds,
        naive_seconds=naive_seconds,
        ratio=seconds / naive_seconds,
        points=grid.omega.size,
        naive_points=points,
        draws=kept,
        naive_draws=stiffness.size,
        error=float(error.max()),
    )


def propagation_memory(
    device: AnyDevice, *, draws: int = 100_000, points: int = 2000, environments: int = 1, seed: int = 1
) -> tuple[int, int]:
    """Measure the memory that propagation holds beside draws and results.

    Parameters
    ----------
    device : Device or TabulatedDevice
        The device.
    draws, points, environments : int
        Size of the task.
    seed : int
        Of the draws.

    Returns
    -------
    peak, bound : int
        Bytes: the largest held, and what `percept.boundary.draws` promises.
    """
    rng = np.random.default_rng(seed)
    omega = np.geomspace(0.1, 100.0, points)
    peak = 0
    for _ in range(environments):
        k, b = np.exp(9.0 + 0.1 * rng.standard_normal(draws)), np.exp(2.0 + 0.3 * rng.standard_normal(draws))
        ensemble = DrawCurves(device, k, b, 1e-3, level=0.99)
        tracemalloc.start()
        ensemble.at(omega)
        peak = max(peak, tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return peak, MEMORY
