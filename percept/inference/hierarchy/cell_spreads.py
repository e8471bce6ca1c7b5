"""SDs of all cells at one level, between subjects or between trials, from their coordinates."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.design import LEVEL, TREND, Term
from percept.inference.hierarchy.log_linear import LogLinear
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.rough_spreads import (
    rough_between,
    rough_trial,
    tie_between,
    tie_trial,
)
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["CellSpreads", "LevelSpreads", "numbered"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class LevelSpreads:
    """Log SDs of one level at W sets of coordinates."""

    log_sigma: Array  # (P, C, W)
    multiples: Array  # (P, K, W) Coefficients over their prior SDs
    log_density: Array  # (W,) Of the coordinates under the prior


def numbered(name: str, count: int) -> list[str]:
    """Names of the columns of a term: numbered where there are several."""
    if count == 1:
        return [name]
    return [f"{name}:{k + 1}" for k in range(count)]


class CellSpreads:
    """Map from coordinates to the SDs of one level, the second quantity's given the first's.

    Parameters
    ----------
    statistics : Statistics
        What the rough likelihood of the SDs is taken from.
    terms : tuple of Term
        Columns of log sigma, times the prior SDs of their coefficients.
    priors : Priors
        Prior scales.
    suffix : str
        Of names: "" between subjects, "_e" between trials.
    """

    def __init__(
        self, statistics: Statistics, terms: tuple[Term, ...], priors: Priors, suffix: str
    ) -> None:
        self.suffix = suffix
        self.terms = terms
        self.rho = f"rho{suffix or '_w'}"
        centre = getattr(priors, f"log_s{suffix}_mean")
        columns = np.concatenate([term.columns for term in terms])
        if suffix:
            mean, weight = rough_trial(statistics)
            tie = tie_trial(statistics)
        else:
            loadings = np.moveaxis(columns, 1, 0)
            mean, weight = rough_between(
                statistics, loadings, centre, priors.log_s_sd, subject_effect=True
            )
            tie = tie_between(statistics, subject_effect=True)
        # What the first quantity says of the second: near a correlation of one their ratio is
        # known far better than either.
        known = (weight > 0).all(axis=0)
        ratio = weight[0] / np.where(known, weight[-1], 1.0)
        self._slope = np.where(known, tie * np.sqrt(ratio), 0.0)[:, None]
        self._rough_mean = mean[0][:, None]
        self.weight = weight.copy()  # (P, C)
        self.weight[1:] /= np.where(known, 1.0 - tie * tie, 1.0)
        self._maps = [
            LogLinear(centre, columns[:, p], mean[p], self.weight[p]) for p in range(len(weight))
        ]

    @property
    def coefficients(self) -> list[str]:
        """Names of the coefficients of log sigma, one for each column."""
        names = {LEVEL: f"log_s{self.suffix}", TREND: f"kappa{self.suffix}"}
        found = []
        for term in self.terms:
            name = names.get(term.name, f"psi{self.suffix}:{term.name}")
            found += numbered(name, len(term.columns))
        return found

    def __call__(self, joint: Array, own: Array, omega: Array, shift: Array) -> LevelSpreads:
        """Map coordinates of coefficients (P, K, W) and of cells (P, C, W), given omega (P, W).

        The means of the rough likelihood are moved by a shift (P, C or 1, W).
        """
        first = self._maps[0](joint[0], own[0], omega[0], shift[0])
        spreads = [first]
        if len(self._maps) == 2:
            towards = self._slope * (first.log_sigma - self._rough_mean - shift[0])
            spreads.append(self._maps[1](joint[1], own[1], omega[1], shift[1] + towards))
        return LevelSpreads(
            log_sigma=np.stack([spread.log_sigma for spread in spreads]),
            multiples=np.stack([spread.multiples for spread in spreads]),
            log_density=np.sum([spread.log_density for spread in spreads], axis=0),
        )
