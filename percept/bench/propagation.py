"""What pointwise curves of a law of (k, b) cost, and how their error falls with the posterior draws."""

from __future__ import annotations

import dataclasses
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.bench.measure import timed
from percept.boundary.law import mixture_law
from percept.boundary.limits import Magnitude
from percept.haptics import AnyDevice
from percept.inference.hierarchy.models import Pooled

if TYPE_CHECKING:
    from percept.study import Study

Array: TypeAlias = NDArray[np.float64]
#: Frequencies of the bands: first and last, rad/s, and how many.
_EVERY = (0.1, 100.0, 121)
#: Into how many sets the draws are cut.
_SETS = (16, 4, 1)
#: Draws of a batch: an error from many batches has little scatter of its own.
_BATCH = 16


@dataclasses.dataclass(frozen=True)
class PropagationCost:
    """A pointwise band from sets of the draws of the scales, against the band from all of them."""

    environment: Annotated[str, "Whose band."]
    kind: Annotated[str, "Of the average user, or of the next one."]
    sets: Annotated[int, "Sets the draws are cut into: figures are root mean squares over them."]
    draws: Annotated[int, "Draws of a set."]
    seconds: Annotated[float, "Processor time of one band: median of the sets."]
    stated: Annotated[
        float,
        "Root mean square over omega and both limits of the stated Monte Carlo error, as a fraction of the "
        "half-width in log abs(Z_h) of the band from all draws.",
    ]
    difference: Annotated[
        float, "Root mean square difference from the band from all draws, as that fraction."
    ]
    falls: Annotated[
        float | None, "The stated error of a sixteenth of these draws over that of these: 4 in theory."
    ] = None


def propagation_costs(
    device: AnyDevice,
    mean: Array,
    covariance: Array,
    period: float,
    *,
    name: str = "",
    kind: str = "user",
    level: float = 0.99,
    frequencies: tuple[float, float, int] = _EVERY,
    seed: int = 1,
) -> list[PropagationCost]:
    """Time bands of normals of the logarithms of (k, b), means (S, 2) and covariances (S, 2, 2)."""
    omega = np.geomspace(*frequencies)
    # In another order: what neighbours share is then spread over sets and batches.
    order = np.random.default_rng(seed).permutation(len(mean))

    def band(chosen: NDArray[np.intp]) -> tuple[Array, Array]:
        batch = np.arange(chosen.size) // _BATCH
        law = mixture_law(mean[chosen], covariance[chosen], batch, "lognormal")
        limits = Magnitude(law, device, period, omega).limits(level)
        assert limits.errors is not None
        return np.log([limits.lower, limits.upper]), limits.errors

    whole, _ = band(order)
    half_width = 0.5 * (whole[1] - whole[0])
    costs: list[PropagationCost] = []
    for sets in _SETS:
        runs = [timed(partial(band, chosen), 1) for chosen in np.array_split(order, sets)]
        found, errors = (np.array(part) for part in zip(*(run[0] for run in runs), strict=True))
        costs.append(
            PropagationCost(
                environment=name,
                kind=kind,
                sets=sets,
                draws=len(mean) // sets,
                seconds=median(run[1][0] for run in runs),
                stated=_size(errors / half_width),
                difference=_size((found - whole) / half_width),
            )
        )
    return [*costs[:-1], dataclasses.replace(costs[-1], falls=costs[0].stated / costs[-1].stated)]


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY
) -> list[PropagationCost]:
    """Time the bands of every environment of a study, of the average user and of the next one."""
    fit, setup = study.fit, study.setup
    assert fit is not None
    assert setup is not None
    assert isinstance(fit.model, Pooled)
    mean, own, users = fit.model.pairs(fit.points)
    costs: list[PropagationCost] = []
    for j, name in enumerate(fit.environments):
        origin = fit.scale.origin[[fit.column[parameter, name] for parameter in ("k", "b")]]
        for kind, covariance in (("mean", own[:, j]), ("user", own[:, j] + users[:, j])):
            costs += propagation_costs(
                setup.device, np.log(origin) + mean[:, j], covariance, setup.period,
                name=name, kind=kind, level=study.scene.inference.level, frequencies=frequencies,
            )  # fmt: skip
    return costs
