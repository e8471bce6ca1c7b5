"""The posterior without one subject, sampled where reweighting the whole study's draws cannot reach it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.subjects import SubjectDensity, batches
from percept.inference.hierarchy import coordinates
from percept.inference.sampling.estimands import Estimates
from percept.inference.sampling.records import Progress, Run, Settings

__all__ = ["Without", "sample_without"]

Array = NDArray[np.float64]


class Without:
    """Posterior of the scales given all subjects but one, in the coordinates of the whole study.

    Parameters
    ----------
    subjects : SubjectDensity
        The model and the subjects.
    member : int
        The subject to leave out.
    """

    def __init__(self, subjects: SubjectDensity, member: int) -> None:
        self._subjects = subjects
        self._member = np.array([member])

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return self._subjects.density.names

    def left_out(self, points: Array) -> Array:
        """Log density of the subject's trials given the others, at coordinates (W, d): shape (W,)."""
        layout = self._subjects.density.layout
        found = [
            self._subjects.left_out(layout.scales(np.ascontiguousarray(points[cut].T)), self._member)
            for cut in batches(len(points), self._subjects)
        ]
        return np.concatenate([part.log_density[:, 0] for part in found])

    def __call__(self, points: Array) -> Array:
        """Log posterior density without the subject at coordinates (W, d), shape (W,)."""
        value = self._subjects.density(points)
        possible = np.isfinite(value) & (np.max(np.abs(points), axis=1) <= coordinates.LIMIT)
        if possible.any():
            value[possible] -= self.left_out(points[possible])
        return value


@dataclasses.dataclass(frozen=True)
class _LogPredictive:
    """The log of the mean predictive density, to an absolute error."""

    target: Without
    name: str

    def components(self, points: Array) -> Array:
        """Log density per draw, shape (W, 1)."""
        return self.target.left_out(points)[:, None]

    def estimate(self, components: Array) -> Estimates:
        """Its log mean exponential; one nat is the unit of its error."""
        largest = components.max()
        relative = np.exp(components - largest)
        mean = relative.mean(axis=0)
        return Estimates((self.name,), largest + np.log(mean), np.ones(1), relative / mean - 1.0)


def sample_without(
    subjects: SubjectDensity,
    member: int,
    name: str,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Run:
    """Sample the posterior without one subject.

    Parameters
    ----------
    subjects : SubjectDensity
        The model and the subjects.
    member : int
        The subject to leave out.
    name : str
        Its name, for messages.
    settings : Settings
        Accuracy (the tolerance is the error of the log predictive density, in nats), seed and caps.
    progress : callable, optional
        Told the state after every round.

    Returns
    -------
    Run
        Its only estimate is the subject's log predictive density.
    """
    from percept.inference.sampling.run import sample

    target = Without(subjects, member)
    return sample(
        target, _LogPredictive(target, f"log predictive density of {name}"), settings, progress=progress
    )
