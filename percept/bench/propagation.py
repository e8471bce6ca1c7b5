"""What propagating draws to curves costs: time, memory, and the error of fewer draws and frequencies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.bench.timed import timed
from percept.boundary.draws import MEMORY, DrawCurves
from percept.boundary.grid import Grid, adaptive_grid
from percept.haptics import AnyDevice, Device, perceived_magnitude

if TYPE_CHECKING:
    from percept.study import Study

Array = NDArray[np.float64]
_NAIVE = (0.1, 100.0, 1000)
#: Departures that percept's frequencies are chosen for, and even frequencies of the other way.
_BOUNDS, _POINTS = (1e-2, 1e-3), (25, 100, 400)


@dataclass(frozen=True)
class PropagationCost:
    """One way to a pointwise band, against the quantiles of every draw at each of many frequencies."""

    environment: str  # Whose draws
    way: str  # Percept's: as many draws as there is information for, at frequencies chosen for them
    draws: int  # Draws propagated
    points: int  # Frequencies
    bound: float | None  # Largest relative departure that percept's frequencies were chosen for
    seconds: float
    seconds_low: float
    seconds_high: float
    ratio: float  # seconds over that of the band it is compared with
    error: float
    worst_error: float


def propagation_costs(
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    kept: int,
    name: str = "",
    level: float = 0.99,
    frequencies: tuple[float, float, int] = _NAIVE,
    repeats: int = 3,
) -> list[PropagationCost]:
    """Time both ways on draws of one environment, from few draws and frequencies to many."""
    lower, upper, points = frequencies
    fine = np.geomspace(lower, upper, points)

    def every_draw(count: int) -> Grid:
        omega = np.geomspace(lower, upper, count)
        curves = perceived_magnitude(omega[:, None], device, stiffness, damping, period)
        tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
        return Grid(omega, np.quantile(curves, tails, axis=1), 0.0)

    def followed(draws: int, bound: float) -> Grid:
        ensemble = DrawCurves(device, stiffness[:draws], damping[:draws], period, level=level)

        def curves(omega: Array) -> Array:
            bands = ensemble.at(omega)
            out = 3.0 * bands.sd
            return np.stack([bands.lower, bands.upper, np.exp(bands.mean - out), np.exp(bands.mean + out)])

        smooth = np.array([False, False, True, True])
        return adaptive_grid(curves, lower, upper, tolerance=bound, followed=smooth)

    ways: list[tuple[str, int, float | None, Callable[[], Grid]]] = [
        ("percept", draws, bound, partial(followed, draws, bound))
        for draws in (kept // 16, kept // 4, kept)
        for bound in _BOUNDS
    ]
    ways += [
        ("all draws", stiffness.size, None, partial(every_draw, count))
        for count in (*(count for count in _POINTS if count < points), points)
    ]
    runs = [timed(work, repeats) for *_, work in ways]
    band = np.log(runs[-1][0].values)
    half_width = 0.5 * (band[1] - band[0])
    found = []
    for (way, draws, bound, _), (grid, seconds) in zip(ways, runs, strict=True):
        lines = [np.interp(np.log(fine), np.log(grid.omega), np.log(row)) for row in grid.values[:2]]
        error = np.abs(np.stack(lines) - band) / half_width
        found.append(
            PropagationCost(
                environment=name,
                way=way,
                draws=draws,
                points=grid.omega.size,
                bound=bound,
                seconds=median(seconds),
                seconds_low=min(seconds),
                seconds_high=max(seconds),
                ratio=median(seconds) / median(runs[-1][1]),
                error=float(np.sqrt(np.mean(error**2))),
                worst_error=float(error.max()),
            )
        )
    return found


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _NAIVE, repeats: int = 3
) -> list[PropagationCost]:
    """Time both ways on the next user of every environment of a study."""
    fit, apparatus = study.fit, study.apparatus
    assert fit is not None
    assert apparatus is not None
    ours = next(d for d in study.curve_draws if (d.method, d.kind) == ("bayesian", "user"))
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    rng = np.random.default_rng(study.scene.inference.seed)
    every = fit.prepared.scale.native(fit.prepared.model.draw(points, rng)[1])
    column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
    found: list[PropagationCost] = []
    for name, kept in ours.pairs.items():
        rest = (every[:, column[parameter, name]] for parameter in ("k", "b"))
        k, b = (np.concatenate(pair) for pair in zip(kept, rest, strict=True))
        found += propagation_costs(
            apparatus.device, k, b, apparatus.period,
            kept=kept[0].size, name=name, level=ours.level, frequencies=frequencies, repeats=repeats,
        )  # fmt: skip
    return found


@dataclass(frozen=True)
class PropagationMemory:
    """What a task holds beside its draws and results."""

    draws: int
    points: int
    environments: int
    values: int  # abs(Z_h) worked out: the product of the three
    seconds: float  # Processor time
    held: int
    bound: int  # What `percept.boundary.draws` promises, bytes


def propagation_memory(
    device: Device, *, draws: int = 100_000, points: int = 2000, environments: int = 50, seed: int = 1
) -> PropagationMemory:
    """Propagate draws of many environments in a process of its own, and see how large it grew."""
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
