"""Every cell by itself under the reference prior: the Bayesian twin of the classical intervals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.laws import Laws

Array = NDArray[np.float64]


class Unpooled:
    """y ~ N(beta, sigma²) per cell, beta and log sigma flat.

    Responses are standardised by the cell's own mean and SD, so that an offset costs no digits: with
    t = log(sigma/SD) the posterior is exp(-nu t - nu exp(-2t)/2), nu = n - 1, and
    beta | sigma ~ N(0, exp(2t)/n). The coordinate is t in units of 1/sqrt(2 nu).
    """

    def __init__(self, cells: tuple[tuple[str, str], ...], counts: NDArray[np.int64]) -> None:
        if np.any(counts < 2):
            parameter, environment = cells[int(np.argmin(counts))]
            raise RefusalError(
                f"{parameter} in {environment} has one subject; the reference prior needs two.",
                hint='Add subjects, or use pooling = "partial".',
            )
        self.cells = cells
        self._n = np.asarray(counts, dtype=float)
        self._df = self._n - 1.0
        self._unit = 1.0 / np.sqrt(2.0 * self._df)

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return [f"log sigma[{p},{e}]" for p, e in self.cells]

    @property
    def priors(self) -> dict[str, float]:
        """None that could be set."""
        return {}

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, C), shape (W,)."""
        t = points * self._unit
        with np.errstate(over="ignore"):
            return -(self._df * (t + 0.5 * np.exp(-2.0 * t))).sum(axis=1)

    def laws(self, points: Array) -> Laws:
        """Laws of the standardised beta and spread at coordinates (W, C)."""
        spread = np.exp(points * self._unit)
        return Laws(np.zeros_like(spread), spread / np.sqrt(self._n), spread)

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw standardised population means and new users, each (W, C)."""
        laws = self.laws(points)
        mean = laws.sd * rng.standard_normal(points.shape)
        return mean, mean + laws.spread * rng.standard_normal(points.shape)

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Ratio of sigma to the sample SD per cell."""
        return {"sigma_ratio": (("cell",), np.exp(points * self._unit))}
