"""Each subject against the others, by Pareto-smoothed importance sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.checks.subjects import SubjectDensity

__all__ = [
    "Loo",
    "Predicted",
    "leave_one_out",
    "limit_moves",
    "predict_left_out",
    "smoothed_subjects",
]

Array = NDArray[np.float64]

#: Tail index above which no number of draws helps (Vehtari, Simpson, Gelman, Yao and Gabry 2024).
_WORST_INDEX = 0.7
#: Part of an environment's own SD in the closed form; the rest is the environments' together, as
#: in a fit that takes most of their differences for chance.
_OWN = 0.3
#: Degrees of freedom of a prior whose log SD is one.
_PRIOR_WEIGHT = 0.5
#: Degrees of freedom that fits have beside their subjects': priors keep limits of three finite.
_LEAST_FREEDOM = 4.0
#: Draws times subjects that are held at once; more subjects are judged by fewer draws.
_MOST = 1 << 20


@dataclass(frozen=True, eq=False)
class Loo:
    """Expected log predictive density of a new subject, from N subjects left out in turn."""

    pointwise: Array  # (N,)
    pareto_k: Array  # (N,) Tail index of the importance weights of leaving the subject out
    good_k: float  # Index up to which such weights can be trusted, with this many draws
    points: Array  # (S, d) Draws that were reweighted
    weights: Array  # (S, N) Their weights without each subject

    @property
    def elpd(self) -> float:
        """Sum of `pointwise`."""
        return float(self.pointwise.sum())

    @property
    def se(self) -> float:
        """Standard error of `elpd` as an estimate for other subjects of the same population."""
        variance = self.pointwise.var(ddof=1)
        return float(np.sqrt(self.pointwise.size * variance))


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where subjects lie in what the others predict of them."""

    below: Array  # (N, P, J) Predictive probability of a cell mean below the subject's own
    farther: Array  # (N,) Predictive probability of lying as far off or farther, all cells together


def leave_one_out(
    subjects: SubjectDensity,
    points: Array,
    *,
    chains: int,
) -> Loo:
    """Leave each subject out by reweighting draws of the scales.

    The locations are integrated out of the weights, 1/p(y_i | scales, other subjects), so these
    vary with the scales alone. Weights of draws of the locations too would have far heavier tails.

    Parameters
    ----------
    subjects : SubjectDensity
        Densities of the subjects' data.
    points : ndarray
        Posterior draws, chain after chain, shape (S, d).
    chains : int
        Chains of equal length.

    Returns
    -------
    Loo

    Raises
    ------
    UsageError
        Chains that are not of equal length.
    RefusalError
        A density that doubles cannot hold.
    """
    if len(points) % chains:
        raise UsageError(
            f"{len(points)} draws do not make equal chains.", key="chains", value=chains
        )
    by_chain = points.reshape(chains, -1, points.shape[1])
    gap = max(1, math.ceil(len(points) * subjects.subjects / _MOST))
    kept = by_chain[:, ::gap].reshape(-1, points.shape[1])
    parts = []
    for _, laws in subjects.batches(kept):
        left_out = subjects.left_out(laws)
        parts.append(left_out.log_density)
    log_density = np.concatenate(parts)
    known = np.isfinite(log_density).all(axis=0)
    if not known.all():
        subject = subjects.density.statistics.subjects[int(np.argmin(known))]
        raise RefusalError(
            f"{subject} cannot be predicted from the others in double precision: an environment"
            " rests on this subject alone, at next to no scatter.",
            hint="Leave that environment out, or ask for no model checks.",
        )
    return smoothed_subjects(log_density, kept)


def smoothed_subjects(log_density: Array, points: Array) -> Loo:
    """Leave subjects out by weights 1/p(y_i | scales, other subjects), their tails smoothed.

    Parameters
    ----------
    log_density : ndarray, shape (S, N)
        Log densities of the subjects' data given the others', at every draw.
    points : ndarray, shape (S, d)
        The draws.

    Returns
    -------
    Loo
    """
    # A slow import, for checks of a posterior only.
    from arviz_stats.base import array_stats

    # It takes log densities, and negates them itself.
    log_weights, indices = array_stats.psislw(log_density, axis=0)
    log_weights = log_weights.T
    return Loo(
        pointwise=special.logsumexp(log_weights + log_density, axis=0),
        pareto_k=indices,
        good_k=min(1.0 - 1.0 / math.log10(len(points)), _WORST_INDEX),
        points=points,
        weights=special.softmax(log_weights, axis=0),
    )


def predict_left_out(
    subjects: SubjectDensity,
    points: Array,
    weights: Array,
) -> Predicted:
    """Compare subjects with their prediction from the others: draws (S, d), weights (S, N)."""
    below = np.zeros((subjects.subjects, subjects.parameters, subjects.environments))
    farther = np.zeros(subjects.subjects)
    for cut, laws in subjects.batches(points):
        left = subjects.left_out(laws)
        tail = special.chdtrc(subjects.degrees, left.distance)
        cdf = special.ndtr(left.standard)
        below += np.einsum("wi,wipj->ipj", weights[cut], cdf)
        farther += np.einsum("wi,wi->i", weights[cut], tail)
    return Predicted(below, farther)


def limit_moves(cell_means: Array, level: float, usual_sd: float) -> Array:
    """Work out how far limits move without each subject, by means and SDs alone.

    Parameters
    ----------
    cell_means : ndarray
        Of studies, on the response scale, shape (..., N, P, J); NaN where a subject has none.
    level : float
        Of the intervals.
    usual_sd : float
        SD between subjects that the priors expect.

    Returns
    -------
    ndarray
        Largest move of a limit of the average or the next user, in half-widths, shape (..., N);
        zero where too few subjects are left.
    """
    present = np.isfinite(cell_means)
    values = np.where(present, cell_means, 0.0)
    n = present.sum(axis=-3, keepdims=True)
    mean = values.sum(axis=-3, keepdims=True) / np.maximum(n, 1)
    deviation = np.where(present, values - mean, 0.0)
    squares = np.square(deviation).sum(axis=-3, keepdims=True)
    others = n - present
    left = np.maximum(others, 1)
    shift = np.abs(deviation) / left
    half = _half_width(squares, n, level, usual_sd)
    half_without = _half_width(squares - deviation**2 * n / left, left, level, usual_sd)
    largest = np.zeros(cell_means.shape[:-2])
    # Half-widths go with sqrt(1/n) for the average user, with sqrt(1 + 1/n) for the next.
    for own in (0.0, 1.0):
        before = half * np.sqrt(own + 1.0 / np.maximum(n, 1))
        after = half_without * np.sqrt(own + 1.0 / left)
        moves = np.where(others > 1, (shift + np.abs(after - before)) / before, 0.0)
        largest = np.maximum(largest, moves.max(axis=(-2, -1)))
    return largest


def _half_width(squares: Array, n: Array, level: float, usual_sd: float) -> Array:
    """Student's t times the SD between subjects, which environments and priors share in part."""
    variance = (squares + _PRIOR_WEIGHT * usual_sd**2) / (n - 1 + _PRIOR_WEIGHT)
    logs = 0.5 * np.log(variance)
    common = logs.mean(axis=-1, keepdims=True)
    shared = _OWN * logs + (1.0 - _OWN) * common
    environments = squares.shape[-1]
    freedom = (n - 1) * (_OWN + (1.0 - _OWN) * environments) + _LEAST_FREEDOM
    t = special.stdtrit(freedom, 0.5 * (1.0 + level))
    return np.asarray(t * np.exp(shared))
