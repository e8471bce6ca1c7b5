"""The posterior without one subject, sampled where reweighting the whole study's draws cannot reach it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.checks.subjects import SubjectDensity, batches
from percept.inference.sampling.estimands import Means
from percept.inference.sampling.records import Progress, Settings

Array = NDArray[np.float64]


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
        layout = self._subjects.density.layout
        found = [
            self._subjects.left_out(layout.scales(np.ascontiguousarray(points[cut].T)), self._member)
            for cut in batches(len(points), self._subjects)
        ]
        return np.concatenate([part.log_density[:, 0] for part in found])

    def watched(self, points: Array) -> Array:
        """`left_out` as a column, shape (W, 1)."""
        return self.left_out(points)[:, None]

    def __call__(self, points: Array) -> Array:
        """Log posterior density without the subject at coordinates (W, d), shape (W,)."""
        value = self._subjects.density(points)
        possible = np.isfinite(value)
        if possible.any():
            value[possible] -= self.left_out(points[possible])
        # Scatter so small that doubles cannot leave the subject out has no posterior mass to lose.
        return np.where(np.isnan(value), -np.inf, value)


@dataclasses.dataclass(frozen=True, eq=False)
class Anew:
    """A subject left out by sampling."""

    log_density: float  # Log predictive density of the subject's trials given the others
    error: float  # Its Monte Carlo standard error, in nats
    points: Array  # (S, d) Draws of the posterior without the subject, thinned to their effective size


def sample_without(
    subjects: SubjectDensity,
    member: int,
    name: str,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Anew | None:
    """Sample the posterior without one subject."""
    from percept.inference.sampling.run import sample

    target = Without(subjects, member)
    watched = Means((f"log density of {name} left out",), target.watched)
    run = sample(target, watched, settings, progress=progress)
    if not run.gate.passed:
        return None
    points = np.concatenate(run.independent())
    log_density = target.left_out(points)
    largest = log_density.max()
    relative = np.exp(log_density - largest)
    error = relative.std(ddof=1) / relative.mean() / np.sqrt(relative.size)
    return Anew(float(largest + np.log(relative.mean())), float(error), points)
