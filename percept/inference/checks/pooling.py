"""What pooling did: how far environments moved to their trend, and how k and b go together."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.prior import draw_trend
from percept.inference.hierarchy.blocks import Block, Pair
from percept.inference.hierarchy.density import CollapsedDensity

Array = NDArray[np.float64]
_CHUNK = 512
#: Raw mean and trend this close, in posterior SDs of the centre, leave nothing to move through.
_APART = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class Shrinkage:
    """Centres of the environments before and after pooling, on the response scale; all (P, J)."""

    raw: Array  # Mean over subjects of their cell means
    centre: Array
    trend: Array
    sd: Array  # Posterior SD of the location
    moved: Array


def shrinkage(density: CollapsedDensity, points: Array) -> Shrinkage | None:
    """How far each environment's centre was drawn to the trend over environments."""
    if not density.layout.trend:
        return None
    sums = [0.0, 0.0, 0.0]
    x = density.statistics.x[..., None]
    for start in range(0, len(points), _CHUNK):
        scales = density.layout.scales(np.ascontiguousarray(points[start : start + _CHUNK].T))
        law = density.locations(scales)
        beta = np.stack(law.mean)
        # Level and slope are linear in the locations: their mean follows from the locations' mean.
        alpha, gamma = draw_trend(density, scales, beta)
        trend = alpha[:, None] + gamma[:, None] * x
        square = np.square(beta) + np.stack(law.covariance.diagonal())
        sums = [total + part.sum(axis=-1) for total, part in zip(sums, (beta, trend, square), strict=True)]
    centre, trend, square = (np.asarray(total) / len(points) for total in sums)
    raw = np.nanmean(density.statistics.cell_means, axis=0)
    sd = np.sqrt(np.maximum(square - np.square(centre), 0.0))
    way = trend - raw
    moved = np.divide(centre - raw, way, out=np.full_like(raw, np.nan), where=np.abs(way) > _APART * sd)
    return Shrinkage(raw, centre, trend, sd, moved)


def correlation_draws(density: CollapsedDensity, points: Array) -> dict[str, Array]:
    """Draws of the correlations of stiffness and damping between users."""
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    if not isinstance(scales.between, Pair):
        return {}
    found = {"within": scales.named["rho_w"]}
    population: Block = scales.between
    if isinstance(scales.shared, Pair):
        found["shared"] = scales.named["rho_u"]
        ones = np.ones((len(density.statistics.environments), 1))
        population = population + scales.shared[None].scaled(ones)
    return found | {"population": _correlation(population).T}


def _correlation(block: Block) -> Array:
    """Slope times the ratio of SDs, from the regression a pair is kept as."""
    assert isinstance(block, Pair)
    first, second = block.diagonal()
    return block.g * np.sqrt(first / second)
