"""Predictions of new studies like this one, and of each subject from the others.

A subject is left out by Pareto-smoothed importance sampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.imports import array_stats
from percept.inference.left_out import LeftOut, SubjectDensity
from percept.inference.sampling.endpoints import mixture_limits

Array = NDArray[np.float64]
#: Names of the rows that `statistics_of` returns.
STATISTICS = ("mean", "sd", "farthest")
#: Tail index above which no number of draws helps (Vehtari, Simpson, Gelman, Yao and Gabry 2024).
_WORST_INDEX = 0.7


def new_studies(
    subjects: SubjectDensity,
    points: Array,
    rng: np.random.Generator,
) -> Iterator[Array]:
    """Yield cell means (W, N, P, J) of new studies of the same design, one per draw (S, d).

    They are NaN in cells that a subject lacks.
    """
    for laws in subjects.laws(points):
        latents, size, cells, width = laws.columns.shape
        normals = rng.standard_normal((latents, width))
        beta = laws.mean + np.einsum("rpcw,rw->pcw", laws.columns, normals)
        drawn = np.full((width, subjects.subjects, size, cells), np.nan)
        patterns = subjects.density.statistics.patterns
        for pattern, covariance in zip(patterns, laws.covariances, strict=True):
            present = pattern.environments
            shape = (pattern.subjects, present.size, width)
            values = np.tile(beta[:, None, present], (1, pattern.subjects, 1, 1))
            for column in covariance.noise.factor_columns():
                scale = np.stack(column)[:, None]
                values += scale * rng.standard_normal(shape)
            for effect in laws.scales.effects[:, :, present]:
                values += effect[:, None] * rng.standard_normal((pattern.subjects, 1, width))
            # numpy puts the axes of two lists of indices first.
            drawn[:, pattern.members[:, None], :, present] = values.transpose(1, 2, 3, 0)
        yield drawn


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
    n = np.isfinite(cell_means).sum(axis=-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nansum(cell_means, axis=-3) / n
        deviation = np.nan_to_num(cell_means - mean[..., None, :, :])
        squares = np.square(deviation).sum(axis=-3)
        sd = np.sqrt(squares / np.where(n > 1, n - 1.0, np.nan))
        farthest = np.abs(deviation).max(axis=-3) / sd
    return np.stack([mean, sd, np.where(n > 2, farthest, np.nan)], axis=-3)


@dataclass(frozen=True, eq=False)
class Loo:
    """Draws reweighted as if each of N subjects were left out in turn."""

    pareto_k: Array  # (N,) Tail index of the importance weights of leaving the subject out
    good_k: float  # Index up to which such weights can be trusted, with this many draws
    weights: Array  # (S, N) Their weights without each subject

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Whether the weights of leaving each subject out can be trusted, (N,)."""
        return self.pareto_k <= self.good_k


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where subjects lie in their predictions from the others."""

    below: Array  # (N, P, J) Predictive probability of a cell mean below the subject's own
    farther: Array  # (N,) Predictive probability of lying as far off or farther, all cells together


def leave_one_out(subjects: SubjectDensity, left: LeftOut) -> Loo:
    """Leave each subject out by reweighting draws of the scales.

    The locations are integrated out of the weights, 1/p(y_i | scales, other subjects), so these
    vary with the scales alone. Weights of draws of the locations too would have far heavier tails.

    Parameters
    ----------
    subjects : SubjectDensity
        Densities of the subjects' data.
    left : LeftOut
        Predictions of each from the others, at posterior draws.

    Returns
    -------
    Loo

    Raises
    ------
    RefusalError
        A density that doubles cannot hold.
    """
    known = np.isfinite(left.log_density).all(axis=0)
    if not known.all():
        subject = subjects.density.statistics.subjects[int(np.argmin(known))]
        raise RefusalError(
            f"{subject} cannot be predicted from the others in double precision: an environment"
            " rests on this subject alone, at next to no scatter.",
            hint="Leave that environment out, or ask for no model checks.",
        )
    return smoothed_subjects(left.log_density)


def smoothed_subjects(log_density: Array) -> Loo:
    """Leave subjects out by weights 1/p(y_i | scales, other subjects), their tails smoothed.

    Parameters
    ----------
    log_density : ndarray, shape (S, N)
        Log densities of the subjects' data given the others', at every draw.

    Returns
    -------
    Loo
    """
    # It takes log densities, and negates them itself.
    log_weights, indices = array_stats().psislw(log_density, axis=0)
    log_weights = log_weights.T
    return Loo(
        pareto_k=indices,
        good_k=min(1.0 - 1.0 / math.log10(len(log_density)), _WORST_INDEX),
        weights=special.softmax(log_weights, axis=0),
    )


def predict_left_out(subjects: SubjectDensity, left: LeftOut, weights: Array) -> Predicted:
    """Compare subjects with their prediction from the others, at S draws of weights (S, N)."""
    tail = special.chdtrc(subjects.degrees, left.distance)
    cdf = special.ndtr(left.standard)
    return Predicted(
        below=np.einsum("wi,wipj->ipj", weights, cdf), farther=np.einsum("wi,wi->i", weights, tail)
    )


def intervals_left_out(left: LeftOut, weights: Array, cells: Sequence[int], level: float) -> Array:
    """Find the intervals of some locations without each subject.

    Without a subject, draws of the scales have other weights, and the locations another law given
    the scales: the interval is that of a weighted mixture of normal laws.

    Parameters
    ----------
    left : LeftOut
        Predictions of each subject from the others, at S draws.
    weights : ndarray, shape (S, N)
        Of these draws without each subject, with a sum of one.
    cells : sequence of int
        Numbers of C locations among the P J of all parameters and environments.
    level : float
        Of the intervals.

    Returns
    -------
    ndarray, shape (3, N, C)
        Lower limits, means and upper limits, on the response scale.
    """
    draws = len(left.location)
    found = []
    for i, of_draws in enumerate(weights.T):
        location = left.location[:, i].reshape(draws, -1)[:, cells]
        sd = left.location_sd[:, i].reshape(draws, -1)[:, cells]
        lower, upper, _ = mixture_limits(location, sd, 0.5 * (1.0 - level), of_draws)
        found.append([lower, of_draws @ location, upper])
    return np.stack(found, axis=1)
