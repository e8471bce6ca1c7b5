"""What curves cost: bands from draws, envelopes around regions, memory, and one array of magnitudes."""

from __future__ import annotations

import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.bench.measure import timed
from percept.boundary.curves import Grid, adaptive_grids
from percept.boundary.draws import MEMORY, DrawCurves
from percept.haptics import AnyDevice, Device, perceived_magnitude
from percept.study.boundaries import region_curves

if TYPE_CHECKING:
    from percept.study import Study
    from percept.study.regions import Region

Array: TypeAlias = NDArray[np.float64]
#: Frequencies of the band compared with: first and last, rad/s, and how many.
_EVERY = (0.1, 100.0, 1000)
#: Departures that percept's frequencies are chosen for, and even frequencies of the other way.
_BOUNDS, _POINTS = (1e-2, 1e-3), (25, 100, 400)
#: Points on a side of a rectangle or on a ring of an ellipse, and the rings' radii over the ellipse's.
_SIDES, _RADII = (8, 32, 128), (0.0, 0.25, 0.5, 0.75, 1.0)
#: Method, kind and joint statement of the regions compared: a rectangle and an ellipse per environment.
_COMPARED = {("bayesian", "mean", "bonferroni"), ("bayesian", "mean", "hotelling")}


@dataclass(frozen=True)
class PropagationCost:
    """One way to a pointwise band, against the quantiles of every draw at each of many frequencies."""

    environment: Annotated[str, "Whose draws."]
    way: Annotated[
        str,
        "percept: as many draws as there is information for, at frequencies chosen for them. all draws: "
        "np.quantile of all of them at frequencies spaced evenly in log omega.",
    ]
    draws: Annotated[int, "Draws propagated."]
    points: Annotated[int, "Frequencies."]
    bound: Annotated[float | None, "Largest relative departure that percept's frequencies were chosen for."]
    seconds: Annotated[float, "Processor time: median of the repeats."]
    seconds_low: Annotated[float, "The shortest."]
    seconds_high: Annotated[float, "The longest."]
    ratio: Annotated[float, "seconds over that of the band it is compared with."]
    error: Annotated[
        float,
        "Root mean square difference from that band over omega and both limits, as a fraction of its "
        "half-width in log abs(Z_h): fewer draws and lines between points together.",
    ]
    worst_error: Annotated[float, "The largest such difference."]


def propagation_costs(
    device: AnyDevice,
    stiffness: Array,
    damping: Array,
    period: float,
    *,
    kept: int,
    name: str = "",
    level: float = 0.99,
    frequencies: tuple[float, float, int] = _EVERY,
    repeats: int = 3,
) -> list[PropagationCost]:
    """Time both ways on draws of one environment, from few draws and frequencies to many."""
    lower, upper, points = frequencies

    def every_draw(count: int) -> Grid:
        omega = np.geomspace(lower, upper, count)
        curves = perceived_magnitude(omega[:, None], device, stiffness, damping, period)
        tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
        return Grid(omega, np.quantile(curves, tails, axis=1), 0.0)

    def adaptive(draws: int, bound: float) -> Grid:
        ensemble = DrawCurves(device, stiffness[:draws], damping[:draws], period, level=level)

        def curves(_: NDArray[np.intp], omega: Array) -> Array:
            bands = ensemble.at(omega)
            out = 3.0 * bands.sd
            return np.stack([bands.lower, bands.upper, np.exp(bands.mean - out), np.exp(bands.mean + out)])

        smooth = np.array([False, False, True, True])
        (grid,) = adaptive_grids(curves, 1, lower, upper, tolerance=bound, followed=smooth)
        return grid

    ways: list[tuple[str, int, float | None, Callable[[], Grid]]] = [
        ("percept", draws, bound, partial(adaptive, draws, bound))
        for draws in (kept // 16, kept // 4, kept)
        for bound in _BOUNDS
    ]
    ways += [
        ("all draws", stiffness.size, None, partial(every_draw, count))
        for count in (*(count for count in _POINTS if count < points), points)
    ]
    runs = [timed(work, repeats) for *_, work in ways]
    fine = np.log(np.geomspace(lower, upper, points))
    band = np.log(runs[-1][0].values)
    costs = []
    for (way, draws, bound, _), (grid, seconds) in zip(ways, runs, strict=True):
        lines = [np.interp(fine, np.log(grid.omega), np.log(row)) for row in grid.values[:2]]
        costs.append(
            PropagationCost(
                environment=name,
                way=way,
                draws=draws,
                points=grid.omega.size,
                bound=bound,
                **_seconds(seconds, runs[-1][1]),
                **_errors(np.stack(lines), band),
            )
        )
    return costs


def _seconds(seconds: Sequence[float], others: Sequence[float]) -> dict[str, float]:
    return {
        "seconds": median(seconds),
        "seconds_low": min(seconds),
        "seconds_high": max(seconds),
        "ratio": median(seconds) / median(others),
    }


def _errors(lines: Array, band: Array) -> dict[str, float]:
    """Root mean square and largest difference of log limits, over the half-width of the band."""
    error = np.abs(lines - band) / (0.5 * (band[1] - band[0]))
    return {"error": float(np.sqrt(np.mean(error**2))), "worst_error": float(error.max())}


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY, repeats: int = 3
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
    costs: list[PropagationCost] = []
    for name, kept in ours.pairs.items():
        rest = (every[:, column[parameter, name]] for parameter in ("k", "b"))
        k, b = (np.concatenate(pair) for pair in zip(kept, rest, strict=True))
        costs += propagation_costs(
            apparatus.device, k, b, apparatus.period,
            kept=kept[0].size, name=name, level=ours.level, frequencies=frequencies, repeats=repeats,
        )  # fmt: skip
    return costs


@dataclass(frozen=True)
class EnvelopeCost:
    """One way to the envelope of abs(Z_h) over a region."""

    environment: Annotated[str, "Whose region of average users."]
    region: Annotated[str, "Its shape; the ellipse is one in log k and log b."]
    way: Annotated[
        str, "percept: exact at every omega. points: the smallest and largest over points in the region."
    ]
    points: Annotated[int | None, "How many points."]
    frequencies: Annotated[int, "At which both are worked out."]
    seconds: Annotated[float, "Processor time: median of the repeats."]
    seconds_low: Annotated[float, "The shortest."]
    seconds_high: Annotated[float, "The longest."]
    ratio: Annotated[float, "seconds over percept's."]
    error: Annotated[
        float,
        "Root mean square difference from the exact limits over omega and both limits, as a fraction of "
        "half the envelope's width in log abs(Z_h). Points lie inside: theirs is too narrow.",
    ]
    worst_error: Annotated[float, "The largest such difference."]


def envelope_costs(study: Study, *, frequencies: int = 500, repeats: int = 5) -> list[EnvelopeCost]:
    """Time both ways around the Bayesian regions of average users of every environment."""
    apparatus = study.apparatus
    assert apparatus is not None
    omega = np.geomspace(0.1, 100.0, frequencies)
    device, period, hold = apparatus.device, apparatus.period, apparatus.hold

    def among(points: Array) -> tuple[Array, Array]:
        k, b = points
        every = perceived_magnitude(omega[:, None], device, k, b, period, hold=hold)
        return every.min(axis=1), every.max(axis=1)

    costs = []
    for region in study.regions:
        if (region.method, region.kind, region.joint) not in _COMPARED:
            continue
        works: list[Callable[[], tuple[Array, Array]]] = [
            partial(region_curves, region, "envelope", omega, device, period, hold=hold)
        ]
        counts: list[int | None] = [None]
        for points in (points_in(region, count) for count in _SIDES):
            works.append(partial(among, points))
            counts.append(points.shape[1])
        runs = [timed(work, repeats) for work in works]
        exact = np.log(np.stack(runs[0][0]))
        costs += [
            EnvelopeCost(
                environment=region.environment,
                region="rectangle" if region.ellipse is None else "ellipse",
                way="percept" if count is None else "points",
                points=count,
                frequencies=omega.size,
                **_seconds(seconds, runs[0][1]),
                **_errors(np.log(np.stack(limits)), exact),
            )
            for count, (limits, seconds) in zip(counts, runs, strict=True)
        ]
    return costs


def points_in(region: Region, count: int) -> Array:
    """Points (2, N) of an even grid over a rectangle, or on rings of an ellipse."""
    ellipse = region.ellipse
    if ellipse is None:
        assert region.limits is not None
        sides = (np.linspace(low, high, count) for low, high in region.limits)
        return np.stack([axis.ravel() for axis in np.meshgrid(*sides)])
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)])
    rings = np.concatenate([ellipse.radius * radius * ring for radius in _RADII], axis=1)
    points = np.asarray(ellipse.centre)[:, None] + np.linalg.cholesky(np.asarray(ellipse.shape)) @ rings
    return np.exp(points) if ellipse.family == "lognormal" else points


@dataclass(frozen=True)
class PropagationMemory:
    """What a task holds beside its draws and results."""

    draws: Annotated[int, "Draws of each environment."]
    points: Annotated[int, "Frequencies."]
    environments: Annotated[int, "Environments."]
    values: Annotated[int, "abs(Z_h) worked out: the product of the three."]
    seconds: Annotated[float, "Processor time."]
    held: Annotated[
        int,
        "Growth of the process's largest resident memory over what it had with the draws and room for the "
        "results, bytes.",
    ]
    bound: Annotated[int, "What `percept.boundary.draws` promises, bytes."]


def propagation_memory(
    *, draws: int = 100_000, points: int = 2000, environments: int = 50, seed: int = 1
) -> PropagationMemory:
    """Propagate draws of many environments in a process of its own, and see how large it grew."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(_propagated, draws, points, environments, seed).result()


def _propagated(draws: int, points: int, environments: int, seed: int) -> PropagationMemory:
    device = Device(1.0, 5.0)
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
    held = _largest_memory() - before
    return PropagationMemory(
        draws, points, environments, draws * points * environments, seconds, held, MEMORY
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


@dataclass(frozen=True)
class MagnitudeCost:
    """Run time and memory of abs(Z_h) over ω × environments × draws."""

    shape: Annotated[tuple[int, int, int], "(ω, environments, draws)."]
    seconds: Annotated[
        float, "Processor time, best of the repeats, results written to an array made beforehand."
    ]
    hypot_seconds: Annotated[float, "The same for np.hypot of two full arrays."]
    ratio: Annotated[float, "seconds/hypot_seconds."]
    scratch_bytes: Annotated[int, "Largest memory held beside the arguments and the result."]
    result_bytes: Annotated[int, "Size of the result."]


def magnitude_cost(
    *, omegas: int = 1000, environments: int = 5, draws: int = 10_000, repeats: int = 3, seed: int = 1
) -> MagnitudeCost:
    """Time `percept.haptics.perceived_magnitude` on random draws, against np.hypot in turn."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(0.1, 100, omegas)[:, None, None]
    stiffness = np.exp(rng.normal(np.log(1000), 0.3, (environments, draws)))
    damping = np.exp(rng.normal(0, 0.3, (environments, draws)))
    shape = (omegas, environments, draws)
    out, one, other = np.empty((3, *shape))
    one[...], other[...] = stiffness, damping

    def magnitude() -> Any:
        return perceived_magnitude(omega, Device(1.0, 5.0), stiffness, damping, 1e-3, out=out)

    pairs = [
        (timed(magnitude, 1)[1][0], timed(lambda: np.hypot(one, other, out=out), 1)[1][0])
        for _ in range(repeats)
    ]
    seconds, hypot_seconds = (min(times) for times in zip(*pairs, strict=True))
    tracemalloc.start()
    try:
        magnitude()
        scratch = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return MagnitudeCost(shape, seconds, hypot_seconds, seconds / hypot_seconds, scratch, out.nbytes)
