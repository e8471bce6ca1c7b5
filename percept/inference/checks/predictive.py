"""What the model says before the data, and of new studies like this one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import Named, draws_first
from percept.inference.hierarchy.scales import Layout, Scales

__all__ = ["STATISTICS", "PriorDraws", "draw_prior", "new_studies", "statistics_of"]

Array = NDArray[np.float64]

#: What `statistics_of` works out, in its order.
STATISTICS = ("mean", "sd", "farthest")


@dataclass(frozen=True, eq=False)
class PriorDraws:
    """Draws of scales, population means and new users before any data."""

    scales: Named
    means: Array  # (draws, C)
    users: Array  # (draws, C)


def draw_prior(
    density: CollapsedDensity,
    draws: int,
    rng: np.random.Generator,
) -> PriorDraws:
    """Draw scales, population means and new users before any data."""
    statistics = density.statistics
    priors = density.priors
    # Without observed scatter every coordinate of log sigma is standard normal a priori, like the
    # rest.
    blank = replace(
        statistics,
        sd=np.zeros_like(statistics.sd),
        trial_rows=np.zeros_like(statistics.trial_rows),
    )
    layout = Layout(blank, priors, density.layout.options)
    coordinates = rng.standard_normal((layout.dimension, draws))
    scales = layout.scales(coordinates)
    alpha = rng.standard_normal((layout.parameters, 1, draws))
    alpha *= priors.alpha_sd
    beta = np.repeat(alpha, layout.environments, axis=1)
    if scales.tau is not None:
        gamma = priors.gamma_sd * rng.standard_normal(alpha.shape)
        beta += gamma * statistics.x[..., None]
        tau = np.stack(scales.tau)[:, None]
        beta += tau * rng.standard_normal(beta.shape)
    user = beta.copy()
    for column in scales.between.factor_columns():
        scale = np.stack(column)
        user += scale * rng.standard_normal(beta.shape[1:])
    if scales.shared is not None:
        for column in scales.shared.factor_columns():
            scale = np.stack(column)[:, None]
            user += scale * rng.standard_normal(beta.shape[1:])
    return PriorDraws(
        scales=draws_first(scales.named),
        means=beta.reshape(-1, draws).T,
        users=user.reshape(-1, draws).T,
    )


def statistics_of(cell_means: Array) -> Array:
    """Mean, SD, and the farthest subject's distance from the mean in SDs, of every cell.

    Parameters
    ----------
    cell_means : ndarray
        Shape (..., N, P, J); NaN where a subject has none.

    Returns
    -------
    ndarray
        Shape (..., 3, P, J), NaN where subjects are too few.
    """
    present = np.isfinite(cell_means)
    n = present.sum(axis=-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.where(present, cell_means, 0.0).sum(axis=-3)
        mean = total / n
        deviation = cell_means - mean[..., None, :, :]
        deviation = np.where(present, deviation, 0.0)
        squares = np.square(deviation).sum(axis=-3)
        sd = np.sqrt(squares / (n - 1.0))
        farthest = np.abs(deviation).max(axis=-3) / sd
    sd = np.where(n > 1, sd, np.nan)
    farthest = np.where(n > 2, farthest, np.nan)
    return np.stack([mean, sd, farthest], axis=-3)


def new_studies(
    subjects: SubjectDensity,
    points: Array,
    rng: np.random.Generator,
) -> Iterator[Array]:
    """Yield cell means (W, N, P, J) of new studies of the same design, one per draw (S, d)."""
    for _, scales in subjects.batches(points):
        yield _new_studies(subjects, scales, rng)


def _new_studies(
    subjects: SubjectDensity,
    scales: Scales,
    rng: np.random.Generator,
) -> Array:
    """Draw cell means of all subjects at W sets of scales, (W, N, P, J), NaN if missing."""
    density = subjects.density
    beta = density.locations(scales).draw(rng)
    size, environments, width = beta.shape
    drawn = np.full((width, subjects.subjects, size, environments), np.nan)
    blocks = density.cell_blocks(scales)
    for pattern, cell in zip(density.statistics.patterns, blocks, strict=True):
        present = pattern.environments
        members = pattern.members[:, None]
        shape = (pattern.subjects, present.size, width)
        means = beta[:, None, present]
        values = np.broadcast_to(means, (size, *shape)).copy()
        for column in cell.factor_columns():
            scale = np.stack(column)[:, None]
            values += scale * rng.standard_normal(shape)
        if scales.shared is not None:
            for column in scales.shared.factor_columns():
                scale = np.stack(column)[:, None, None]
                values += scale * rng.standard_normal((pattern.subjects, 1, width))
        # numpy puts the axes of two lists of indices first.
        by_cell = values.transpose(1, 2, 3, 0)
        drawn[:, members, :, present] = by_cell
    return drawn
