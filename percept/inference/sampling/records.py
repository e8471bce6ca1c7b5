"""What a sampling run is asked, tells on its way, and gives."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.sampling.estimands import Estimates

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """How to sample."""

    tolerance: float = 0.01
    seed: int = 1  # Seed of the whole run
    ensembles: int = 4  # Independent ensembles, at least 4
    walkers: int | None = None  # Walkers per ensemble
    most_steps: int = 20_000  # Steps per ensemble at which the run ends, whatever its error

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise UsageError("must lie in (0, 1).", key="tolerance", value=self.tolerance)
        if self.ensembles < 4:
            raise UsageError("must be at least 4.", key="ensembles", value=self.ensembles)
        if self.seed < 0:
            raise UsageError("must be zero or positive.", key="seed", value=self.seed)
        if self.most_steps < 1:
            raise UsageError("must be at least 1.", key="most_steps", value=self.most_steps)
        if self.walkers is not None and self.walkers < 64:
            raise UsageError("must be at least 64.", key="walkers", value=self.walkers)


@dataclasses.dataclass(frozen=True)
class Gate:
    """Verdict on a run."""

    passed: bool  # Whether the run has mixed, so that its numbers may be reported with their errors
    reasons: tuple[str, ...]  # What failed
    rhat: float | None  # Largest rank R-hat across ensembles
    autocorrelation_time: float  # Longest autocorrelation time of a reported quantity, in steps
    times_run: float  # Kept steps per ensemble over that time, of a long run's last part
    effective_draws: float  # Effective draws of the slowest reported quantity
    acceptance: float  # Mean acceptance fraction
    lowest_acceptance: float  # Of the slowest walker
    worst_error: float  # Largest Monte Carlo error over half-width
    worst: str  # The estimate it belongs to
    tolerance_met: bool  # Whether that error is within the tolerance
    error_reached: str  # A sentence on the error where it misses the tolerance, else empty


@dataclasses.dataclass(frozen=True)
class Progress:
    """State of a run, told after every round."""

    steps: int  # Steps per ensemble so far
    expected_steps: int  # Steps per ensemble the run is expected to need
    worst_error: float
    tolerance: float


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A finished run."""

    points: Array  # (E, T, W, d) Kept coordinates, one in `stride` steps
    components: Array  # (E, T, W, C) What the estimands keep per draw
    estimates: Estimates  # What was asked for
    errors: Array  # (Q,) Monte Carlo standard errors
    times: Array  # (Q,) Autocorrelation times of the influence functions, in steps
    gate: Gate  # The verdict
    steps: int
    stride: int
    settings: Settings  # As asked

    def thinned(self) -> NDArray[np.intp]:
        """Return indices (E, N) of positions thinned to the effective size, walkers flattened into steps."""
        ensembles, length, walkers, _ = self.points.shape
        gap = max(1, round(self.gate.autocorrelation_time / self.stride))
        positions = np.arange(gap - 1, length, gap) if length >= gap else np.array([length - 1])
        index = (positions[:, None] * walkers + np.arange(walkers)).ravel()
        return np.broadcast_to(index, (ensembles, index.size))

    def independent(self) -> Array:
        """Return kept positions thinned to the effective size, (E, N, d)."""
        flat = self.points.reshape(len(self.points), -1, self.points.shape[-1])
        return flat[np.arange(len(flat))[:, None], self.thinned()]
