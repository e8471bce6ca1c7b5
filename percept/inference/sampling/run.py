"""Sample until every reported endpoint is as accurate as asked and the gate passes.

A run that will be long begins anew after its first round, which then counts as warm-up: a transport fitted to
that round's draws shortens the autocorrelation time by about a third.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.checked import Checked, Target
from percept.inference.sampling.diagnostics import (
    autocorrelation_time,
    monte_carlo_error,
    normal_scores,
    some_walkers,
)
from percept.inference.sampling.ensembles import advance, start
from percept.inference.sampling.estimands import Estimands
from percept.inference.sampling.gate import TIMES_NEEDED, pass_gate
from percept.inference.sampling.records import Gate, Progress, Run, Settings
from percept.inference.sampling.transported import Transported
from percept.inference.sampling.unfinished import Keeper, Saver, Unfinished
from percept.inference.sampling.warmup import refine, warm_up

__all__ = ["Gate", "Progress", "Run", "Settings", "sample"]

Array = NDArray[np.float64]
_BURN_IN = 24
_FIRST_ROUND = 144
#: A run predicted to take so many times its first round begins anew, with a transport fitted to that round.
_WORTH_REFINING = 3.0
#: It then has so many times the walkers, which share array calls, and a shorter first round.
_MORE_WALKERS, _REFINED_ROUND = 4, 96
_STRIDE = 3  # steps between kept positions, a fraction of an autocorrelation time
_PIECE = 480  # steps after which an unfinished run can be stored
#: Kept draws over all ensembles, and numbers worked out from them; beyond either every second draw goes.
_KEPT_LIMIT, _NUMBERS_LIMIT = 1 << 17, 1 << 26
#: Walkers an ensemble has for accuracy. Many coordinates need more, whose positions are not kept.
_WALKERS = 64


def sample(
    target: Target,
    estimands: Estimands,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    keeper: Keeper | None = None,
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
    keeper : Keeper, optional
        Given the unfinished run every few seconds and when it is interrupted; what it kept of an earlier
        attempt is taken up, and the result is the same in every digit.

    Returns
    -------
    Run

    Raises
    ------
    RefusalError
        If the density is NaN, or -inf at every walker.
    """
    target = Checked(target)
    kept = keeper.load() if keeper is not None else None
    run = _Running(target, estimands, kept or _begin(target, estimands, settings))
    with Saver(keeper) as saver:
        while True:
            while run.steps < run.goal:
                run.extend(min(_PIECE, run.goal - run.steps))
                saver.offer(run.unfinished())
            judged = run.judge(settings)
            needed = run.steps_needed(judged, settings)
            if progress:
                worst = judged.gate.worst_error
                progress(Progress(run.state.steps, _BURN_IN + needed, worst, settings.tolerance))
            if judged.gate.passed or run.state.steps >= settings.most_steps:
                return judged
            if not run.refined and needed > _WORTH_REFINING * run.steps:
                run = _Running(target, estimands, _refined(target, estimands, settings, judged.points))
            else:
                run.goal = min(needed, run.steps + settings.most_steps - run.state.steps)


def _seeds(settings: Settings) -> list[np.random.SeedSequence]:
    """Seeds of the warm-up and of the run, and the same for a run that begins anew."""
    return np.random.SeedSequence(settings.seed).spawn(4)


def _walkers(settings: Settings, dimension: int, *, refined: bool) -> tuple[int, int]:
    """Walkers of an ensemble, and of how many of them positions are kept."""
    if settings.walkers:
        return settings.walkers, settings.walkers
    least = 2 * (dimension + 1)
    kept = _WALKERS * (_MORE_WALKERS if refined and least <= _WALKERS else 1)
    return max(kept, least), kept


def _begin(target: Target, estimands: Estimands, settings: Settings) -> Unfinished:
    """Warm up, burn in, and keep nothing yet."""
    dimension = len(target.names)
    walkers, kept = _walkers(settings, dimension, refined=False)
    warm_seed, run_seed, *_ = _seeds(settings)
    here, points = warm_up(target, (settings.ensembles, walkers), warm_seed)
    return _burnt_in(here, points, run_seed, estimands, kept, refined=False)


def _refined(target: Target, estimands: Estimands, settings: Settings, kept: Array) -> Unfinished:
    """Begin anew with a transport fitted to kept positions (E, T, W, d), and keep none of them."""
    *_, warm_seed, run_seed = _seeds(settings)
    ensembles, *_, dimension = kept.shape
    walkers, keeping = _walkers(settings, dimension, refined=True)
    rng = np.random.default_rng(warm_seed)
    here, points = refine(target, kept.reshape(-1, dimension), (ensembles, walkers), rng)
    return _burnt_in(here, points, run_seed, estimands, keeping, refined=True)


def _burnt_in(
    here: Transported,
    points: Array,
    seed: np.random.SeedSequence,
    estimands: Estimands,
    kept: int,
    *,
    refined: bool,
) -> Unfinished:
    """Burn in from starting points; of so many walkers per ensemble positions will be kept."""
    state, _ = advance(here, start(here, points, seed), steps=_BURN_IN, stride=_BURN_IN)
    ensembles, _, dimension = points.shape
    nothing = np.empty((ensembles, 0, kept, dimension))
    components = np.empty((ensembles, 0, kept, estimands.components(here.map(points[0, :1])).shape[1]))
    first = _REFINED_ROUND if refined else _FIRST_ROUND
    return Unfinished(here.transport, state, nothing, components, _STRIDE, first, refined)


class _Running:
    """Kept positions and their components; memory is bounded by thinning as the run grows."""

    def __init__(self, target: Target, estimands: Estimands, begun: Unfinished) -> None:
        self._here = Transported(target, begun.transport)
        self._estimands = estimands
        self.state = begun.state
        self._points, self._components = begun.points, begun.components
        self.stride, self.goal, self.refined = begun.stride, begun.goal, begun.refined

    def unfinished(self) -> Unfinished:
        """Return all that is needed to go on from here."""
        return Unfinished(
            self._here.transport, self.state, self._points, self._components,
            self.stride, self.goal, self.refined,
        )  # fmt: skip

    @property
    def steps(self) -> int:
        """Steps the kept positions span."""
        return self._points.shape[1] * self.stride

    def extend(self, steps: int) -> None:
        """Run every ensemble for at least `steps` and keep what is needed."""
        steps = max(self.stride, math.ceil(steps / self.stride) * self.stride)
        walkers = self._points.shape[2]
        self.state, points = advance(self._here, self.state, steps=steps, stride=self.stride, walkers=walkers)
        flat = self._here.map(points.reshape(-1, points.shape[-1]))
        components = self._estimands.components(flat).reshape(*points.shape[:3], -1)
        points = np.concatenate([self._points, flat.reshape(points.shape)], axis=1)
        components = np.concatenate([self._components, components], axis=1)
        # Every component has two influences or so.
        numbers = points.shape[-1] + 3 * components.shape[-1]
        while points[..., 0].size > min(_KEPT_LIMIT, _NUMBERS_LIMIT // numbers):
            # Contiguous, as they are when taken up again: a sum's last bits depend on the order in memory.
            points, components = (np.ascontiguousarray(kept[:, 1::2]) for kept in (points, components))
            self.stride *= 2
        self._points, self._components = points, components

    def judge(self, settings: Settings) -> Run:
        """Estimate, measure and pass the gate or not."""
        points, components, state = self._points, self._components, self.state
        estimates = self._estimands.estimate(components.reshape(-1, components.shape[-1]))
        influence = estimates.influence.reshape(*components.shape[:3], -1)
        varying = np.ptp(components, axis=(0, 1, 2)) > 0
        own = autocorrelation_time(influence)
        errors = monte_carlo_error(influence, own)
        # Ranks: a heavy tail would make the autocorrelation that of its few extreme draws.
        scores = normal_scores(some_walkers(components[..., varying]))
        slowest = float(max(own.max(), autocorrelation_time(scores).max(initial=0.0)))
        moved = np.ptp(points[:, points.shape[1] // 2 :, :, 0], axis=1) > 0
        gate = pass_gate(
            settings, estimates, errors, (influence, scores), slowest, state.accepted / state.steps, moved,
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
