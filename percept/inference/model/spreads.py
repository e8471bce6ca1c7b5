"""Log SDs of all cells at one level, between subjects or between trials, from their coordinates.

Log SDs follow K columns (a level, a trend over the references, contrasts of factors) and scatter
about them with the SD omega. Each quantity has a map: `TrendMap` for up to two columns and
`LogLinear` for more. The rough likelihood of the second quantity moves with the log SDs of the
first, as `RoughLikelihood` says.

`LogLinear` has log sigma = m + U h + omega e, U the columns, and h (K,) and e (C,) standard normal.
Given omega, a rough likelihood N(log sigma; l, diag(1/w)) of the data makes (h, e) normal once
more, and the coordinates (u, v) are its standardised form:

    q = w / (1 + w omega²)
    LL' = I + U' diag(q) U
    h = L'^-1 (L^-1 U' diag(q) (l - m) + u)
    e = omega q (l - m - U h) + v / sqrt(1 + w omega²)

The coordinates are then near standard normal under the posterior, whether omega is large or nearly
zero. The rough likelihood shapes the coordinates alone: their density under the prior is exact, the
normal density of h and e times the Jacobian prod(1 + w omega²)^(-1/2) / det L.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import log_diagonal, lower_factor, solve_lower, solve_upper
from percept.inference.model.design import LEVEL, TREND, Design
from percept.inference.model.priors import Priors
from percept.inference.model.rough import likelihood_between, likelihood_of_trials
from percept.inference.model.statistics import Statistics
from percept.inference.model.trend_map import LogSpreads, TrendMap

__all__ = ["CellSpreads", "numbered"]

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Columns that `TrendMap` takes. With two subjects its chains forget three times as fast as those
#: of `LogLinear` (autocorrelation 28 against 86 steps).
_TREND_COLUMNS = 2


def numbered(name: str, count: int) -> list[str]:
    """Names of the columns of a term: numbered where there are several."""
    if count == 1:
        return [name]
    return [f"{name}:{k + 1}" for k in range(count)]


class CellSpreads:
    """Map from coordinates to the log SDs of P quantities in C cells.

    Parameters
    ----------
    statistics : Statistics
        What the rough likelihood of the SDs is taken from.
    design : Design
        Its columns of log sigma, K in all.
    priors : Priors
        Prior scales.
    suffix : str
        Of names: "" between subjects, "_e" between trials.

    Attributes
    ----------
    coefficients : list of str
        Names of the coefficients of log sigma, one for each column.
    departures : bool
        Whether log SDs scatter about their columns.
    single_sd : float or None
        SD of that scatter without columns; otherwise it is estimated.
    follows_trend : bool
        Whether the coordinates of the coefficients are those of `TrendMap`.
    rho : str
        Name of the correlation of the level.
    weight : ndarray
        Weights of the rough likelihood, (P, C): a unit of the coordinates is shorter by
        √(1 + weight) than a prior SD.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors,
        suffix: str,
    ) -> None:
        terms = design.sd_trial if suffix else design.sd_between
        self.suffix = suffix
        self.rho = f"rho{suffix or '_w'}"
        self.coefficients = []
        names = {LEVEL: f"log_s{suffix}", TREND: f"kappa{suffix}"}
        for term in terms:
            name = names.get(term.name, f"psi{suffix}:{term.name}")
            self.coefficients += numbered(name, len(term.columns))
        self.departures = not terms or not design.options.common_spread
        log_s_sd = getattr(priors, f"log_s{suffix}_sd")
        self.single_sd = None if terms else log_s_sd
        self.follows_trend = len(self.coefficients) <= _TREND_COLUMNS
        self._centre = getattr(priors, f"log_s{suffix}_mean")
        columns = [term.columns for term in terms]
        nothing = np.zeros((0, *design.cells.x.shape))
        #: (P, K, C)
        self._loadings = np.moveaxis(np.concatenate([nothing, *columns]), 1, 0)
        if suffix:
            self._rough = likelihood_of_trials(statistics)
        else:
            self._rough = likelihood_between(
                statistics,
                self._loadings,
                self._centre,
                log_s_sd,
                subject_effect=bool(design.subject),
            )
        self.weight = self._rough.weight
        make = TrendMap if self.follows_trend else LogLinear
        self._maps = []
        for p, of_quantity in enumerate(self._loadings):
            of_map = make(self._centre, of_quantity, self._rough.mean[p], self.weight[p])
            self._maps.append(of_map)

    def __call__(
        self,
        columns: Array,
        cells: Array,
        omega: Array,
        shift: Array,
    ) -> LogSpreads:
        """Map coordinates to the spreads of W draws.

        Parameters
        ----------
        columns : ndarray
            Coordinates of the coefficients, (P, K, W).
        cells : ndarray
            Coordinates of the cells' departures from their columns, (P, C, W).
        omega : ndarray
            SDs of these departures, (P, W).
        shift : ndarray
            What is added to the means of the rough likelihood, (P, C or 1, W).
        """
        first = self._maps[0](columns[0], cells[0], omega[0], shift[0])
        if len(self._maps) == 1:
            return _stacked([first])
        by_first = self._rough.shift_of_second(first.log_sigma, shift[0])
        second = self._maps[1](columns[1], cells[1], omega[1], shift[1] + by_first)
        return _stacked([first, second])

    def without_departures(self, columns: Array) -> LogSpreads:
        """Map coordinates (P, K, W) of the coefficients alone, which are standard normal."""
        log_sigma = self._centre + np.einsum("pkc,pkw->pcw", self._loadings, columns)
        return LogSpreads(log_sigma, columns, np.zeros(columns.shape[-1]))


def _stacked(spreads: Sequence[LogSpreads]) -> LogSpreads:
    """Spreads of several quantities in one record: log SDs (P, C, W) and multiples (P, K, W)."""
    log_sigmas = [quantity.log_sigma for quantity in spreads]
    multiples = [quantity.multiples for quantity in spreads]
    log_densities = [quantity.log_density for quantity in spreads]
    return LogSpreads(
        log_sigma=np.stack(log_sigmas),
        multiples=np.stack(multiples),
        log_density=np.sum(log_densities, axis=0),
    )


class LogLinear:
    """Map from coordinates to the log SDs of one quantity at one level.

    The columns (K, C) are multiplied by their prior SDs. The rough likelihood is (C,); a cell of
    weight zero has none.
    """

    def __init__(
        self,
        centre: float,
        columns: Array,
        rough_mean: Array,
        rough_weight: Array,
    ) -> None:
        self.centre = centre
        self.columns = columns
        departure = np.where(rough_weight > 0, rough_mean - centre, 0.0)
        self._rough_departure = departure[:, None]  # l - m
        self._weight = rough_weight[:, None]
        products = columns[:, None] * columns[None]
        self._products = products.reshape(-1, columns.shape[1])

    def __call__(
        self,
        u: Array,
        v: Array,
        omega: Array,
        shift: Array | float = 0.0,
    ) -> LogSpreads:
        """Map coordinates u (K, W) and v (C, W), given omega (W,).

        The means of the rough likelihood are moved by a shift (C, W).
        """
        rough_departure = self._rough_departure + shift
        precision = 1.0 + self._weight * omega**2  # of e, given h
        weight = self._weight / precision  # q
        h, log_det_factor = self._coefficients(u, weight, rough_departure)
        middle = self.columns.T @ h
        e = omega * weight * (rough_departure - middle) + v / np.sqrt(precision)
        squares = np.einsum("kw,kw->w", h, h) + np.einsum("cw,cw->w", e, e)
        # The prior of h and e times the Jacobian of the map.
        log_precision = np.log(precision).sum(axis=0)
        log_density = -0.5 * (squares + log_precision) - log_det_factor
        log_density -= 0.5 * _LOG_2PI * (len(u) + len(v))
        return LogSpreads(self.centre + middle + omega * e, h, log_density)

    def _coefficients(
        self,
        u: Array,
        weight: Array,
        rough_departure: Array,
    ) -> tuple[Array, Array]:
        """Multiples h (K, W), and log det L (W,)."""
        size = len(u)
        precision = (self._products @ weight).reshape(size, size, -1)
        diagonal = np.arange(size)
        precision[diagonal, diagonal] += 1.0
        factor = lower_factor(precision)
        right = self.columns @ (weight * rough_departure)
        # mean + L'^-1 u with the mean L'^-1 L^-1 right, in one solution.
        whitened_mean = solve_lower(factor, right)
        return solve_upper(factor, whitened_mean + u), log_diagonal(factor)
