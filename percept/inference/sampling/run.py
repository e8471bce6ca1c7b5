"""Sample a target until its estimates are accurate, restarting long runs with a better transport.

A run takes as many steps as its walkers need to forget where they were, many times over. How soon
they forget depends on the transport: the fitted map to coordinates in which the target resembles
the proposals (`transport`). The warm-up fits one to a few thousand draws of short runs. A run has
better draws after its first round. A long run therefore throws its draws away, fits a new transport
to them, and starts again, with twice as many walkers where it lacks accuracy: a restart.

`sample` takes these steps:

1. Warm up: a transport and starting points (`warmup`).
2. Advance all walkers by a round, then estimate and judge (`Chain`, `gate`).
3. If the gate passes and every estimate meets the tolerance, or the cap of steps is reached: end.
4. If the run will take more than `_LONG` times its steps so far, or as many further rounds:
   restart, and go to 2.
5. Otherwise set the goal of the next round by the errors so far, and go to 2.

The cap, `Settings.most_steps`, counts from the last restart, and never cuts short the first round.
So a run takes at most its warm-up and 1 + `_MOST_RESTARTS` times the cap.

Points are (E, W, d) and kept positions (E, T, W, d): ensembles E, positions T, walkers W of each
ensemble, coordinates d. A step moves every walker once.

What a run holds in memory is bounded. When that is full and has settled, it is closed as a part of
the run, and the estimates are means over parts.
"""

from __future__ import annotations

import ctypes
import functools
import math
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.gate import (
    Estimands,
    Measured,
    Progress,
    Run,
    Settings,
    measure,
    pass_gate,
)
from percept.inference.sampling.moves import Ensembles, Target, Transported
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import starting_points, warm_up

Array = NDArray[np.float64]

#: Times a run may restart.
_MOST_RESTARTS = 2
#: A run restarts if it needs more than this multiple of the steps so far, which a restart wastes,
#: or more than so many first rounds beside them: about as many as after a restart.
#: With 5 the published study takes 460,000 density values at one seed of three, and 200,000 with
#: this; studies with more coordinates take as many.
_LONG = 3.0
#: Independent ensembles, whose agreement the gate measures.
_ENSEMBLES = 4
#: Walkers of an ensemble: as many as the gate's `_TIMES_NEEDED` was set with.
_WALKERS = 64
#: Steps between kept positions. Keeping and judging a position takes as long as a few steps. At a
#: time of 7 to 30 steps, as measured on the studies in tests/golden, neighbours differ little.
_STRIDE = 3
#: The same after a restart, whose walkers are many and whose run is long: half the positions do.
_RESTART_STRIDE = 6

#: Key of a setting in glibc's malloc.h: bytes of free memory above which it goes to the system.
_TRIM_THRESHOLD = -1
#: Key of another: bytes of an array above which, where no freed memory holds it, it is mapped by
#: itself and goes to the system when it is freed.
_MMAP_THRESHOLD = -3
#: Value of the first, 256 MiB: more than what one pass over a density needs.
_KEPT_BYTES = 1 << 28
#: Value of the second, 32 MiB: the most that glibc allows.
_LARGEST_ARRAY_BYTES = 1 << 25
#: Steps before any are kept.
_BURN_IN = 40
#: Steps of the first round. The gate wants 10 autocorrelation times and runs aim at 12: these are
#: 12 of a time of 12 steps. The published study takes 10. A restart then fits its transport to
#: 12,000 kept draws.
_FIRST_ROUND = 144
#: Steps after which positions are mapped and progress is reported.
_SEGMENT = 96
#: Steps aimed at over those the error predicts: a prediction that falls short costs a round.
_MARGIN = 1.1
#: Most that one round multiplies the length of a run: early errors predict badly.
_MOST_GROWTH = 2.0


#: Kept draws of a part, over all ensembles.
_MOST_DRAWS = 1 << 17
#: Numbers worked out from the draws of a part, 256 MiB; two parts are held.
_MOST_NUMBERS = 1 << 25
#: Positions of a part, at least: fewer could not span the autocorrelation times the gate needs.
FEWEST_POSITIONS = 32


@dataclass(frozen=True)
class Task:
    """What a run is asked for."""

    estimands: Estimands
    settings: Settings
    progress: Callable[[Progress], None] | None


class Chain:
    """The walkers of a task, and their kept positions."""

    def __init__(
        self,
        task: Task,
        transported: Transported,
        points: Array,
        seed: np.random.SeedSequence,
        stride: int,
    ) -> None:
        """Burn in from starting points (E, W, d) in the coordinates of `transported`."""
        self._task = task
        self._transported = transported
        self._stride = stride
        self._began = time.monotonic()
        self._walkers = Ensembles(transported, points, seed)
        self._walkers.advance(_BURN_IN, _BURN_IN)
        self._points: list[Array] = []  # each (E, T, W, d)
        self._components: list[Array] = []  # each (E, T, W, C)
        self._closed: Run | None = None  # Estimates of all closed parts, draws of the first
        self._closed_steps = 0  # Steps they span
        ensembles, walkers, dimension = points.shape
        components = task.estimands.components(transported.map(points[0, :1])).shape[-1]
        # A component needs room for its values and for about two influence functions.
        room = _MOST_NUMBERS // (dimension + 3 * components)
        draws = min(_MOST_DRAWS, room)
        # Positions of all walkers that a part has room for.
        self._most_positions = max(draws // (ensembles * walkers), FEWEST_POSITIONS)
        # Steps that the current part is to span.
        self._goal = min(_FIRST_ROUND, self._most_positions * stride)
        self._expected: float = _BURN_IN + _FIRST_ROUND
        self._error = math.nan

    @property
    def _steps(self) -> int:
        """Steps the kept positions of the current part span."""
        return sum(points.shape[1] for points in self._points) * self._stride

    @property
    def _full(self) -> bool:
        """Whether the current part has no room left."""
        return self._steps >= self._most_positions * self._stride

    @property
    def _steps_left(self) -> int:
        """Steps until the run ends, whatever its error."""
        return self._task.settings.most_steps - self._walkers.steps

    @property
    def spanned(self) -> int:
        """Steps all parts span."""
        return self._closed_steps + self._steps

    def extend(self) -> None:
        """Run every ensemble up to the goal, and keep what is needed."""
        while self._steps < self._goal:
            self._tell()
            wanted = min(_SEGMENT, self._goal - self._steps)
            steps = math.ceil(wanted / self._stride) * self._stride
            walked = self._walkers.advance(steps, self._stride)
            # In one order in memory: the last bits of sums depend on it.
            flat = walked.reshape(-1, walked.shape[-1])
            mapped = np.ascontiguousarray(self._transported.map(flat))
            components = self._task.estimands.components(mapped)
            components = np.ascontiguousarray(components)
            self._points.append(mapped.reshape(walked.shape))
            self._components.append(components.reshape(*walked.shape[:3], -1))

    def _tell(self) -> None:
        """Report progress. The clock serves this alone."""
        if self._task.progress is None:
            return
        steps = self._walkers.steps
        seconds_per_step = (time.monotonic() - self._began) / steps
        state = Progress(
            steps,
            expected_steps=math.ceil(max(self._expected, steps)),
            worst_error=self._error,
            tolerance=self._task.settings.tolerance,
            seconds_left=seconds_per_step * max(self._expected - steps, 0.0),
        )
        self._task.progress(state)

    def judge(self) -> Run:
        """Estimate, measure and pass the gate or not."""
        points = np.concatenate(self._points, axis=1)
        components = np.concatenate(self._components, axis=1)
        self._points = [points]
        self._components = [components]
        measured = measure(self._task.estimands, components)
        closed = self._closed
        if closed:
            measured = self._averaged(measured, closed.estimates)
        gate = pass_gate(
            self._task.settings,
            measured,
            points,
            self._walkers.accepted / self._walkers.steps,
            stride=self._stride,
            spanned=self.spanned,
        )
        run = Run(
            points=points,
            components=components,
            estimates=measured,
            gate=gate,
            steps=self._walkers.steps,
            stride=self._stride,
            settings=self._task.settings,
        )
        if closed:
            run = replace(
                run, points=closed.points, components=closed.components, stride=closed.stride
            )
        self._error = gate.worst_error
        self._expected = self._walkers.steps - self.spanned + self.steps_needed(run)
        self._tell()
        return run

    def _averaged(self, part: Measured, before: Measured) -> Measured:
        """Average with the closed parts' estimates, by steps; errors add as for independent parts.

        It costs a bias of the order of a part's squared Monte Carlo error.
        """
        share = self._steps / self.spanned
        return replace(
            part,
            value=before.value + share * (part.value - before.value),
            errors=np.hypot((1.0 - share) * before.errors, share * part.errors),
        )

    def at_its_end(self, run: Run) -> bool:
        """Whether no steps are left, or too few to judge another part by."""
        # A last part too short to settle would take the verdict from the parts before it.
        shortest = run.steps_to_settle if self._full and run.gate.passed else 1
        return self._steps_left < shortest

    def go_on(self, run: Run) -> None:
        """Make room where memory is or will be full, and set the next goal."""
        needed = max(self.steps_needed(run), _MARGIN * self.spanned)
        needed = math.ceil(min(needed, _MOST_GROWTH * self.spanned))
        self._make_room(run)
        wanted = max(needed - self._closed_steps, run.steps_to_settle)
        most = self._most_positions * self._stride
        self._goal = min(wanted, most, self._steps + self._steps_left)

    def _make_room(self, run: Run) -> None:
        """Close a full part that has settled; thin one that will be full before it has."""
        if run.gate.passed and self._full:
            self._closed = run
            self._closed_steps = self.spanned
            self._points = []
            self._components = []
        elif not run.gate.passed:
            while self._full or run.steps_to_settle > self._most_positions * self._stride:
                # Every second position stays, in one order in memory: sums depend on it.
                (points,) = self._points
                (components,) = self._components
                self._points = [np.ascontiguousarray(points[:, 1::2])]
                self._components = [np.ascontiguousarray(components[:, 1::2])]
                self._stride *= 2

    def steps_needed(self, run: Run) -> int:
        """Predict the steps the run must span to settle and to be accurate enough."""
        ratio = run.gate.worst_error / self._task.settings.tolerance
        growth = ratio * ratio * _MARGIN if math.isfinite(ratio) else _MOST_GROWTH
        settled = self._closed_steps + run.steps_to_settle
        return max(math.ceil(growth * self.spanned), settled)


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
        Log density of points (W, d), -inf where impossible and never NaN.
    estimands : Estimands
        Quantities to report, whose errors decide how long the run is.
    settings : Settings
        Tolerance, seed and cap of steps.
    progress : callable, optional
        Told the state of the run as it goes; its steps count from the last restart.

    Returns
    -------
    Run
        Draws, estimates with their errors, and the verdict of the gate.

    Raises
    ------
    RefusalError
        A density that is NaN somewhere, or -inf everywhere.
    """
    _keep_freed_memory()
    task = Task(estimands, settings, progress)
    # Two seeds to begin with, and two for each restart.
    seeds = np.random.SeedSequence(settings.seed).spawn(2 + 2 * _MOST_RESTARTS)
    walkers = _WALKERS
    transported, points = warm_up(target, (_ENSEMBLES, walkers), seeds[0])
    chain = Chain(task, transported, points, seeds[1], _STRIDE)
    restarts = 0
    while True:
        chain.extend()
        run = chain.judge()
        accurate = run.gate.passed and run.gate.tolerance_met
        if accurate or chain.at_its_end(run):
            return run
        needed = chain.steps_needed(run)
        longest = min(_LONG * chain.spanned, chain.spanned + _LONG * _FIRST_ROUND)
        if restarts == _MOST_RESTARTS or needed <= longest:
            chain.go_on(run)
            continue
        restarts += 1
        # A run that is long only to settle is accurate enough with as many walkers.
        if needed > run.steps_to_settle:
            walkers *= 2
        rng = np.random.default_rng(seeds[2 * restarts])
        flat = run.points.reshape(-1, run.points.shape[-1])
        transported = Transported(target, Transport.fit(flat))
        points = starting_points(transported, rng, (_ENSEMBLES, walkers))
        chain = Chain(task, transported, points, seeds[2 * restarts + 1], _RESTART_STRIDE)


@functools.cache
def _keep_freed_memory() -> None:
    """Have glibc keep what arrays free for the next ones; other C libraries stay as they are.

    By default glibc gives it back to the system after every pass over a density, and the next pass
    takes it again page by page. That is a quarter of the time of a fit with subjects' own trial
    SDs.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    library = ctypes.CDLL(None)
    library.mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
    library.mallopt(_MMAP_THRESHOLD, _LARGEST_ARRAY_BYTES)
