"""Log SDs of all cells at one level, between subjects or between trials, from their coordinates.

Each quantity has a `LogLinear` map. The rough likelihood of the second quantity moves with the log
SDs of the first, as `RoughLikelihood` says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.design import LEVEL, TREND, Term
from percept.inference.hierarchy.log_linear import LogLinear, LogSpreads
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.rough_likelihood import likelihood_between, likelihood_of_trials
from percept.inference.hierarchy.spreads import stacked
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["CellSpreads", "numbered"]

Array = NDArray[np.float64]


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
    terms : tuple of Term
        Columns of log sigma, times the prior SDs of their coefficients: K in all.
    priors : Priors
        Prior scales.
    suffix : str
        Of names: "" between subjects, "_e" between trials.

    Attributes
    ----------
    rho : str
        Name of the correlation of the level.
    weight : ndarray
        Weights of the rough likelihood, (P, C): a unit of the coordinates is shorter by
        √(1 + weight) than a prior SD.
    """

    def __init__(
        self, statistics: Statistics, terms: tuple[Term, ...], priors: Priors, suffix: str
    ) -> None:
        self.suffix = suffix
        self.terms = terms
        self.rho = f"rho{suffix or '_w'}"
        centre = getattr(priors, f"log_s{suffix}_mean")
        columns = np.concatenate([term.columns for term in terms])
        loadings = np.moveaxis(columns, 1, 0)  # (P, K, C)
        if suffix:
            self._rough = likelihood_of_trials(statistics)
        else:
            self._rough = likelihood_between(
                statistics, loadings, centre, priors.log_s_sd, subject_effect=True
            )
        self.weight = self._rough.weight
        self._maps = []
        for p, of_quantity in enumerate(loadings):
            log_linear = LogLinear(centre, of_quantity, self._rough.mean[p], self.weight[p])
            self._maps.append(log_linear)

    @property
    def coefficients(self) -> list[str]:
        """Names of the coefficients of log sigma, one for each column."""
        names = {LEVEL: f"log_s{self.suffix}", TREND: f"kappa{self.suffix}"}
        coefficients = []
        for term in self.terms:
            name = names.get(term.name, f"psi{self.suffix}:{term.name}")
            coefficients += numbered(name, len(term.columns))
        return coefficients

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
            return stacked([first])
        by_first = self._rough.shift_of_second(first.log_sigma, shift[0])
        second = self._maps[1](columns[1], cells[1], omega[1], shift[1] + by_first)
        return stacked([first, second])
