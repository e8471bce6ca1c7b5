"""Sample until the gate passes and every reported endpoint is as accurate as asked, or to a cap of steps.

A run that will be long begins anew after its first round, which then counts as warm-up: a transport fitted to
that round's draws shortens the autocorrelation time by about a third. What a run holds in memory is bounded:
when that is full and has settled, it is closed as a part of the run, and the estimates are means over parts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.endpoints import Estimands
from percept.inference.sampling.gate import (
    TIMES_NEEDED,
    Gate,
    Judged,
    Progress,
    Run,
    Settings,
    judge,
    pass_gate,
)
from percept.inference.sampling.moves import Ensembles, advance, start
from percept.inference.sampling.transport import Affine, Checked, Target, Transport, Transported
from percept.inference.sampling.warmup import refine, warm_up

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Closed:
    """Parts of a run that were judged and settled: their estimates, and some of their positions.

    Estimates of parts are averaged, which costs a bias of the order of a part's squared Monte Carlo error.
    """

    steps: int  # Steps per ensemble they span
    value: Array  # (Q,)
    error: Array  # (Q,)
    points: Array  # (E, T, W, d) Kept coordinates of the target
    components: Array  # (E, T, W, C) What the estimands keep per draw
    stride: int  # Steps between kept positions

    def judged(self, part: Judged, steps: int) -> Judged:
        """Average with the estimates of the next part, by steps; errors are those of independent parts."""
        share = steps / (self.steps + steps)
        value = self.value + share * (part.estimates.value - self.value)
        together = np.hypot((1.0 - share) * self.error, share * part.errors)
        return dataclasses.replace(
            part, estimates=dataclasses.replace(part.estimates, value=value), errors=together
        )

    def positions(self, points: Array, components: Array, stride: int, most: int) -> tuple[Array, Array, int]:
        """Append the next part's positions, thinned to one stride and to `most` of a walker in all."""
        common = max(stride, self.stride)
        while True:
            parts = ((self.points, self.components, self.stride), (points, components, stride))
            if sum(kept.shape[1] // (common // own) for kept, _, own in parts) <= most:
                break
            common *= 2
        gaps = [common // own for *_, own in parts]
        all_points = [kept[:, gap - 1 :: gap] for (kept, _, _), gap in zip(parts, gaps, strict=True)]
        all_components = [kept[:, gap - 1 :: gap] for (_, kept, _), gap in zip(parts, gaps, strict=True)]
        return np.concatenate(all_points, axis=1), np.concatenate(all_components, axis=1), common


_BURN_IN = 24
_FIRST_ROUND = 144
#: A run predicted to take so many times its first round begins anew, with a transport fitted to that round.
_WORTH_REFINING = 3.0
#: Times a run may begin anew: each transport follows many coordinates better than the one before.
_MOST_REFINED = 4
#: Autocorrelation times after that, as a fraction of those before.
_SHORTER = 0.65
#: How many times the walkers a refined run may have: array calls cost least for some thousand positions.
_MORE_WALKERS = (1, 2, 4, 8)
#: Steps that a refined run aims at, and of its first round at least.
_REFINED_STEPS, _REFINED_ROUND = 168, 96
#: Steps between kept positions, a fraction of an autocorrelation time. Keeping and judging a position takes
#: as long as a few steps: long runs keep fewer.
_STRIDE, _REFINED_STRIDE = 3, 6
_SEGMENT = 480  # steps whose positions are mapped at once
#: Kept draws of a part of a run over all ensembles, and numbers worked out from them.
_KEPT_LIMIT, _NUMBERS_LIMIT = 1 << 17, 1 << 26
#: Positions a part may have whatever that takes: in fewer it could not span ten autocorrelation times.
_FEWEST_POSITIONS = 32
#: Walkers of an ensemble.
_WALKERS = 64


def sample(
    target: Target,
    estimands: Estimands,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Run:
    """Sample a target with emcee to a stated accuracy."""
    target = Checked(target)
    warm_seed, run_seed, *_ = _seeds(settings)
    here, points = warm_up(target, (settings.ensembles, settings.walkers or _WALKERS), warm_seed)
    begun = _burnt_in(here, points, run_seed, estimands, _STRIDE, _FIRST_ROUND, refined=0)
    run = _Running(target, estimands, begun)
    while True:
        while run.steps < run.goal:
            run.extend(min(_SEGMENT, run.goal - run.steps))
        judged = run.judge(settings)
        needed = run.steps_needed(judged, settings)
        if progress:
            worst = judged.gate.worst_error
            progress(Progress(run.state.steps, _BURN_IN + needed, worst, settings.tolerance))
        if judged.gate.passed and judged.gate.tolerance_met:
            return judged
        if run.at_its_end(judged, settings):
            return judged
        # Once for accuracy; again only where walkers are slow.
        wanted = _steps_to_settle(judged) if run.refined else needed
        if run.refined < _MOST_REFINED and wanted > _WORTH_REFINING * run.spanned:
            by_error = run.steps_by_error(judged, settings)
            begun = _refined(target, estimands, settings, judged, by_error, run.refined)
            run = _Running(target, estimands, begun)
        else:
            run.go_on(judged, needed, settings)


def _seeds(settings: Settings) -> list[np.random.SeedSequence]:
    """Seeds of the warm-up and of the run, and the same for every refinement."""
    return np.random.SeedSequence(settings.seed).spawn(2 + 2 * _MOST_REFINED)


def _refined(
    target: Target, estimands: Estimands, settings: Settings, judged: Run, by_error: float, before: int
) -> Begun:
    """Begin anew with a transport fitted to kept positions, and keep none of them.

    As many walkers as those of the positions would need `by_error` steps for the tolerance; the run was
    refined so many times before.
    """
    warm_seed, run_seed = _seeds(settings)[2 + 2 * before : 4 + 2 * before]
    ensembles, _, walkers, dimension = judged.points.shape
    steps = _SHORTER * by_error
    if not settings.walkers:
        # No fewer steps than the autocorrelation time asks for, whatever the number of walkers.
        wanted = max(_REFINED_STEPS, _SHORTER * _steps_to_settle(judged))
        work = steps * walkers
        walkers = _WALKERS * min(_MORE_WALKERS, key=lambda n: abs(math.log(work / (n * _WALKERS * wanted))))
        steps = work / walkers
    rng = np.random.default_rng(warm_seed)
    here, points = refine(target, judged.points.reshape(-1, dimension), (ensembles, walkers), rng)
    predicted = min(steps, 4.0 * _REFINED_ROUND, settings.most_steps - _BURN_IN)
    first = math.ceil(max(predicted, _REFINED_ROUND))
    return _burnt_in(here, points, run_seed, estimands, _REFINED_STRIDE, first, refined=before + 1)


def _burnt_in(
    here: Transported,
    points: Array,
    seed: np.random.SeedSequence,
    estimands: Estimands,
    stride: int,
    goal: int,
    *,
    refined: int,
) -> Begun:
    """Burn in from starting points."""
    state, _ = advance(here, start(here, points, seed), steps=_BURN_IN, stride=_BURN_IN)
    ensembles, walkers, dimension = points.shape
    count = estimands.components(here.map(points[0, :1])).shape[1]
    nothing, components = (np.empty((ensembles, 0, walkers, size)) for size in (dimension, count))
    return Begun(here.transport, state, nothing, components, stride, goal, refined)


@dataclasses.dataclass(frozen=True, eq=False)
class Begun:
    """A run after its warm-up and burn-in, before any position is kept."""

    transport: Affine | Transport
    state: Ensembles
    points: Array  # (E, 0, W, d)
    components: Array  # (E, 0, W, C)
    stride: int  # steps between kept positions
    goal: int  # steps the kept positions must span before they are judged
    refined: int  # how many times a round became part of the warm-up
    closed: Closed | None = None  # what is left of the segments before


class _Running:
    """Kept positions of the part at work, their components, and what is left of the parts before it."""

    def __init__(self, target: Target, estimands: Estimands, begun: Begun) -> None:
        self._here = Transported(target, begun.transport)
        self._estimands = estimands
        self.state = begun.state
        self._points, self._components = begun.points, begun.components
        self.stride, self.goal, self.refined = begun.stride, begun.goal, begun.refined
        self._closed = begun.closed
        ensembles, _, walkers, dimension = begun.points.shape
        # Every component has two influences or so.
        numbers = dimension + 3 * begun.components.shape[-1]
        most = min(_KEPT_LIMIT, _NUMBERS_LIMIT // numbers) // (ensembles * walkers)
        self._most = max(most, _FEWEST_POSITIONS)
        self.goal = min(self.goal, self._most * self.stride)

    @property
    def steps(self) -> int:
        """Steps the kept positions of the part at work span."""
        return self._points.shape[1] * self.stride

    @property
    def spanned(self) -> int:
        """Steps all parts span."""
        return self.steps + (self._closed.steps if self._closed else 0)

    @property
    def _full(self) -> bool:
        return self._points.shape[1] >= self._most

    def extend(self, steps: int) -> None:
        """Run every ensemble for at least `steps` and keep what is needed."""
        steps = max(self.stride, math.ceil(steps / self.stride) * self.stride)
        self.state, walked = advance(self._here, self.state, steps=steps, stride=self.stride)
        # In one order of memory: the last bits of sums depend on it.
        flat = np.ascontiguousarray(self._here.map(walked.reshape(-1, walked.shape[-1])))
        components = np.ascontiguousarray(self._estimands.components(flat))
        points, components = flat.reshape(walked.shape), components.reshape(*walked.shape[:3], -1)
        if not self._points.shape[1]:
            # Without a copy: it may be as large as memory allows.
            self._points, self._components = points, components
            return
        self._points = np.concatenate([self._points, points], axis=1)
        self._components = np.concatenate([self._components, components], axis=1)

    def at_its_end(self, judged: Run, settings: Settings) -> bool:
        """Whether no steps are left, or too few to judge another part by."""
        left = settings.most_steps - self.state.steps
        if not self._full:
            return left < 1
        # A last part too short to settle would take the verdict from the parts before it.
        least = _steps_to_settle(judged) if _settled(judged.gate) else 0
        return left < max(least, _FEWEST_POSITIONS * self.stride)

    def go_on(self, judged: Run, needed: int, settings: Settings) -> None:
        """Make room where memory is full, and set the next goal."""
        if self._full and _settled(judged.gate):
            self._closed = Closed(
                self.spanned, judged.estimates.value, judged.errors,
                judged.points, judged.components, judged.stride,
            )  # fmt: skip
            self._points, self._components = self._points[:, :0], self._components[:, :0]
        elif self._full:
            # Contiguous, as they are when taken up again: a sum's last bits depend on the order in memory.
            self._points, self._components = (
                np.ascontiguousarray(kept[:, 1::2]) for kept in (self._points, self._components)
            )
            self.stride *= 2
        left = max(needed - (self.spanned - self.steps), _steps_to_settle(judged))
        self.goal = min(left, self._most * self.stride, self.steps + settings.most_steps - self.state.steps)

    def judge(self, settings: Settings) -> Run:
        """Estimate, measure and pass the gate or not."""
        points, components, stride, state = self._points, self._components, self.stride, self.state
        # Of a later part R-hat must be known whatever its own errors: together with the parts before it is
        # more accurate than alone.
        # At the cap it decides alone whether the numbers are given.
        last = self.state.steps >= settings.most_steps
        full = self._full or self._closed is not None or last
        judged = judge(self._estimands, components, settings.tolerance, full=full)
        moved = np.ptp(points[:, points.shape[1] // 2 :, :, 0], axis=1) > 0
        if self._closed:
            judged = self._closed.judged(judged, self.steps)
            points, components, stride = self._closed.positions(points, components, stride, self._most)
        gate = pass_gate(
            settings, judged, state.accepted / state.steps, moved,
            length=self._points.shape[1], stride=self.stride, spanned=self.spanned,
        )  # fmt: skip
        times = judged.times * self.stride
        return Run(
            points, components, judged.estimates, judged.errors, times, gate, state.steps, stride, settings
        )

    def steps_by_error(self, judged: Run, settings: Settings) -> float:
        """Predict the steps after which the estimates are accurate enough."""
        ratio = judged.gate.worst_error / settings.tolerance
        return self.spanned * (ratio * ratio * 1.1 if math.isfinite(ratio) else 2.0)

    def steps_needed(self, judged: Run, settings: Settings) -> int:
        """Predict the steps the run should span in all; it at least grows by a tenth."""
        spanned = self.spanned
        by_error = self.steps_by_error(judged, settings)
        by_time = spanned - self.steps + _steps_to_settle(judged)
        return math.ceil(min(max(by_error, by_time, 1.1 * spanned), 4.0 * spanned))


def _settled(gate: Gate) -> bool:
    """Whether a part has mixed; R-hat is worked out whenever memory is full."""
    return gate.passed and gate.rhat is not None


def _steps_to_settle(judged: Run) -> int:
    """Predict the steps a part must span."""
    time = judged.gate.autocorrelation_time
    return math.ceil(1.2 * TIMES_NEEDED * time) if math.isfinite(time) else 0
