"""The reference model that pools nothing: each cell by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.model.laws import ConditionalMoments
from percept.inference.model.model import Model
from percept.inference.model.priors import Named

__all__ = ["Unpooled"]

Array = NDArray[np.float64]

#: An SD of one subject is unknown.
_FEWEST_SUBJECTS = 2


class Unpooled(Model):
    """Each cell by itself: y ~ N(beta, sigma²), beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits.
    With t = log(sigma/SD) and n subjects the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1,
    and beta given sigma is N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu), the SD of
    t at the mode.

    Parameters
    ----------
    cells : tuple of (str, str)
        Parameter and environment of each of the C cells.
    counts : ndarray of int
        Subjects n of each cell, (C,).

    Raises
    ------
    RefusalError
        If a cell has one subject.
    """

    def __init__(
        self,
        cells: tuple[tuple[str, str], ...],
        counts: NDArray[np.int64],
    ) -> None:
        if np.any(counts < _FEWEST_SUBJECTS):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self.names = [f"log sigma[{parameter},{environment}]" for parameter, environment in cells]
        self.priors_in_force: dict[str, float] = {}
        self._n = np.asarray(counts, dtype=float)
        self._nu = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._nu)

    def identity(self) -> tuple[object, ...]:
        """Return cells and counts: the data are standardised."""
        return ("unpooled", self.cells, self._n)

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            inverse_variance = np.exp(-2.0 * t)
            cost = self._nu * (t + 0.5 * inverse_variance)
        return -cost.sum(axis=1)

    def _sigma_ratio(self, points: Array) -> Array:
        """exp(t), sigma over the cell's SD, (W, C)."""
        return np.exp(points * self._unit)

    def laws(self, points: Array) -> ConditionalMoments:
        """Moments of the standardised beta and of the population at coordinates (W, C)."""
        sigma = self._sigma_ratio(points)
        return ConditionalMoments(
            mean=np.zeros_like(sigma),
            sd=sigma / np.sqrt(self._n),
            population_sd=sigma,
        )

    def scales(self, points: Array) -> Named:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), self._sigma_ratio(points))}
