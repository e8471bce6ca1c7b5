"""What pointwise curves of a law of (k, b) cost, and how their error falls with the posterior draws."""

from __future__ import annotations

import time
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.boundary.law import mixture_law
from percept.boundary.limits import Magnitude

if TYPE_CHECKING:
    from percept.haptics.records import AnyDevice
    from percept.study import Study

Array: TypeAlias = NDArray[np.float64]
#: Frequencies of the bands: first and last, rad/s, and how many.
_EVERY = (0.1, 100.0, 121)
#: Into how many sets the draws are cut.
_SETS = (16, 4, 1)
#: Draws of a batch: an error from many batches has little scatter of its own.
_BATCH = 16


@dataclass(frozen=True)
class PropagationCost:
    """A pointwise band from sets of the draws of the scales, against the band from all of them."""

    environment: Annotated[str, "Whose band."]
    kind: Annotated[str, "Of the average user, or of the next one."]
    sets: Annotated[int, "Sets the draws are cut into: figures are root mean squares over them."]
    draws: Annotated[int, "Draws of a set."]
    seconds: Annotated[float, "Processor time of one band: median of the sets."]
    stated: Annotated[
        float,
        "Root mean square over omega and both limits of the stated Monte Carlo error, as a fraction"
        " of the half-width in log abs(Z_h) of the band from all draws.",
    ]
    difference: Annotated[
        float, "Root mean square difference from the band from all draws, as that fraction."
    ]
    falls: Annotated[
        float, "The stated error of a sixteenth of all draws over that of these: 4 for all."
    ]


def propagation_costs(
    device: AnyDevice,
    period: float,
    pairs: tuple[Array, Array],
    *,
    name: str = "",
    kind: str = "user",
    level: float = 0.99,
    frequencies: tuple[float, float, int] = _EVERY,
) -> list[PropagationCost]:
    """Time bands of normals of the logarithms of (k, b), means (S, 2) and covariances (S, 2, 2)."""
    mean, covariance = pairs
    omega = np.geomspace(*frequencies)
    # In another order: what neighbours share is then spread over sets and batches.
    order = np.random.default_rng(1).permutation(len(mean))

    def band(chosen: NDArray[np.intp]) -> tuple[Array, Array, float]:
        started = time.process_time()
        law = mixture_law(
            mean[chosen], covariance[chosen], np.arange(chosen.size) // _BATCH, "lognormal"
        )
        limits = Magnitude(law, device, period, omega).limits(level)
        assert limits.errors is not None
        return np.log([limits.lower, limits.upper]), limits.errors, time.process_time() - started

    whole = band(order)[0]
    half_width = 0.5 * (whole[1] - whole[0])
    costs: list[PropagationCost] = []
    for sets in _SETS:
        found, errors, seconds = zip(*map(band, np.array_split(order, sets)), strict=True)
        stated, difference = (
            float(np.sqrt(np.mean((np.array(values) / half_width) ** 2)))
            for values in (errors, np.array(found) - whole)
        )
        falls = (costs[0].stated if costs else stated) / stated
        size = len(mean) // sets
        costs.append(
            PropagationCost(name, kind, sets, size, median(seconds), stated, difference, falls)
        )
    return costs


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY
) -> list[PropagationCost]:
    """Time the bands of every environment of a study, of the average user and of the next one."""
    fit, setup = study.fit, study.setup
    assert fit is not None
    assert setup is not None
    ((density, points),) = fit.model.pooled_parts(fit.points)
    pairs = density.pairs(points)
    costs: list[PropagationCost] = []
    for j, name in enumerate(fit.environments):
        origin = fit.scale.origin[[fit.column[parameter, name] for parameter in ("k", "b")]]
        location = pairs.location[:, j]
        for kind, covariance in (("mean", location), ("user", location + pairs.users[:, j])):
            costs += propagation_costs(
                setup.device, setup.period, (np.log(origin) + pairs.mean[:, j], covariance),
                name=name, kind=kind, level=study.scene.inference.level, frequencies=frequencies,
            )  # fmt: skip
    return costs
