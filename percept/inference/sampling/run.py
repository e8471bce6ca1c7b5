"""Sample until every reported endpoint is as accurate as asked and the gate passes."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Checked, Target
from percept.inference.sampling.diagnostics import autocorrelation_time, monte_carlo_error, normal_scores
from percept.inference.sampling.ensembles import Ensembles, advance, start
from percept.inference.sampling.estimands import Estimands
from percept.inference.sampling.gate import TIMES_NEEDED, pass_gate
from percept.inference.sampling.records import Gate, Progress, Run, Settings
from percept.inference.sampling.transported import Transported
from percept.inference.sampling.warmup import warm_up

__all__ = ["Gate", "Progress", "Run", "Settings", "sample"]

Array = NDArray[np.float64]
_BURN_IN = 24
_FIRST_ROUND = 96
_STRIDE = 3  # steps between kept positions, a fraction of an autocorrelation time
_KEPT_LIMIT = 1 << 18  # kept draws over all ensembles; beyond it every second one goes


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
    target = Checked(target)
    dimension = len(target.names)
    walkers = settings.walkers or max(64, 2 * (dimension + 1))
    warm_seed, run_seed = np.random.SeedSequence(settings.seed).spawn(2)
    here, points = warm_up(target, (settings.ensembles, walkers), warm_seed)
    state, _ = advance(here, start(here, points, run_seed), steps=_BURN_IN, stride=_BURN_IN)
    record = _Record(estimands)
    wanted = _FIRST_ROUND
    while True:
        state = record.extend(here, state, wanted)
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
        self.stride = _STRIDE

    @property
    def steps(self) -> int:
        """Steps the kept positions span."""
        return 0 if self._points is None else self._points.shape[1] * self.stride

    def extend(self, here: Transported, state: Ensembles, steps: int) -> Ensembles:
        """Run every ensemble for at least `steps` and keep what is needed."""
        steps = max(self.stride, math.ceil(steps / self.stride) * self.stride)
        state, points = advance(here, state, steps=steps, stride=self.stride)
        flat = here.map(points.reshape(-1, points.shape[-1]))
        points = flat.reshape(points.shape)
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
        estimates = self._estimands.estimate(components.reshape(-1, components.shape[-1]))
        influence = estimates.influence.reshape(*components.shape[:3], -1)
        varying = np.ptp(components, axis=(0, 1, 2)) > 0
        # Ranks: a heavy tail would make the autocorrelation that of its few extreme draws.
        watched = np.concatenate([influence, normal_scores(components[..., varying])], axis=3)
        times = autocorrelation_time(watched)
        own = times[: influence.shape[3]]
        errors = monte_carlo_error(influence, own)
        moved = np.ptp(points[:, points.shape[1] // 2 :, :, 0], axis=1) > 0
        gate = pass_gate(
            settings, estimates, errors, watched, times, state.accepted / state.steps, moved,
            stride=self.stride, last=state.steps >= settings.most_steps,
        )  # fmt: skip
        return Run(
            points, components, estimates, errors, own * self.stride, gate, state.steps, self.stride, settings
        )

    def steps_needed(self, judged: Run, settings: Settings) -> int:
        """Predict the steps the run should span in all; it at least grows by a tenth."""
        ratio = judged.gate.worst_error / settings.tolerance
        by_error = self.steps * ratio * ratio * 1.1 if math.isfinite(ratio) else 2.0 * self.steps
        by_time = 1.2 * TIMES_NEEDED * judged.gate.autocorrelation_time
        by_time = by_time if math.isfinite(by_time) else 2.0 * self.steps
        grown = 1.1 * self.steps if judged.gate.passed is False else self.steps
        return math.ceil(min(max(by_error, by_time, grown), 4.0 * self.steps))
