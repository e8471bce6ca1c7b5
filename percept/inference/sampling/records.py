"""What a sampling run is asked, tells on its way, and gives."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.sampling.estimands import Estimates

__all__ = ["Gate", "Progress", "Run", "Settings"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """How to sample.

    Attributes
    ----------
    tolerance : float
        Monte Carlo standard error of every endpoint, as a fraction of its interval's half-width on
        the model's scale.
    seed : int
        Seed of the whole run; every ensemble has a stream of its own.
    ensembles : int
        Independent ensembles, at least 4.
    walkers : int or None
        Walkers per ensemble; None for as many as coordinates and accuracy need, 64 at least.
    most_steps : int
        Steps per ensemble at which the run ends, whatever its error; a long one sooner, where too few are
        left for a part.
    """

    tolerance: float = 0.01
    seed: int = 1
    ensembles: int = 4
    walkers: int | None = None
    most_steps: int = 20_000

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
    """Verdict on a run.

    Attributes
    ----------
    passed : bool
        Whether the run has mixed, so that its numbers may be reported with their errors.
    reasons : tuple of str
        What failed; empty where it passed.
    rhat : float or None
        Largest rank R-hat across ensembles; None where the estimates are not accurate enough for it to
        matter.
    autocorrelation_time : float
        Longest autocorrelation time of a reported quantity, in steps.
    times_run : float
        Kept steps per ensemble over that time, of a long run's last part.
    effective_draws : float
        Effective draws of the slowest reported quantity.
    acceptance : float
        Mean acceptance fraction.
    lowest_acceptance : float
        Of the slowest walker.
    worst_error : float
        Largest Monte Carlo error over half-width.
    worst : str
        The estimate it belongs to.
    tolerance_met : bool
        Whether that error is within the tolerance; a run that ends at its cap may mix and miss it.
    error_reached : str
        A sentence on the error where it misses the tolerance, else empty.
    """

    passed: bool
    reasons: tuple[str, ...]
    rhat: float | None
    autocorrelation_time: float
    times_run: float
    effective_draws: float
    acceptance: float
    lowest_acceptance: float
    worst_error: float
    worst: str
    tolerance_met: bool
    error_reached: str


@dataclasses.dataclass(frozen=True)
class Progress:
    """State of a run, told after every round.

    Attributes
    ----------
    steps : int
        Steps per ensemble so far.
    expected_steps : int
        Steps per ensemble the run is expected to need.
    worst_error, tolerance : float
        Largest Monte Carlo error over half-width, and what is asked.
    """

    steps: int
    expected_steps: int
    worst_error: float
    tolerance: float


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A finished run.

    Attributes
    ----------
    points : ndarray, shape (E, T, W, d)
        Kept coordinates, one in `stride` steps.
    components : ndarray, shape (E, T, W, C)
        What the estimands keep per draw.
    estimates : Estimates
        What was asked for.
    errors : ndarray, shape (Q,)
        Monte Carlo standard errors.
    times : ndarray, shape (Q,)
        Autocorrelation times of the influence functions, in steps.
    gate : Gate
        The verdict.
    steps, stride : int
        Steps per ensemble in all, and steps between kept positions.
    settings : Settings
        As asked.
    """

    points: Array
    components: Array
    estimates: Estimates
    errors: Array
    times: Array
    gate: Gate
    steps: int
    stride: int
    settings: Settings

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
