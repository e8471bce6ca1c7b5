"""What the model says of new studies like this one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.subjects import SubjectDensity
from percept.inference.model.subjects import SubjectLaws

__all__ = ["STATISTICS", "new_studies", "statistics_of"]

Array = NDArray[np.float64]

#: What `statistics_of` works out, in its order.
STATISTICS = ("mean", "sd", "farthest")


def new_studies(
    subjects: SubjectDensity,
    points: Array,
    rng: np.random.Generator,
) -> Iterator[Array]:
    """Yield cell means (W, N, P, J) of new studies of the same design, one per draw (S, d)."""
    for _, laws in subjects.batches(points):
        yield _new_studies(subjects, laws, rng)


def _new_studies(
    subjects: SubjectDensity,
    laws: SubjectLaws,
    rng: np.random.Generator,
) -> Array:
    """Draw cell means of all subjects at W sets of scales, (W, N, P, J), NaN if missing."""
    latents, size, cells, width = laws.columns.shape
    normals = rng.standard_normal((latents, width))
    departures = np.einsum("rpcw,rw->pcw", laws.columns, normals)
    beta = laws.mean + departures
    shape_of_studies = (width, subjects.subjects, size, cells)
    drawn = np.full(shape_of_studies, np.nan)
    patterns = subjects.density.statistics.patterns
    for pattern, noise in zip(patterns, laws.noise, strict=True):
        present = pattern.environments
        members = pattern.members[:, None]
        shape = (pattern.subjects, present.size, width)
        means = beta[:, None, present]
        values = np.broadcast_to(means, (size, *shape)).copy()
        for column in noise.factor_columns():
            scale = np.stack(column)[:, None]
            values += scale * rng.standard_normal(shape)
        for effect in laws.effects[:, :, present]:
            own = rng.standard_normal((pattern.subjects, 1, width))
            values += effect[:, None] * own
        # numpy puts the axes of two lists of indices first.
        by_cell = values.transpose(1, 2, 3, 0)
        drawn[:, members, :, present] = by_cell
    return drawn


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
