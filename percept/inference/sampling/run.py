"""Sample until every reported endpoint is as accurate as asked and the gate passes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    rank_rhat,
)
from percept.inference.sampling.ensembles import Ensembles, Target, advance, start
from percept.inference.sampling.estimands import Estimands, Estimates
from percept.inference.sampling.proposal import Proposal
from percept.inference.sampling.warmup import warm_up

__all__ = ["Gate", "Progress", "Run", "Settings", "sample"]

Array = NDArray[np.float64]
_RHAT_LIMIT = 1.01
_TIMES_NEEDED = 10.0
_BURN_IN = 40
_FIRST_ROUND = 120
_KEPT_LIMIT = 1 << 18  # kept draws over all ensembles; beyond it every second one goes
_STUCK = 0.005  # acceptance below which a walker counts as stuck


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
        Walkers per ensemble; None for the larger of 64 and twice the dimension.
    most_steps : int
        Steps per ensemble at which the run gives up.
    """

    tolerance: float = 0.01
    seed: int = 1
    ensembles: int = 4
    walkers: int | None = None
    most_steps: int = 20_000

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise UsageError("must lie in (0, 1).", column="tolerance", value=self.tolerance)
        if self.ensembles < 4:
            raise UsageError("must be at least 4.", column="ensembles", value=self.ensembles)
        if self.walkers is not None and self.walkers < 64:
            raise UsageError("must be at least 64.", column="walkers", value=self.walkers)


@dataclasses.dataclass(frozen=True)
class Gate:
    """Verdict on a run.

    Attributes
    ----------
    passed : bool
        Whether the numbers may be reported.
    reasons : tuple of str
        What failed, each with what to do.
    rhat : float
        Largest rank R-hat across ensembles.
    autocorrelation_time : float
        Longest autocorrelation time of a reported quantity, in steps.
    times_run : float
        Kept steps per ensemble over that time.
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
    """

    passed: bool
    reasons: tuple[str, ...]
    rhat: float
    autocorrelation_time: float
    times_run: float
    effective_draws: float
    acceptance: float
    lowest_acceptance: float
    worst_error: float
    worst: str


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
        Estimates with their influence functions.
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


def sample(
    target: Target,
    estimands: Estimands,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Run:
    """Sample a target with emcee to a stated accuracy.

    Parameters
    ----------
    target : Target
        Log density, in coordinates of about unit scale centred near zero.
    estimands : Estimands
        What is to be estimated.
    settings : Settings
        Accuracy, seed, caps.
    progress : callable, optional
        Told the state after every round.

    Returns
    -------
    Run

    Raises
    ------
    RefusalError
        If the density is NaN, or -inf at every walker.
    """
    dimension = len(target.names)
    walkers = settings.walkers or max(64, 2 * (dimension + 1))
    warm_seed, run_seed = np.random.SeedSequence(settings.seed).spawn(2)
    law, points = warm_up(target, (settings.ensembles, walkers), warm_seed)
    state, _ = advance(target, law, start(target, points, run_seed), steps=_BURN_IN, stride=_BURN_IN)
    record = _Record(estimands)
    wanted = _FIRST_ROUND
    while True:
        state = record.extend(target, law, state, wanted)
        judged = record.judge(state, settings)
        needed = record.steps_needed(judged, settings)
        if progress:
            worst = judged.gate.worst_error
            progress(Progress(state.steps, _BURN_IN + needed, worst, settings.tolerance))
        if judged.gate.passed or state.steps >= settings.most_steps:
            return judged
        wanted = min(needed - record.steps, settings.most_steps - state.steps)


class _Record:
    """Kept positions and their components; memory is bounded by thinning as the run grows."""

    def __init__(self, estimands: Estimands) -> None:
        self._estimands = estimands
        self._points: Array | None = None
        self._components: Array | None = None
        self.stride = 3

    @property
    def steps(self) -> int:
        """Steps the kept positions span."""
        return 0 if self._points is None else self._points.shape[1] * self.stride

    def extend(self, target: Target, law: Proposal, state: Ensembles, steps: int) -> Ensembles:
        """Run every ensemble for at least `steps` and keep what is needed."""
        steps = max(self.stride, math.ceil(steps / self.stride) * self.stride)
        state, points = advance(target, law, state, steps=steps, stride=self.stride)
        flat = points.reshape(-1, points.shape[-1])
        components = self._estimands.components(flat).reshape(*points.shape[:3], -1)
        if self._points is not None and self._components is not None:
            points = np.concatenate([self._points, points], axis=1)
            components = np.concatenate([self._components, components], axis=1)
        while points[..., 0].size > _KEPT_LIMIT:
            points, components = points[:, 1::2], components[:, 1::2]
            self.stride *= 2
        self._points, self._components = points, components
        return state

    def judge(self, state: Ensembles, settings: Settings) -> Run:
        """Estimate, measure and pass the gate or not."""
        assert self._points is not None
        assert self._components is not None
        points, components = self._points, self._components
        shape = components.shape[:3]
        estimates = self._estimands.estimate(components.reshape(-1, components.shape[-1]))
        influence = estimates.influence.reshape(*shape, -1)
        varying = np.ptp(components, axis=(0, 1, 2)) > 0
        # Ranks: a heavy tail would make the autocorrelation that of its few extreme draws.
        watched = np.concatenate([influence, normal_scores(components[..., varying])], axis=3)
        times = autocorrelation_time(watched)
        count = influence.shape[3]
        errors = monte_carlo_error(influence, times[:count])
        slowest = float(times.max())
        gap = max(1, round(min(slowest, shape[1] / 4.0)))
        rhat = rank_rhat(watched[:, ::gap].reshape(shape[0], -1, watched.shape[3]))
        gate = self._gate(state, settings, estimates, errors, slowest, float(rhat.max()), shape)
        return Run(
            points, components, estimates, errors, times[:count] * self.stride, gate,
            state.steps, self.stride, settings,
        )  # fmt: skip

    def _gate(
        self,
        state: Ensembles,
        settings: Settings,
        estimates: Estimates,
        errors: Array,
        slowest: float,
        rhat: float,
        shape: tuple[int, ...],
    ) -> Gate:
        relative = errors / estimates.scale
        worst = int(np.argmax(relative))
        accepted = state.accepted / state.steps
        times_run = shape[1] / slowest
        reasons = []
        if not rhat < _RHAT_LIMIT:
            reasons.append(f"the ensembles disagree: rank R-hat {rhat:.4f}, limit {_RHAT_LIMIT}.")
        if not times_run >= _TIMES_NEEDED:
            reasons.append(
                f"the run spans {times_run:.1f} autocorrelation times of its slowest quantity; "
                f"{_TIMES_NEEDED:g} are needed."
            )
        if accepted.min() < _STUCK:
            reasons.append(f"a walker is stuck: it accepted {accepted.min():.2%} of its proposals.")
        if not relative[worst] <= settings.tolerance:
            reasons.append(
                f"{estimates.names[worst]} has a Monte Carlo error of {relative[worst]:.2%} of its "
                f"half-width; {settings.tolerance:.2%} was asked. Raise the cap on steps or the tolerance."
            )
        return Gate(
            passed=not reasons,
            reasons=tuple(reasons),
            rhat=rhat,
            autocorrelation_time=slowest * self.stride,
            times_run=times_run,
            effective_draws=shape[0] * shape[1] * shape[2] / slowest,
            acceptance=float(accepted.mean()),
            lowest_acceptance=float(accepted.min()),
            worst_error=float(relative[worst]),
            worst=estimates.names[worst],
        )

    def steps_needed(self, judged: Run, settings: Settings) -> int:
        """Predict the steps the run should span in all; it at least grows by a tenth."""
        ratio = judged.gate.worst_error / settings.tolerance
        by_error = self.steps * ratio * ratio * 1.1 if math.isfinite(ratio) else 2.0 * self.steps
        by_time = 1.2 * _TIMES_NEEDED * judged.gate.autocorrelation_time
        by_time = by_time if math.isfinite(by_time) else 2.0 * self.steps
        grown = 1.1 * self.steps if judged.gate.passed is False else self.steps
        return math.ceil(min(max(by_error, by_time, grown), 4.0 * self.steps))
