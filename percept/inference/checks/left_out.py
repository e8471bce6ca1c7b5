"""Each subject against the others: by Pareto-smoothed importance sampling, or by sampling without it."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.sampling.endpoints import Means
from percept.inference.sampling.gate import Progress, Settings

Array = NDArray[np.float64]
#: Draws times subjects that are held at once; more subjects are judged by fewer draws.
_MOST = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False)
class Loo:
    """Expected log predictive density of a new subject, from N subjects left out in turn."""

    pointwise: Array  # (N,)
    pareto_k: Array  # (N,) Tail index of the importance weights of leaving the subject out
    good_k: float
    points: Array  # (S, d) Draws that were reweighted
    weights: Array  # (S, N) Their weights without each subject

    @property
    def elpd(self) -> float:
        """Sum of `pointwise`."""
        return float(self.pointwise.sum())

    @property
    def se(self) -> float:
        """Standard error of `elpd` as an estimate for other subjects of the same population."""
        return float(np.sqrt(self.pointwise.size * self.pointwise.var(ddof=1)))

    @property
    def influential(self) -> NDArray[np.bool_]:
        """Subjects whose own value cannot be trusted, shape (N,)."""
        return self.pareto_k > self.good_k


@dataclasses.dataclass(frozen=True, eq=False)
class Predicted:
    """Where subjects lie in what the others predict of them."""

    below: Array  # (I, P, J) Predictive probability of a cell mean below the subject's own
    farther: Array  # (I,) Predictive probability of lying as far off or farther, all cells together


@dataclasses.dataclass(frozen=True, eq=False)
class Refit:
    """A subject left out by sampling."""

    log_density: float  # Log predictive density of the subject's trials given the others
    error: float  # Its Monte Carlo standard error, in nats
    points: Array  # (S, d) Draws of the posterior without the subject, thinned to their effective size


def leave_one_out(subjects: SubjectDensity, points: Array, *, chains: int) -> Loo:
    """Leave each subject out by reweighting draws of the scales.

    The locations are integrated out of the weights, 1/p(y_i | scales, other subjects), so these vary with
    the scales alone; weights of draws of the locations too would have far heavier tails.
    """
    if len(points) % chains:
        raise UsageError(f"{len(points)} draws do not make equal chains.", key="chains", value=chains)
    by_chain = points.reshape(chains, -1, points.shape[1])
    gap = max(1, -(-len(points) * subjects.subjects // _MOST))
    kept = by_chain[:, ::gap].reshape(-1, points.shape[1])
    log_density = np.concatenate(
        [subjects.left_out(scales).log_density for _, scales in subjects.batches(kept)]
    )
    if not np.isfinite(log_density).all():
        i = int(np.argmin(np.isfinite(log_density).all(axis=0)))
        raise RefusalError(
            f"what the others say of {subjects.density.statistics.subjects[i]} cannot be told in double "
            "precision: some environment rests on this subject alone, at next to no scatter.",
            hint="Leave that environment out, or ask for no model checks.",
        )
    return _smoothed(log_density, kept, chains)


def _smoothed(log_density: Array, points: Array, chains: int) -> Loo:
    import arviz_base
    import arviz_stats

    shaped = log_density.reshape(chains, -1, log_density.shape[1])
    tree = arviz_base.from_dict({"log_likelihood": {"trials": shaped}}, dims={"trials": ["subject"]})
    with warnings.catch_warnings():
        # Bad indices are in the record, and every user of it says so.
        warnings.filterwarnings("ignore", message="Estimated shape parameter")
        loo = arviz_stats.loo(tree, pointwise=True, reff=1.0)  # type: ignore[attr-defined, no-untyped-call]
    log_weights = loo.log_weights.transpose("chain", "draw", "subject").to_numpy()
    weights = np.exp(log_weights.reshape(log_density.shape) - log_weights.max())
    return Loo(
        pointwise=loo.elpd_i.to_numpy(),
        pareto_k=loo.pareto_k.to_numpy(),
        good_k=float(loo.good_k),
        points=points,
        weights=weights / weights.sum(axis=0),
    )


def predict_left_out(
    subjects: SubjectDensity, points: Array, weights: Array, members: NDArray[np.intp] | None = None
) -> Predicted:
    """Compare subjects with their prediction from the others, by weighted draws (S, d) and weights (S, I)."""
    members = np.arange(subjects.subjects) if members is None else members
    below = np.zeros((members.size, subjects.parameters, subjects.environments))
    farther = np.zeros(members.size)
    for cut, scales in subjects.batches(points):
        left = subjects.left_out(scales, members)
        beyond = special.chdtrc(subjects.degrees[members], left.distance)
        below += np.einsum("wi,wipj->ipj", weights[cut], special.ndtr(left.standard))
        farther += np.einsum("wi,wi->i", weights[cut], beyond)
    return Predicted(below, farther)


class Without:
    """Posterior of the scales given all subjects but one, in the coordinates of the whole study."""

    def __init__(self, subjects: SubjectDensity, member: int) -> None:
        self._subjects = subjects
        self._member = np.array([member])

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return self._subjects.density.names

    def left_out(self, points: Array) -> Array:
        """Log density of the subject's trials given the others, at coordinates (W, d): shape (W,)."""
        parts = [
            self._subjects.left_out(scales, self._member).log_density[:, 0]
            for _, scales in self._subjects.batches(points)
        ]
        return np.concatenate(parts)

    def __call__(self, points: Array) -> Array:
        """Log posterior density without the subject at coordinates (W, d), shape (W,)."""
        value = self._subjects.density(points)
        possible = np.isfinite(value)
        if possible.any():
            value[possible] -= self.left_out(points[possible])
        # Scatter so small that doubles cannot leave the subject out has no posterior mass to lose.
        return np.where(np.isnan(value), -np.inf, value)


def sample_without(
    subjects: SubjectDensity,
    member: int,
    name: str,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Refit | None:
    """Sample the posterior without one subject; None where the gate fails."""
    from percept.inference.sampling.run import sample

    target = Without(subjects, member)
    estimand = Means((f"log density of {name} left out",), lambda points: target.left_out(points)[:, None])
    run = sample(target, estimand, settings, progress=progress)
    if not run.gate.passed:
        return None
    points = np.concatenate(run.independent())
    log_density = target.left_out(points)
    largest = log_density.max()
    relative = np.exp(log_density - largest)
    error = relative.std(ddof=1) / relative.mean() / np.sqrt(relative.size)
    return Refit(float(largest + np.log(relative.mean())), float(error), points)
