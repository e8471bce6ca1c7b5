"""What the model says before the data, and of new studies like this one."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import Named, draws_first
from percept.inference.hierarchy.scales import Layout

Array = NDArray[np.float64]
STATISTICS = ("mean", "sd", "farthest")


def draw_prior(
    density: CollapsedDensity, draws: int, rng: np.random.Generator
) -> tuple[Named, Array, Array]:
    """Draw scales, population means and new users before any data."""
    statistics, priors = density.statistics, density.priors
    # Without observed scatter every coordinate of log sigma is standard normal a priori, like the
    # rest.
    blank = dataclasses.replace(
        statistics, sd=np.zeros_like(statistics.sd), trial_rows=np.zeros_like(statistics.trial_rows)
    )
    layout = Layout(blank, priors, density.layout.options)
    scales = layout.scales(rng.standard_normal((layout.dimension, draws)))
    size, environments = layout.parameters, layout.environments
    beta = np.repeat(priors.alpha_sd * rng.standard_normal((size, 1, draws)), environments, axis=1)
    if scales.tau is not None:
        gamma = priors.gamma_sd * rng.standard_normal((size, 1, draws))
        beta += gamma * statistics.x[..., None]
        beta += np.stack(scales.tau)[:, None] * rng.standard_normal(beta.shape)
    user = beta.copy()
    for column in scales.between.factor_columns():
        user += np.stack(column) * rng.standard_normal(beta.shape[1:])
    for column in scales.shared.factor_columns() if scales.shared is not None else ():
        user += np.stack(column)[:, None] * rng.standard_normal(beta.shape[1:])
    return draws_first(scales.named), beta.reshape(-1, draws).T, user.reshape(-1, draws).T


def statistics_of(cell_means: Array) -> Array:
    """Mean, SD, and the farthest subject's distance from the mean in SDs, of every cell."""
    present = np.isfinite(cell_means)
    n = present.sum(axis=-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(present, cell_means, 0.0).sum(axis=-3) / n
        off = np.where(present, cell_means - mean[..., None, :, :], 0.0)
        sd = np.sqrt(np.square(off).sum(axis=-3) / (n - 1.0))
        farthest = np.where(n > 2, np.abs(off).max(axis=-3) / sd, np.nan)
    return np.stack([mean, np.where(n > 1, sd, np.nan), farthest], axis=-3)


def replicate(subjects: SubjectDensity, points: Array, rng: np.random.Generator) -> Array:
    """Statistics of new studies of the same design, one per draw."""
    density, studies = subjects.density, []
    for _, scales in subjects.batches(points):
        beta = density.locations(scales).draw(rng)
        width = beta.shape[-1]
        drawn = np.full(
            (width, subjects.subjects, subjects.parameters, subjects.environments), np.nan
        )
        for pattern, cell in zip(
            density.statistics.patterns, density.cell_blocks(scales), strict=True
        ):
            shape = (pattern.subjects, pattern.environments.size, width)
            values = np.broadcast_to(
                beta[:, None, pattern.environments], (subjects.parameters, *shape)
            ).copy()
            for column in cell.factor_columns():
                values += np.stack(column)[:, None] * rng.standard_normal(shape)
            for column in scales.shared.factor_columns() if scales.shared is not None else ():
                values += np.stack(column)[:, None, None] * rng.standard_normal(
                    (shape[0], 1, width)
                )
            drawn[:, pattern.members[:, None], :, pattern.environments] = values.transpose(
                1, 2, 3, 0
            )
        studies.append(statistics_of(drawn))
    return np.concatenate(studies)
