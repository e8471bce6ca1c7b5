"""What pointwise curves of a law of (k, b) cost, and how their error falls with the draws."""

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

__all__ = ["PropagationCost", "propagation_costs", "study_propagation"]

Array: TypeAlias = NDArray[np.float64]

_EVERY = (0.1, 100.0, 121)  # Frequencies of the bands: first and last, rad/s, and how many
_SETS = (16, 4, 1)  # Into how many sets the draws are cut
_BATCH = 16  # Draws of a batch: an error from many batches has little scatter of its own


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
    """Time bands of a law of (k, b) from sets of its draws.

    Parameters
    ----------
    device : Device
        What the hand holds.
    period : float
        T, s.
    pairs : pair of ndarray
        Normal laws of the logarithms of (k, b), a draw of the scales each: means (S, 2) and
        covariances (S, 2, 2).
    name, kind : str
        Of the rows.
    level : float
        Of the bands.
    frequencies : tuple
        First and last, rad/s, and how many.

    Returns
    -------
    list of PropagationCost
        A row for each number of sets.
    """
    mean, covariance = pairs
    omega = np.geomspace(*frequencies)
    # In another order: what neighbours share is then spread over sets and batches.
    order = np.random.default_rng(1).permutation(len(mean))

    def band(chosen: NDArray[np.intp]) -> _Band:
        started = time.process_time()
        batch = np.arange(chosen.size) // _BATCH
        law = mixture_law(mean[chosen], covariance[chosen], batch, "lognormal")
        limits = Magnitude(law, device, period, omega).limits(level)
        assert limits.errors is not None
        seconds = time.process_time() - started
        return _Band(np.log([limits.lower, limits.upper]), limits.errors, seconds)

    whole = band(order).limits
    half_width = 0.5 * (whole[1] - whole[0])
    costs: list[PropagationCost] = []
    for sets in _SETS:
        bands = [band(chosen) for chosen in np.array_split(order, sets)]
        stated = _root_mean_square([each.errors / half_width for each in bands])
        difference = _root_mean_square([(each.limits - whole) / half_width for each in bands])
        falls = costs[0].stated / stated if costs else 1.0
        seconds = median(each.seconds for each in bands)
        size = len(mean) // sets
        costs.append(PropagationCost(name, kind, sets, size, seconds, stated, difference, falls))
    return costs


@dataclass(frozen=True, eq=False)
class _Band:
    limits: Array  # (2, omega) of log abs(Z_h)
    errors: Array  # Of the same shape
    seconds: float


def _root_mean_square(values: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def study_propagation(
    study: Study, *, frequencies: tuple[float, float, int] = _EVERY
) -> list[PropagationCost]:
    """Time the bands of every environment of a study, of the average user and of the next one.

    Parameters
    ----------
    study : Study
        With a device and a fit of stiffness and damping.
    frequencies : tuple
        First and last, rad/s, and how many.

    Returns
    -------
    list of PropagationCost
        Environment by environment.
    """
    fit = study.parts.fit
    setup = study.parts.setup
    assert fit is not None
    assert setup is not None
    ((density, points),) = fit.model.pooled_parts(fit.points)
    pairs = density.pairs(points)
    costs: list[PropagationCost] = []
    for j, name in enumerate(fit.environments):
        cells = [fit.column[parameter, name] for parameter in ("k", "b")]
        centre = np.log(fit.scale.origin[cells]) + pairs.mean[:, j]
        location = pairs.location[:, j]
        laws = {"mean": location, "user": location + pairs.users[:, j]}
        for kind, covariance in laws.items():
            costs += propagation_costs(
                setup.device,
                setup.period,
                (centre, covariance),
                name=name,
                kind=kind,
                level=study.scene.inference.level,
                frequencies=frequencies,
            )
    return costs
