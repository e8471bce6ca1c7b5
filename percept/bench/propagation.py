"""What propagating draws to curves costs: time, memory, and the error of fewer draws and frequencies."""

from __future__ import annotations

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.boundary.draws import MEMORY, DrawCurves
from percept.boundary.grid import adaptive_grid
from percept.haptics import AnyDevice, Device, perceived_magnitude

if TYPE_CHECKING:
    from percept.study import Study

__all__ = [
    "PropagationCost",
    "PropagationMemory",
    "propagation_cost",
    "propagation_memory",
    "study_propagation",
]

Array = NDArray[np.float64]
_NAIVE = (0.1, 100.0, 1000)


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
    frequencies: tuple[float, float, int] = _NAIVE,
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


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _NAIVE
) -> list[PropagationCost]:
    """Time both ways on the next user of every environment of a study.

    Parameters
    ----------
    study : Study
        With a passed fit and a device.
    frequencies : tuple of (float, float, int)
        Range, rad/s, and points of the naive grid.

    Returns
    -------
    list of PropagationCost
        One per environment: the draws that boundaries go through, against one draw at every kept point.
    """
    fit, bench = study.fit, study.bench
    assert fit is not None
    assert bench is not None
    ours = next(d for d in study.curve_draws if (d.method, d.kind) == ("bayesian", "user"))
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    rng = np.random.default_rng(study.scene.inference.seed)
    every = fit.prepared.scale.native(fit.prepared.model.draw(points, rng)[1])
    column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
    found = []
    for name, kept in ours.pairs.items():
        rest = (every[:, column[parameter, name]] for parameter in ("k", "b"))
        k, b = (np.concatenate(pair) for pair in zip(kept, rest, strict=True))
        found.append(
            propagation_cost(
                bench.device, k, b, bench.period, kept=kept[0].size, level=ours.level, frequencies=frequencies
            )
        )
    return found


@dataclass(frozen=True)
class PropagationMemory:
    """What a task holds beside its draws and results.

    Attributes
    ----------
    draws, points, environments : int
        Size of the task: draws of each environment, frequencies.
    values : int
        abs(Z_h) worked out: the product of the three.
    seconds : float
        Processor time.
    held : int
        Growth of the process's largest resident memory over what it had with the draws and room for the
        results, bytes.
    bound : int
        What `percept.boundary.draws` promises, bytes.
    """

    draws: int
    points: int
    environments: int
    values: int
    seconds: float
    held: int
    bound: int


def propagation_memory(
    device: Device, *, draws: int = 100_000, points: int = 2000, environments: int = 50, seed: int = 1
) -> PropagationMemory:
    """Propagate draws of many environments in a process of its own, and see how large it grew.

    Parameters
    ----------
    device : Device
        The device.
    draws, points, environments : int
        Size of the task.
    seed : int
        Of the draws.

    Returns
    -------
    PropagationMemory
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(_propagated, device, draws, points, environments, seed).result()


def _propagated(device: Device, draws: int, points: int, environments: int, seed: int) -> PropagationMemory:
    rng = np.random.default_rng(seed)
    omega = np.geomspace(0.1, 100.0, points)
    stiffness, damping = np.empty((2, environments, draws))
    for k, b in zip(stiffness, damping, strict=True):
        k[:] = np.exp(9.0 + rng.standard_normal() + 0.1 * rng.standard_normal(draws))
        b[:] = np.exp(2.0 + rng.standard_normal() + 0.3 * rng.standard_normal(draws))
    results = np.ones((environments, 4, points))
    # Once in small, so that what is loaded and set up at first use is there before.
    DrawCurves(device, stiffness[0, :1000], damping[0, :1000], 1e-3, level=0.99).at(omega[:8])
    before = _largest_memory()
    started = time.process_time()
    for k, b, kept in zip(stiffness, damping, results, strict=True):
        bands = DrawCurves(device, k, b, 1e-3, level=0.99).at(omega)
        kept[:] = bands.lower, bands.upper, bands.mean, bands.sd
    seconds = time.process_time() - started
    return PropagationMemory(
        draws=draws,
        points=points,
        environments=environments,
        values=draws * points * environments,
        seconds=seconds,
        held=_largest_memory() - before,
        bound=MEMORY,
    )


def _largest_memory() -> int:
    """Largest resident memory of this process so far, bytes."""
    try:
        # Linux: ru_maxrss would count what the parent held when this process was started.
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return 1024 * int(status.split("VmHWM:")[1].split()[0])
    except (OSError, IndexError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
