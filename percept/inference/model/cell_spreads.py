"""Log SDs of all cells at one level, between subjects or between trials, from their coordinates.

Log SDs follow K columns (a level, a trend over the references, contrasts of factors) and scatter
about them with the SD omega. Each quantity has a map: `TrendMap` for up to two columns and
`LogLinear` for more. The rough likelihood of the second quantity moves with the log SDs of the
first, as `RoughLikelihood` says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.design import LEVEL, TREND, Design
from percept.inference.model.log_linear import LogLinear, LogSpreads
from percept.inference.model.priors import Priors
from percept.inference.model.rough_likelihood import likelihood_between, likelihood_of_trials
from percept.inference.model.statistics import Statistics
from percept.inference.model.trend_map import TrendMap

__all__ = ["CellSpreads", "numbered"]

Array = NDArray[np.float64]

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

    def __init__(self, statistics: Statistics, design: Design, priors: Priors, suffix: str) -> None:
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
