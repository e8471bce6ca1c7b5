"""What curves of a law of (k, b) cost, and how their error falls with the number of posterior draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.bench.measure import timed
from percept.boundary.law import mixture_law
from percept.boundary.limits import Magnitude
from percept.haptics import AnyDevice, perceived_magnitude
from percept.inference.hierarchy.models import Pooled

if TYPE_CHECKING:
    from percept.study import Study

Array: TypeAlias = NDArray[np.float64]
#: Frequencies of the bands: first and last, rad/s, and how many.
_EVERY = (0.1, 100.0, 121)
#: Of the draws of the scales, the parts propagated.
_PARTS = (256, 64, 16, 4, 1)
#: Curves of one draw each, per draw of the scales: the other way.
_REPEATS = 4
_BATCHES = 32


@dataclass(frozen=True)
class PropagationCost:
    """One way to a pointwise band from some of the draws, against percept's band from all of them."""

    environment: Annotated[str, "Whose next user."]
    way: Annotated[
        str,
        "percept: the law of (k, b) given each draw of the scales. draws: np.quantile of curves, "
        "four draws of (k, b) for each draw of the scales.",
    ]
    draws: Annotated[int, "Draws of the scales."]
    seconds: Annotated[float, "Processor time: median of the repeats."]
    seconds_low: Annotated[float, "The shortest."]
    seconds_high: Annotated[float, "The longest."]
    stated: Annotated[
        float | None,
        "Root mean square over omega and both limits of the stated Monte Carlo error, as a fraction of the "
        "band's half-width in log abs(Z_h).",
    ]
    falls: Annotated[
        float | None, "The stated error of a sixteenth of these draws over this one: 4 in theory."
    ]
    difference: Annotated[float, "Root mean square difference from the band of all draws, as that fraction."]


def propagation_costs(
    device: AnyDevice,
    mean: Array,
    covariance: Array,
    period: float,
    *,
    name: str = "",
    level: float = 0.99,
    frequencies: tuple[float, float, int] = _EVERY,
    repeats: int = 3,
    seed: int = 1,
) -> list[PropagationCost]:
    """Time both ways on normals of the logarithms of (k, b), means (S, 2) and covariances (S, 2, 2)."""
    omega, rng = np.geomspace(*frequencies), np.random.default_rng(seed)
    # In another order: what neighbours share is then spread over the batches.
    order = rng.permutation(len(mean))
    mean, root = mean[order], np.linalg.cholesky(covariance[order])
    covariance = covariance[order]

    def law(count: int) -> tuple[Array, Array | None]:
        batch = np.arange(count) * _BATCHES // count
        found = mixture_law(mean[:count], covariance[:count], batch, "lognormal")
        limits = Magnitude(found, device, period, omega).limits(level)
        return np.log([limits.lower, limits.upper]), limits.errors

    def curves(count: int) -> tuple[Array, Array | None]:
        z = rng.standard_normal((_REPEATS, count, 2))
        k, b = np.exp(mean[:count] + np.einsum("sij,rsj->rsi", root[:count], z)).reshape(-1, 2).T
        drawn = perceived_magnitude(omega[:, None], device, k, b, period)
        return np.log(np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)], axis=1)), None

    ways: list[tuple[str, int, Callable[[], tuple[Array, Array | None]]]] = [
        (way, len(mean) // part, partial(work, len(mean) // part))
        for way, work in (("percept", law), ("draws", curves))
        for part in _PARTS
        if len(mean) // part >= _BATCHES
    ]
    runs = [(way, count, *timed(work, repeats)) for way, count, work in ways]
    band = next(found[0] for way, count, found, _ in runs if (way, count) == ("percept", len(mean)))
    half_width = 0.5 * (band[1] - band[0])
    known: dict[int, float] = {}
    costs = []
    for way, count, (limits, errors), seconds in runs:
        stated = None if errors is None else _size(errors / half_width)
        if stated is not None:
            known[len(mean) // count] = stated
        costs.append(
            PropagationCost(
                environment=name,
                way=way,
                draws=count,
                seconds=median(seconds),
                seconds_low=min(seconds),
                seconds_high=max(seconds),
                stated=stated,
                falls=None,
                difference=_size((limits - band) / half_width),
            )
        )
    return [_with_fall(cost, known, len(mean)) for cost in costs]


def _with_fall(cost: PropagationCost, known: dict[int, float], draws: int) -> PropagationCost:
    """Set the error of a sixteenth of the draws beside that of all of them."""
    fewer = known.get(16 * (draws // cost.draws))
    if cost.stated is None or fewer is None:
        return cost
    return PropagationCost(**{**vars(cost), "falls": fewer / cost.stated})


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY, repeats: int = 3
) -> list[PropagationCost]:
    """Time both ways on the next user of every environment of a study."""
    fit, setup = study.fit, study.setup
    assert fit is not None
    assert setup is not None
    assert isinstance(fit.model, Pooled)
    mean, own, users = fit.model.pairs(fit.points)
    costs: list[PropagationCost] = []
    for j, name in enumerate(fit.environments):
        origin = fit.scale.origin[[fit.column[parameter, name] for parameter in ("k", "b")]]
        costs += propagation_costs(
            setup.device, np.log(origin) + mean[:, j], own[:, j] + users[:, j], setup.period,
            name=name, level=study.scene.inference.level, frequencies=frequencies, repeats=repeats,
        )  # fmt: skip
    return costs
