"""The band against the environment's impedance, or another quantity's reference: width and law.

Three laws are fitted on the log scale to many sets of bands at once. Weber: w|Z|. Offset: c + w|Z|,
c ≥ 0. Power: w|Z|^p. Each is a model of its own: a few environments cannot tell all of c, w and p
apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.inference.record import Family, Method
from percept.results import BandLaw, Coefficient
from percept.searches import secant_root

Array = NDArray[np.float64]

#: Parameters of each law, in order.
LAWS: dict[str, tuple[str, ...]] = {"weber": ("w",), "offset": ("c", "w"), "power": ("w", "p")}
_NAMES = {"weber": "Weber's law", "offset": "the law with an offset", "power": "the power law"}
# Ratios c/w at which the search for an offset starts: each some 1.6 times the last.
_GRID_POINTS = 61
# How far they reach below the smallest size, in log(c/w): an offset there is none.
_BELOW = 12.0
# And so far above the largest: from e^16 on, c + w|Z| is constant to the digits a band has.
_ABOVE = 16.0
# Without an environment an offset counts as gone below this fraction of what it was.
_GONE = 0.1
# Log of the factor a law may be off by and still be said to predict anything.
_OF_NO_USE = math.log(10.0)
# Laws within this factor in leave-one-out error are called equal.
_ALIKE = 1.25
# Errors within this factor are one but for rounding: offsets and powers both pass through two
# sizes. The first law counts.
_TIED = 1.0 + 1e-6
# Bands that laws are fitted to with environments left out, at most. Of 160 environments a twelfth
# of the replicates are left, which is enough for medians.
_MOST_REFITTED = 1 << 21
#: Sizes that differ by a smaller share count as one: an exponent would divide scatter of the bands
#: by a difference of next to nothing, and its powers overflow.
_EQUAL = 0.05


@dataclass(frozen=True, kw_only=True)
class BandOwner:
    """Whose bands are spoken of."""

    method: Method
    family: Family
    parameter: str | None = None  # Whose bands lie against its own reference; None for abs(Z_e)


def band_laws(
    environments: tuple[str, ...],
    sizes: Array,
    bands: Array | None,
    replicates: Array,
    whose: BandOwner,
    *,
    level: float,
) -> Iterator[BandLaw]:
    """Fit the three laws, each with intervals, error of environments left out and what it rests on.

    Parameters
    ----------
    environments : tuple of str
        J names.
    sizes : ndarray, shape (J,)
        Impedances or references that bands lie against.
    bands : ndarray, shape (J,), or None
        The study's bands, from which the estimates come; None for the median of the replicates'.
    replicates : ndarray, shape (S, J)
        Bands of other studies, or of posterior draws.
    whose : BandOwner
        Method and family of the bands.
    level : float
        Of the parameters' intervals.

    Yields
    ------
    BandLaw
        One of each law. There is none where any law, fitted to sizes close together, leaves the
        range of doubles.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        drawn = {}
        without = {}
        errors = []
        refitted = replicates.size * len(sizes)
        gap = max(1, refitted // _MOST_REFITTED)
        for law in LAWS:
            drawn[law] = fit_law(law, sizes, replicates)
            error, without[law] = leave_one_out(law, sizes, replicates[::gap])
            squares = (error**2).mean(axis=1)
            errors.append(np.sqrt(squares))
    if not np.isfinite(errors).all():
        return
    medians = np.median(errors, axis=1).tolist()
    typical = dict(zip(LAWS, medians, strict=True))
    least = np.min(errors, axis=0)
    winners = np.argmax(errors <= _TIED * least, axis=0)
    carrier = _carrier(environments, drawn["offset"], without["offset"])
    tails = [0.5 * (1.0 - level), 0.5 * (1.0 + level)]
    for index, (law, names) in enumerate(LAWS.items()):
        values = np.median(drawn[law], axis=0)
        if bands is not None:
            values = fit_law(law, sizes, bands[None])[0]
        found = np.vstack([values, np.quantile(drawn[law], tails, axis=0)]).T.tolist()
        parameters = {name: Coefficient(*of_one) for name, of_one in zip(names, found, strict=True)}
        size = size_name(whose.parameter)
        left_out_sentence = _error_sentence(law, typical)
        yield BandLaw(
            **vars(whose),
            model=law,
            parameters=parameters,
            sentence=_sentence(law, parameters, left_out_sentence, carrier, size),
            left_out_error=typical[law],
            best=float(np.mean(winners == index)),
        )


def _carrier(environments: tuple[str, ...], fitted: Array, without: Array) -> str | None:
    """Name the one environment without which the typical offset is a tenth of what it was."""
    typical = float(np.median(fitted[:, 0]))
    if typical <= 0.0:
        return None
    typical_without = np.median(without[:, :, 0], axis=1)
    (carriers,) = np.nonzero(typical_without < _GONE * typical)
    if carriers.size != 1:
        return None
    return environments[carriers[0]]


def _sentence(
    law: str,
    parameters: dict[str, Coefficient],
    error: str,
    carried_by: str | None,
    size: str,
) -> str:
    """Say what a law found, and how well it predicts the environment left out."""
    if law == "weber":
        return f"The band is {parameters['w'].value:.3g} times the {size}. {error}"
    if law == "offset":
        c = parameters["c"]
        w = parameters["w"]
        if c.value == 0.0:
            return f"The offset vanishes, and the band is {w.value:.3g} times the {size}. {error}"
        reaching = ", whose interval reaches zero," if c.lower <= 0.0 else ""
        on = f" The offset rests on {carried_by} alone." if carried_by else ""
        return f"The band is an offset{reaching} and a share of the {size}. {error}{on}"
    p = parameters["p"]
    if p.lower <= 1.0 <= p.upper:
        return f"The exponent's interval holds 1: Weber's law is not ruled out. {error}"
    growing = "faster" if p.lower > 1.0 else "slower"
    grows = f"The band grows {growing} than the {size}"
    return f"{grows}: the exponent's interval does not hold 1. {error}"


def _error_sentence(law: str, errors: dict[str, float]) -> str:
    """Say how far a law is off from a band left out, and how the others compare."""
    smallest, second, _ = sorted(errors.values())
    if not smallest < _OF_NO_USE:
        return "With one reference left out, no law predicts the band to within a factor of ten."
    rank = "another law does better"
    if errors[law] <= _ALIKE * smallest:
        rank = "no other law does clearly better"
    if errors[law] == smallest and second > _ALIKE * smallest:
        rank = "it is ahead of both other laws"
    typically = f"{_NAMES[law]} is typically off by a factor {math.exp(errors[law]):.3g}"
    return f"With one reference left out, {typically}; {rank}."


def size_name(parameter: str | None) -> str:
    """Name what bands lie against: the impedance, or the reference of a quantity."""
    return "impedance" if parameter is None else "reference"


def determines_laws(sizes: ArrayLike) -> bool:
    """Whether environments of these sizes determine every law without any one reference."""
    values = np.asarray(sizes, dtype=float)
    if values.size < 3:
        return False
    for left_out in range(values.size):
        others = np.delete(values, left_out)
        if not np.ptp(others) > _EQUAL * others.max():
            return False
    return True


def fit_law(law: str, impedance: Array, bands: Array) -> Array:
    """Fit a law to bands (S, J) over sizes (J,) by least squares on the logarithms."""
    x = np.log(impedance)
    y = np.log(bands)
    if law == "offset":
        return _fit_offset(impedance, y)
    if law == "weber":
        log_w = (y - x).mean(axis=1)
        return np.exp(log_w)[:, None]
    centred = x - x.mean()
    exponent = y @ centred / (centred @ centred)
    log_w = y.mean(axis=1) - exponent * x.mean()
    return np.stack([np.exp(log_w), exponent], axis=1)


def law_band(law: str, parameters: Array, impedance: Array) -> Array:
    """Bands of fitted laws, shape (S, J)."""
    by_name = dict(zip(LAWS[law], parameters.T[..., None], strict=True))
    offset = by_name.get("c", 0.0)
    exponent = by_name.get("p", 1.0)
    return offset + by_name["w"] * impedance**exponent


def leave_one_out(law: str, impedance: Array, bands: Array) -> tuple[Array, Array]:
    """Predict each band from the others: log errors (S, J), and the laws fitted (J, S, ...)."""
    fits = []
    predicted = []
    for j in range(impedance.size):
        other_sizes = np.delete(impedance, j)
        other_bands = np.delete(bands, j, axis=1)
        fitted = fit_law(law, other_sizes, other_bands)
        fits.append(fitted)
        predicted.append(law_band(law, fitted, impedance[[j]]))
    ratio = np.concatenate(predicted, axis=1) / bands
    return np.log(ratio), np.stack(fits)


def _fit_offset(impedance: Array, log_bands: Array) -> Array:
    """Minimise over the ratio c/w: given it, log w is a mean; one search for all sets."""
    lowest = np.log(impedance.min()) - _BELOW
    highest = np.log(impedance.max()) + _ABOVE
    grid = np.linspace(lowest, highest, _GRID_POINTS)

    def misfit(ratio: Array) -> Array:
        """Return the squared distance of each set (S,) at its ratio (S, 1)."""
        return (log_bands - np.log(ratio + impedance)).var(axis=1)

    def slope(which: NDArray[np.intp], log_ratio: Array) -> Array:
        """Return the slope of half of it, whose zero has twice the digits of its minimum."""
        offset = np.exp(log_ratio)[:, None]
        size = offset + impedance
        residual = log_bands[which] - np.log(size)
        residual -= residual.mean(axis=1, keepdims=True)
        return -np.einsum("sj,sj->s", residual, offset / size)

    shapes = np.log(np.exp(grid)[:, None] + impedance)
    shapes -= shapes.mean(axis=1, keepdims=True)
    # Squared distances of all sets at all ratios, less the squares of the bands alone.
    distance = (shapes**2).sum(axis=1) - 2.0 * log_bands @ shapes.T
    best = grid[distance.argmin(axis=1)]
    step = grid[1] - grid[0]
    minimum = secant_root(slope, best, best - step, best + step)
    # At an end of the grid nothing turns.
    ratio = np.exp(np.clip(minimum, lowest, highest))[:, None]
    # No offset at all may fit best: the search runs in the logarithm, which never gets there.
    ratio[misfit(np.zeros(1)) <= misfit(ratio)] = 0.0
    shape = np.log(ratio + impedance)
    w = np.exp((log_bands - shape).mean(axis=1))
    return np.stack([ratio[:, 0] * w, w], axis=1)
