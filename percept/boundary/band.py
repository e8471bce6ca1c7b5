"""The band against the environment's impedance, or a reference of another quantity: how wide, by what law.

Three laws are fitted on the log scale to many sets of bands at once. Weber: w|Z|. Offset: c + w|Z|,
c ≥ 0. Power: w|Z|^p. Each is a model of its own: a few environments cannot tell all of c, w and p
apart.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import elementwise

from percept.html import NotebookRecord

Array = NDArray[np.float64]

# Parameters of each law, in order.
LAWS: dict[str, tuple[str, ...]] = {"weber": ("w",), "offset": ("c", "w"), "power": ("w", "p")}
_NAMES = {"weber": "Weber's law", "offset": "the law with an offset", "power": "the power law"}
_GRID = 61
# Without an environment an offset counts as gone below this fraction of what it was.
_GONE = 0.1
# Log of the factor a law may be off by and still be said to predict anything.
_OF_NO_USE = math.log(10.0)
# Laws within this factor in leave-one-out error are called equal.
_ALIKE = 1.25
# Impedances within this share of each other leave an exponent to rounding.
_EQUAL = 1e-9


@dataclasses.dataclass(frozen=True)
class Estimate(NotebookRecord):
    """A number with its interval."""

    value: float
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Whose(NotebookRecord):
    """Whose bands are spoken of."""

    method: str
    kind: str
    family: str
    parameter: str | None = None  # Whose bands lie against its own reference; None for abs(Z_e)


@dataclasses.dataclass(frozen=True, kw_only=True)
class BandLaw(_Whose):
    """A law fitted to bands over environments."""

    model: str  # "weber": band = w |Z|
    parameters: dict[str, Estimate]  # By name
    level: float  # Of the parameters' intervals: of posterior draws, or of a parametric bootstrap
    sentence: str  # What the law says
    left_out_error: float
    best: float  # Share of the draws in which this law has the smallest such error of the three
    carried_by: str | None = None  # The one environment without which the offset all but vanishes


@dataclasses.dataclass(frozen=True, kw_only=True)
class BandStatement(_Whose):
    """A statement on bands, with the probability that it is true."""

    statement: str  # In words
    probability: float  # Share of the posterior draws, or of the bootstrap's


@dataclasses.dataclass(frozen=True, eq=False)
class BandStudy(NotebookRecord):
    """Bands of the device-free environment impedance, or of other quantities, and their laws."""

    omega: float | None  # rad/s; None where the quantities make no impedance
    rows: pd.DataFrame
    laws: tuple[BandLaw, ...]  # Three per method, kind and family, with at least three environments
    statements: tuple[BandStatement, ...] = ()
    kappa: pd.DataFrame | None = None


def band_laws(
    environments: tuple[str, ...],
    impedance: Array,
    bands: Array | None,
    replicates: Array,
    *,
    level: float,
    parameter: str | None = None,
    **whose: str,
) -> Iterator[BandLaw]:
    """Fit the three laws, each with intervals, leave-one-environment-out error and what it rests on.

    An estimate is that of the study's bands, or without them the median of the draws'.
    """
    drawn = {law: fit_law(law, impedance, replicates) for law in LAWS}
    left_out = {law: leave_one_out(law, impedance, replicates) for law in LAWS}
    errors = np.stack([np.sqrt((error**2).mean(axis=1)) for error, _ in left_out.values()])
    typical = dict(zip(LAWS, np.median(errors, axis=1).tolist(), strict=True))
    best = np.bincount(errors.argmin(axis=0), minlength=3) / errors.shape[1]
    carrier = _carrier(environments, drawn["offset"], left_out["offset"][1])
    for (law, names), share in zip(LAWS.items(), best.tolist(), strict=True):
        value = (
            np.median(drawn[law], axis=0)
            if bands is None
            else fit_law(law, impedance, bands[None])[0]
        )
        lower, upper = np.quantile(drawn[law], [0.5 * (1.0 - level), 0.5 * (1.0 + level)], axis=0)
        ends = zip(value.tolist(), lower.tolist(), upper.tolist(), strict=True)
        parameters = {name: Estimate(*estimate) for name, estimate in zip(names, ends, strict=True)}
        carried = carrier if law == "offset" else None
        sentence = _sentence(law, parameters, typical, carried, size_name(parameter))
        yield BandLaw(
            model=law, parameters=parameters, level=level, sentence=sentence, left_out_error=typical[law],
            best=share, carried_by=carried, parameter=parameter, **whose,
        )  # fmt: skip


def band_statements(
    impedance: Array, replicates: Array, *, parameter: str | None = None, **whose: str
) -> Iterator[BandStatement]:
    """Judge two statements on discrimination at low against high impedance."""
    size = size_name(parameter)
    order = np.argsort(impedance)
    absolute = replicates[:, order]
    relative = absolute / impedance[order]
    ends = f"The band is narrower at the lowest {size} than at the highest"
    for text, true in (
        (f"{ends} (absolute width).", absolute[:, 0] < absolute[:, -1]),
        (f"{ends}, relative to the {size}.", relative[:, 0] < relative[:, -1]),
        (
            f"The band widens from each environment to the next higher {size} (absolute width).",
            np.all(np.diff(absolute, axis=1) > 0, axis=1),
        ),
    ):
        yield BandStatement(
            statement=text, probability=float(np.mean(true)), parameter=parameter, **whose
        )


def _carrier(environments: tuple[str, ...], fitted: Array, without: Array) -> str | None:
    """Name the environment without which the typical offset is a tenth of what it was, if just one is."""
    whole = float(np.median(fitted[:, 0]))
    left = np.median(without[:, :, 0], axis=1)
    gone = np.flatnonzero(left < _GONE * whole) if whole > 0 else np.empty(0, dtype=int)
    return environments[int(gone[0])] if gone.size == 1 else None


def _sentence(
    law: str,
    parameters: dict[str, Estimate],
    errors: dict[str, float],
    carried_by: str | None,
    size: str,
) -> str:
    smallest = min(errors.values())
    alike = [name for name, error in errors.items() if error <= _ALIKE * smallest]
    rank = "no law of the three does clearly better" if law in alike else "another law does better"
    off = f"{_NAMES[law]} is typically off by a factor {math.exp(errors[law]):.3g}"
    error = f"With one environment left out, {off}; {rank}."
    if not smallest < _OF_NO_USE:
        error = "With one environment left out, no law predicts the band to within a factor of ten."
    if law == "weber":
        return f"The band is {parameters['w'].value:.3g} times the {size}. {error}"
    if law == "offset":
        on = f" The offset rests on {carried_by} alone." if carried_by else ""
        c, w = parameters["c"], parameters["w"]
        if c.value == 0.0:
            return f"The offset vanishes, and the band is {w.value:.3g} times the {size}. {error}"
        reaching = ", whose interval reaches zero," if c.lower <= 0.0 else ""
        return f"The band is an offset{reaching} and a share of the {size}. {error}{on}"
    p = parameters["p"]
    if p.lower <= 1.0 <= p.upper:
        return f"The exponent's interval holds 1: Weber's law is not ruled out. {error}"
    growing = "faster" if p.lower > 1.0 else "slower"
    return (
        f"The band grows {growing} than the {size}: the exponent's interval does not hold 1."
        f" {error}"
    )


def size_name(parameter: str | None) -> str:
    """Name what bands lie against: the impedance, or the reference of a quantity."""
    return "impedance" if parameter is None else "reference"


def determines_laws(sizes: ArrayLike) -> bool:
    """Whether environments of these sizes determine every law without any one of them."""
    every = np.asarray(sizes, dtype=float)
    rest = (np.delete(every, j) for j in range(every.size))
    return every.size >= 3 and all(np.ptp(others) > _EQUAL * others.max() for others in rest)


def fit_law(law: str, impedance: Array, bands: Array) -> Array:
    """Fit a law to bands (S, J) over sizes (J,) that determine it, by least squares on the logarithms."""
    y = np.log(bands)
    if law == "weber":
        return np.exp((y - np.log(impedance)).mean(axis=1))[:, None]
    if law == "power":
        x = np.log(impedance)
        centred = x - x.mean()
        exponent = y @ centred / (centred @ centred)
        return np.stack([np.exp(y.mean(axis=1) - exponent * x.mean()), exponent], axis=1)
    return _fit_offset(impedance, y)


def law_band(law: str, parameters: Array, impedance: Array) -> Array:
    """Bands of fitted laws, shape (S, J)."""
    named = dict(zip(LAWS[law], parameters.T[..., None], strict=True))
    return named.get("c", 0.0) + named["w"] * impedance ** named.get("p", 1.0)


def leave_one_out(law: str, impedance: Array, bands: Array) -> tuple[Array, Array]:
    """Predict each environment's band from the others: log errors (S, J), and the laws fitted (J, S, ...)."""
    fits = [
        fit_law(law, np.delete(impedance, j), np.delete(bands, j, axis=1))
        for j in range(impedance.size)
    ]
    predicted = [law_band(law, fitted, impedance[[j]])[:, 0] for j, fitted in enumerate(fits)]
    return np.log(np.stack(predicted, axis=1) / bands), np.stack(fits)


def _fit_offset(impedance: Array, y: Array) -> Array:
    """Minimise over the ratio c/w: given it, log w is a mean, so one search for all sets at once."""
    # From e^16 on, c + w|Z| is constant to the digits a band has.
    grid = np.linspace(np.log(impedance.min()) - 12.0, np.log(impedance.max()) + 16.0, _GRID)
    # The grid is the same for all sets: of the squared distances only the product with it differs.
    # The digits this loses could at most choose a neighbouring step, which the brackets hold as
    # well.
    curves = np.log(np.exp(grid)[:, None] + impedance)
    curves -= curves.mean(axis=1, keepdims=True)
    best = (np.einsum("gj,gj->g", curves, curves) - 2.0 * y @ curves.T).argmin(axis=1)
    every = np.arange(len(y))

    def misfit(log_ratio: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Half the squared distance, and its slope: the minimum itself is flat, and gives half the digits."""
        offset = np.exp(log_ratio)[:, None]
        off = y[which] - np.log(offset + impedance)
        off -= off.mean(axis=1, keepdims=True)
        slope = -np.einsum("sj,sj->s", off, offset / (offset + impedance))
        return 0.5 * np.einsum("sj,sj->s", off, off), slope

    def slope(log_ratio: Array, which: NDArray[np.intp]) -> Array:
        return misfit(log_ratio, which)[1]

    step = grid[1] - grid[0]
    left, right = grid[best] - step, grid[best] + step
    rises, falls = slope(left, every) >= 0, slope(right, every) <= 0
    minimum = np.where(rises, left, right)
    turns = np.flatnonzero(~rises & ~falls)
    if turns.size:
        minimum[turns] = elementwise.find_root(slope, (left[turns], right[turns]), args=(turns,)).x
    # No offset at all may fit best: the search runs in the logarithm, which never gets there.
    none = misfit(np.full(len(y), -np.inf), every)[0] <= misfit(minimum, every)[0]
    ratio = np.where(none, 0.0, np.exp(minimum))
    w = np.exp((y - np.log(ratio[:, None] + impedance)).mean(axis=1))
    return np.stack([ratio * w, w], axis=1)
