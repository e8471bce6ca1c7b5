"""What propagating draws to curves costs: time, and the error of fewer draws and frequencies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.bench.measure import timed
from percept.boundary.curves import Grid, adaptive_grid
from percept.boundary.draws import DrawCurves
from percept.haptics import AnyDevice, perceived_magnitude

if TYPE_CHECKING:
    from percept.study import Study

Array: TypeAlias = NDArray[np.float64]
#: Frequencies of the band compared with: first and last, rad/s, and how many.
_EVERY = (0.1, 100.0, 1000)
#: Departures that percept's frequencies are chosen for, and even frequencies of the other way.
_BOUNDS, _POINTS = (1e-2, 1e-3), (25, 100, 400)


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

        def curves(omega: Array) -> Array:
            bands = ensemble.at(omega)
            out = 3.0 * bands.sd
            return np.stack([bands.lower, bands.upper, np.exp(bands.mean - out), np.exp(bands.mean + out)])

        smooth = np.array([False, False, True, True])
        return adaptive_grid(curves, lower, upper, tolerance=bound, followed=smooth)

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
        error = np.abs(np.stack(lines) - band) / (0.5 * (band[1] - band[0]))
        costs.append(
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
    return costs


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY, repeats: int = 3
) -> list[PropagationCost]:
    """Time both ways on the next user of every environment of a study."""
    fit, setup = study.fit, study.setup
    assert fit is not None
    assert setup is not None
    ours = next(d for d in study.curve_draws if (d.method, d.kind) == ("bayesian", "user"))
    points = fit.run.points.reshape(-1, fit.run.points.shape[-1])
    rng = np.random.default_rng(study.scene.inference.seed)
    every = fit.scale.native(fit.model.draw(points, rng)[1])
    column = {cell: c for c, cell in enumerate(fit.model.cells)}
    costs: list[PropagationCost] = []
    for name, kept in ours.pairs.items():
        rest = (every[:, column[parameter, name]] for parameter in ("k", "b"))
        k, b = (np.concatenate(pair) for pair in zip(kept, rest, strict=True))
        costs += propagation_costs(
            setup.device, k, b, setup.period,
            kept=kept[0].size, name=name, level=ours.level, frequencies=frequencies, repeats=repeats,
        )  # fmt: skip
    return costs
