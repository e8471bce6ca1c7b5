"""What the model predicts of each subject from the others, and of a study like this one."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.checks.subjects import SubjectDensity, batches

Array = NDArray[np.float64]
STATISTICS = ("mean", "sd", "farthest")


@dataclasses.dataclass(frozen=True, eq=False)
class Predicted:
    """Where subjects lie in what the others predict of them."""

    below: Array  # (I, P, J) Predictive probability of a cell mean below the subject's own
    farther: Array  # (I,)


def predict_left_out(
    subjects: SubjectDensity, points: Array, weights: Array, members: NDArray[np.intp] | None = None
) -> Predicted:
    """Compare subjects with their prediction from the others."""
    wanted = np.arange(subjects.subjects) if members is None else members
    below = np.zeros((wanted.size, subjects.parameters, subjects.environments))
    farther = np.zeros(wanted.size)
    for cut in batches(len(points), subjects):
        scales = subjects.density.layout.scales(np.ascontiguousarray(points[cut].T))
        left = subjects.left_out(scales, wanted)
        below += np.einsum("wi,wipj->ipj", weights[cut], special.ndtr(left.standard))
        farther += np.einsum(
            "wi,wi->i", weights[cut], special.chdtrc(subjects.degrees[wanted], left.distance)
        )
    return Predicted(below, farther)


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
    found = []
    for cut in batches(len(points), subjects):
        density = subjects.density
        scales = density.layout.scales(np.ascontiguousarray(points[cut].T))
        beta = density.locations(scales).draw(rng)
        width = beta.shape[-1]
        drawn = np.full((width, subjects.subjects, subjects.parameters, subjects.environments), np.nan)
        for pattern, cell in zip(density.statistics.patterns, density.cell_blocks(scales), strict=True):
            shape = (pattern.subjects, pattern.environments.size, width)
            values = np.broadcast_to(
                beta[:, None, pattern.environments], (subjects.parameters, *shape)
            ).copy()
            for column in cell.factor_columns():
                values += np.stack(column)[:, None] * rng.standard_normal(shape)
            for column in scales.shared.factor_columns() if scales.shared is not None else ():
                values += np.stack(column)[:, None, None] * rng.standard_normal((shape[0], 1, width))
            drawn[:, pattern.members[:, None], :, pattern.environments] = values.transpose(1, 2, 3, 0)
        found.append(statistics_of(drawn))
    return np.concatenate(found)
