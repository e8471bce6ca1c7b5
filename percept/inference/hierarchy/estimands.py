"""Intervals of all three kinds from the posterior, as estimands of a sampling run."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.conditional import Conditional
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.sampling.estimands import Estimates
from percept.inference.sampling.mixture import mixture_influence, mixture_quantile, share_half_width

__all__ = ["KINDS", "IntervalEstimands", "Locations"]

Array = NDArray[np.float64]
KINDS = ("mean", "user", "share")
_CHUNK = 512


@dataclasses.dataclass(frozen=True, eq=False)
class Locations:
    """Per draw and environment x parameter: the law of beta given the scales, and the population's SD.

    Attributes
    ----------
    mean, sd : ndarray, shape (S, P J)
        Conditional mean and SD of beta, parameter-major.
    spread : ndarray, shape (S, P J)
        SD of the population about beta.
    """

    mean: Array
    sd: Array
    spread: Array

    @classmethod
    def unpack(cls, components: Array) -> Locations:
        """Split components (S, 3 P J)."""
        return cls(*np.split(components, 3, axis=1))


class IntervalEstimands:
    """Endpoints of the intervals asked for, for every parameter and environment.

    Parameters
    ----------
    density : CollapsedDensity
        The model and the study.
    kinds : sequence of str
        Kinds wanted, of "mean", "user", "share".
    level, share, confidence : float
        Level of `mean` and `user`; share and confidence of `share`.
    """

    def __init__(
        self,
        density: CollapsedDensity,
        *,
        kinds: tuple[str, ...] = KINDS,
        level: float = 0.99,
        share: float = 0.99,
        confidence: float = 0.95,
    ) -> None:
        self._density = density
        self.kinds = kinds
        self.level, self.share, self.confidence = level, share, confidence
        statistics = density.statistics
        self.cells = tuple((p, e) for p in statistics.parameters for e in statistics.environments)
        self.names = tuple(
            f"{side} {kind} limit of {p} in {e}" for kind in kinds for side in ("lower", "upper") for p, e in self.cells
        )

    def components(self, points: Array) -> Array:
        """Conditional means and SDs of beta and population SDs, shape (W, 3 P J)."""
        return np.concatenate(
            [self._components(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
        )

    def _components(self, points: Array) -> Array:
        scales = self._density.layout.scales(np.ascontiguousarray(points.T))
        law = Conditional(self._density, scales)
        mean = np.concatenate(law.mean)
        sd = np.sqrt(np.concatenate(law.covariance.diagonal()))
        spread = np.sqrt(np.concatenate(law.population.diagonal()))
        return np.concatenate([mean, sd, spread]).T

    def limits(self, kind: str, locations: Locations) -> tuple[Array, Array, Array]:
        """Limits of one kind on the response scale.

        Parameters
        ----------
        kind : str
            "mean", "user" or "share".
        locations : Locations
            Kept draws.

        Returns
        -------
        lower, upper : ndarray, shape (P J,)
            Limits.
        influence : ndarray, shape (S, 2 P J)
            Pull of each draw on the lower, then the upper limits.
        """
        if kind == "share":
            centre, half, influence = share_half_width(
                locations.mean, locations.sd, locations.spread, share=self.share, confidence=self.confidence
            )
            return centre - half, centre + half, influence
        sd = locations.sd if kind == "mean" else np.hypot(locations.sd, locations.spread)
        tail = 0.5 * (1.0 - self.level)
        lower = mixture_quantile(locations.mean, sd, tail, upper=False)
        upper = mixture_quantile(locations.mean, sd, tail, upper=True)
        influence = [mixture_influence(locations.mean, sd, limit) for limit in (lower, upper)]
        return lower, upper, np.concatenate(influence, axis=1)

    def estimate(self, components: Array) -> Estimates:
        """All limits of all kinds asked for, their scale being the interval's half-width."""
        locations = Locations.unpack(components)
        values, scales, influences = [], [], []
        for kind in self.kinds:
            lower, upper, influence = self.limits(kind, locations)
            values += [lower, upper]
            scales += [0.5 * (upper - lower)] * 2
            influences.append(influence)
        return Estimates(
            self.names, np.concatenate(values), np.concatenate(scales), np.concatenate(influences, axis=1)
        )
