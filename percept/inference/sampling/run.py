"""Sample until the gate passes and every reported endpoint is as accurate as asked, or to a cap of steps.

A run that will be long begins again after its first round, which then counts as warm-up: a
transport fitted to its draws shortens the autocorrelation time by about a third. What a run holds
in memory is bounded: when that is full and has settled, it is closed as a part of the run, and the
estimates are means over parts.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.coordinates import Target, Transported
from percept.inference.sampling.estimands import Estimands
from percept.inference.sampling.gate import (
    TIMES_NEEDED,
    Judged,
    Progress,
    Run,
    Settings,
    judge,
    pass_gate,
)
from percept.inference.sampling.moves import Ensembles
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import starting_points, warm_up

Array = NDArray[np.float64]

#: Steps before any are kept, and of these the last, by which the shares of the moves are chosen.
_BURN_IN, _LEARNING = 40, 24
_FIRST_ROUND = 144
#: A run predicted to take this multiple of its first round begins again, with a transport fitted to
#: it. Later, half that is enough, times how much larger its sample is than the one of the transport
#: at work.
_WORTH_REFINING, _WORTH_AGAIN, _LARGER_SAMPLE = 3.0, 1.5, 6.0
#: Times a run may begin again: each transport follows many coordinates better than the one before.
_MOST_REFINED = 4
#: Autocorrelation times after that, as a fraction of those before.
_SHORTER = 0.65
#: Walkers of an ensemble, and how many times as many a refined run may have: array calls cost least
#: for some thousand positions.
_WALKERS, _MORE_WALKERS = 64, (1, 2, 4, 8)
#: Steps that a refined run aims at, and of its first round at least.
_REFINED_STEPS, _REFINED_ROUND = 168, 96
#: Steps between kept positions, a fraction of an autocorrelation time. Keeping and judging a
#: position takes as long as a few steps: long runs keep fewer.
_STRIDE, _REFINED_STRIDE = 3, 6
_SEGMENT = 96  # steps after which positions are mapped and progress is told
#: Kept draws of a part of a run over all ensembles, and numbers worked out from them; two parts are
#: held.
_KEPT_LIMIT, _NUMBERS_LIMIT = 1 << 17, 1 << 25
#: Positions a part may have whatever that takes: in fewer it could not span ten autocorrelation
#: times.
_FEWEST_POSITIONS = 32
#: Steps a run takes, times the squared jump of a step: a first guess at its length, for the clock
#: alone.
_STEPS_PER_JUMP = 15.0


def sample(
    target: Target,
    estimands: Estimands,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> Run:
    """Sample a target with emcee to a stated accuracy."""
    seeds = np.random.SeedSequence(settings.seed).spawn(2 + 2 * _MOST_REFINED)
    here, points = warm_up(target, (settings.ensembles, settings.walkers or _WALKERS), seeds[0])
    chain = _Chain(here, points, seeds[1], estimands, settings, _STRIDE, _FIRST_ROUND)
    refined, fitted = 0, 0
    while True:
        chain.extend(progress)
        run = chain.judge(progress)
        if (run.gate.passed and run.gate.tolerance_met) or chain.at_its_end(run):
            return run
        # Once for accuracy; again only where walkers are slow and a larger sample is there.
        times = (steps_to_settle(run) if refined else chain.steps_needed(run)) / chain.spanned
        drawn = chain.spanned * run.points.shape[2]
        worth = times > _WORTH_REFINING
        if refined:
            worth = times > _WORTH_AGAIN and times * drawn > _LARGER_SAMPLE * fitted
        if refined == _MOST_REFINED or not worth:
            chain.go_on(run)
            continue
        refined, fitted = refined + 1, drawn
        walkers, goal = _refined_size(run, chain.steps_by_error(run))
        rng, seed = np.random.default_rng(seeds[2 * refined]), seeds[2 * refined + 1]
        here = Transported(target, Transport.fit(run.points.reshape(-1, run.points.shape[-1])))
        points = starting_points(here, rng, (settings.ensembles, walkers))
        chain = _Chain(here, points, seed, estimands, settings, _REFINED_STRIDE, goal)


def _refined_size(run: Run, by_error: float) -> tuple[int, int]:
    """Walkers of an ensemble, and steps of the first round, of a run that begins again.

    As many walkers as the run's would need `by_error` steps for the tolerance.
    """
    settings, walkers, steps = run.settings, run.points.shape[2], _SHORTER * by_error
    if not settings.walkers:
        # No fewer steps than the autocorrelation time asks for, whatever the number of walkers.
        wanted = max(_REFINED_STEPS, _SHORTER * steps_to_settle(run))
        work = steps * walkers
        most = _room(run.points, run.components) // (
            settings.ensembles * _FEWEST_POSITIONS * _WALKERS
        )
        fitting = [n for n in _MORE_WALKERS if n <= max(most, 1)]
        walkers = _WALKERS * min(
            fitting, key=lambda n: abs(math.log(work / (n * _WALKERS * wanted)))
        )
        steps = work / walkers
    predicted = min(steps, 4.0 * _REFINED_ROUND, settings.most_steps - _BURN_IN)
    return walkers, math.ceil(max(predicted, _REFINED_ROUND))


def _room(points: Array, components: Array) -> int:
    """Draws of a part, over all ensembles, that memory has room for; a component has two influences or so."""
    return _NUMBERS_LIMIT // (points.shape[-1] + 3 * components.shape[-1])


class _Chain:
    """Walkers in the coordinates of one transport, kept positions, and what is left of earlier parts."""

    def __init__(
        self,
        here: Transported,
        points: Array,
        seed: np.random.SeedSequence,
        estimands: Estimands,
        settings: Settings,
        stride: int,
        goal: int,
    ) -> None:
        self._here, self._estimands, self._settings, self._stride = (
            here,
            estimands,
            settings,
            stride,
        )
        self._began = time.monotonic()
        self._walkers = Ensembles(here, points, seed)
        self._walkers.advance(_BURN_IN - _LEARNING, _BURN_IN - _LEARNING)
        self._walkers.advance(_LEARNING, _LEARNING, learn=True)
        self._kept: list[
            tuple[Array, Array]
        ] = []  # Points (E, T, W, d) and components (E, T, W, C)
        self._closed: Run | None = None  # With the estimates of all closed parts
        self._closed_steps = 0
        room = min(_KEPT_LIMIT, _room(points, estimands.components(here.map(points[0, :1]))))
        self._most = max(room // (points.shape[0] * points.shape[1]), _FEWEST_POSITIONS)
        self._goal = min(goal, self._most * stride)
        self._expected = _BURN_IN + max(goal, _STEPS_PER_JUMP / max(self._walkers.jump, 1e-3))
        self._error = math.nan

    @property
    def _length(self) -> int:
        return sum(points.shape[1] for points, _ in self._kept)

    @property
    def _full(self) -> bool:
        return self._length >= self._most

    @property
    def _steps(self) -> int:
        """Steps the kept positions of the part at work span."""
        return self._length * self._stride

    @property
    def spanned(self) -> int:
        """Steps all parts span."""
        return self._closed_steps + self._steps

    def extend(self, progress: Callable[[Progress], None] | None) -> None:
        """Run every ensemble up to the goal, and keep what is needed."""
        while self._steps < self._goal:
            self._tell(progress)
            steps = math.ceil(min(_SEGMENT, self._goal - self._steps) / self._stride) * self._stride
            walked = self._walkers.advance(steps, self._stride)
            # In one order of memory: the last bits of sums depend on it.
            flat = np.ascontiguousarray(self._here.map(walked.reshape(-1, walked.shape[-1])))
            components = np.ascontiguousarray(self._estimands.components(flat))
            self._kept.append(
                (flat.reshape(walked.shape), components.reshape(*walked.shape[:3], -1))
            )

    def _tell(self, progress: Callable[[Progress], None] | None) -> None:
        """Tell how far the run is; the clock is read for this alone."""
        if progress:
            steps = self._walkers.steps
            left = (time.monotonic() - self._began) / steps * max(self._expected - steps, 0.0)
            expected = math.ceil(max(self._expected, steps))
            progress(Progress(steps, expected, self._error, self._settings.tolerance, left))

    def judge(self, progress: Callable[[Progress], None] | None) -> Run:
        """Estimate, measure and pass the gate or not."""
        points, components = (
            np.concatenate(kept, axis=1) for kept in zip(*self._kept, strict=True)
        )
        self._kept = [(points, components)]
        walkers, settings, stride = self._walkers, self._settings, self._stride
        judged = judge(self._estimands, components)
        moved = np.ptp(points[:, points.shape[1] // 2 :, :, 0], axis=1) > 0
        if self._closed:
            judged = self._with_closed(judged, self._closed)
            points, components, stride = (
                self._closed.points,
                self._closed.components,
                self._closed.stride,
            )
        gate = pass_gate(
            settings, judged, walkers.accepted / walkers.steps, moved,
            length=self._length, stride=self._stride, spanned=self.spanned,
        )  # fmt: skip
        times = judged.times * self._stride
        run = Run(
            points,
            components,
            judged.estimates,
            judged.errors,
            times,
            gate,
            walkers.steps,
            stride,
            settings,
        )
        self._error = gate.worst_error
        wanted = max(self.steps_by_error(run), self._closed_steps + steps_to_settle(run))
        self._expected = walkers.steps - self.spanned + wanted
        self._tell(progress)
        return run

    def _with_closed(self, part: Judged, closed: Run) -> Judged:
        """Average with the estimates of the parts before, by steps; errors add as for independent parts.

        It costs a bias of the order of a part's squared Monte Carlo error.
        """
        share = self._steps / self.spanned
        value = closed.estimates.value + share * (part.estimates.value - closed.estimates.value)
        errors = np.hypot((1.0 - share) * closed.errors, share * part.errors)
        return dataclasses.replace(
            part, estimates=dataclasses.replace(part.estimates, value=value), errors=errors
        )

    def at_its_end(self, run: Run) -> bool:
        """Whether no steps are left, or too few to judge another part by."""
        left = self._settings.most_steps - self._walkers.steps
        if not self._full:
            return left < 1
        # A last part too short to settle would take the verdict from the parts before it.
        least = steps_to_settle(run) if run.gate.passed else 0
        return left < max(least, _FEWEST_POSITIONS * self._stride)

    def go_on(self, run: Run) -> None:
        """Make room where memory is or will be full, and set the next goal."""
        needed, settling = self.steps_needed(run), steps_to_settle(run)
        if self._full and run.gate.passed:
            self._closed, self._closed_steps, self._kept = run, self.spanned, []
        while not run.gate.passed and (self._full or settling > self._most * self._stride):
            # Contiguous, as they are when taken up again: a sum's last bits depend on the order in
            # memory.
            points, components = (np.ascontiguousarray(kept[:, 1::2]) for kept in self._kept[0])
            self._kept = [(points, components)]
            self._stride *= 2
        left = self._settings.most_steps - self._walkers.steps
        self._goal = min(
            max(needed - self._closed_steps, settling),
            self._most * self._stride,
            self._steps + left,
        )

    def steps_by_error(self, run: Run) -> float:
        """Predict the steps after which the estimates are accurate enough."""
        ratio = run.gate.worst_error / self._settings.tolerance
        return self.spanned * (ratio * ratio * 1.1 if math.isfinite(ratio) else 2.0)

    def steps_needed(self, run: Run) -> int:
        """Predict the steps the run should span in all; it at least grows by a tenth."""
        settled = self._closed_steps + steps_to_settle(run)
        wanted = max(self.steps_by_error(run), settled, 1.1 * self.spanned)
        return math.ceil(min(wanted, 4.0 * self.spanned))


def steps_to_settle(run: Run) -> int:
    """Predict the steps a part must span."""
    slowest = run.gate.autocorrelation_time
    return math.ceil(1.2 * TIMES_NEEDED * slowest) if math.isfinite(slowest) else 0
