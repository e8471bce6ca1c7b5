"""Sample a target until its estimates are accurate, restarting long runs with a better transport.

A run takes as many steps as its walkers need to forget where they were, many times over. How soon
they forget depends on the transport: the fitted map to coordinates in which the target resembles
the proposals (`transport`). The warm-up fits one to a few thousand draws of short runs. A run has
better draws after its first round. A long run therefore throws its draws away, fits a new transport
to them, and starts again: a restart. Its gain is a shorter autocorrelation time and more walkers.

`sample` takes these steps:

1. Warm up: a transport and starting points (`warmup`).
2. Advance all walkers by a round, then estimate and judge (`chain`, `gate`).
3. If the gate passes and every estimate meets the tolerance, or the cap of steps is reached: end.
4. If the run will be long (`_restart_pays`): fit a transport to all draws, choose the number of
   walkers (`_restart_size`), start a new chain, and go to 2.
5. Otherwise set the goal of the next round by the errors so far, and go to 2.

The cap, `Settings.most_steps`, counts from the last restart, and never cuts short the first round.
So a run takes at most its warm-up and 1 + `_MOST_RESTARTS` times the cap.

Points are (E, W, d) and kept positions (E, T, W, d): ensembles E, positions T, walkers W of each
ensemble, coordinates d. A step moves every walker once. Walker-steps are steps times W: the draws
of one ensemble, kept or not.
"""

from __future__ import annotations

import ctypes
import functools
import math
import platform
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.chain import BURN_IN, Chain, Memory, Pace, Task
from percept.inference.sampling.gate import Estimands, Progress, Run, Settings
from percept.inference.sampling.target import Target, Transported
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import starting_points, warm_up

__all__ = ["sample"]

Array = NDArray[np.float64]

#: Steps of the first round after the warm-up. The gate wants 10 autocorrelation times and runs aim
#: at 12: these are 12 of a time of 12 steps. The published study's time is 11, and its transport
#: then has 12,000 kept draws to be fitted to.
_FIRST_ROUND = 144
#: Steps between kept positions. Keeping and judging a position takes as long as a few steps. At a
#: time of 7 to 30 steps, as measured on the studies in tests/golden, neighbours are much alike.
_STRIDE = 3
#: The same after a restart, whose walkers are many and whose run is long: half the positions do.
_RESTART_STRIDE = 6

#: Times a run may restart. The transport follows many coordinates better each time, with ever less
#: gain. Of four studies in tests/golden one restarts at a tolerance of 0.01, and all do once at
#: 0.003.
_MOST_RESTARTS = 4
#: Walker-steps per coordinate that make a transport a good one. One fitted to fewer is little
#: better than that of the warm-up.
_GOOD_FIT = 100.0
#: With a poorer transport a run restarts if it is predicted to take more than this multiple of its
#: steps so far, which a restart wastes. A prediction never exceeds four times the steps. A study
#: with conditions takes 1.6 to 1.9 times the density values if this is 6. With 1.5 they stay equal.
_LONG = 3.0
#: With a good transport only slow walkers are a reason, since they betray places where it fails. A
#: run restarts if settling takes more than this multiple of its steps so far. From 1.1 to 3 the
#: density values of that study stay equal.
_SLOW = 1.5
#: Restart only if the predicted walker-steps exceed this multiple of those that the present
#: transport was fitted to. A larger value restarts less often, each time from a better sample. From
#: 2 to 20 the density values of that study stay equal.
_LARGER_SAMPLE = 6.0

#: Expected autocorrelation time after a restart over that before: near the best case. Measured in
#: four studies of tests/golden at a tolerance of 0.003: 0.68 to 1.1. Too low a guess costs a round,
#: too high a one wastes steps.
_TIME_RATIO = 0.65
#: Walkers of an ensemble: the gate's fewest, over whom it averages autocorrelations.
_WALKERS = 64
#: Walkers of an ensemble that a restart chooses from. A density call costs least per position for
#: some thousand positions: four ensembles of 512 are 2,048.
_RESTART_WALKERS = (64, 128, 256, 512)
#: Steps that a restarted run aims at by its walkers: 14 times an autocorrelation time of 12 steps,
#: since the gate needs 10 whatever the number of walkers.
_RESTART_STEPS = 168
#: Least steps of its first round, 8 times such a time: errors of fewer predict badly. Half or twice
#: of this and the next constant change the density values of that study by 2 % at most.
_LEAST_RESTART_ROUND = 96
#: Most steps of its first round: a bad prediction of the length is found out after these.
_MOST_RESTART_ROUND = 384

#: Name of a setting in glibc's malloc.h: bytes of free memory above which it goes to the system.
_TRIM_THRESHOLD = -1
#: Name of another: bytes of an array above which it never comes from freed memory.
_MMAP_THRESHOLD = -3
#: Value of the first, 256 MiB: more than what one pass over a density needs.
_KEPT_BYTES = 1 << 28
#: Value of the second, 32 MiB: the most that glibc allows.
_LARGEST_ARRAY_BYTES = 1 << 25


def sample(
    target: Target,
    estimands: Estimands,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    memory: Memory | None = None,
) -> Run:
    """Sample a target with emcee to a stated accuracy.

    Parameters
    ----------
    target : Target
        Log density of points (W, d), -inf where impossible and never NaN.
    estimands : Estimands
        Quantities to report, whose errors decide how long the run is.
    settings : Settings
        Tolerance, seed, and how many ensembles, walkers and steps.
    progress : callable, optional
        Told the state of the run after every round.
    memory : Memory, optional
        How much of the run is held at once; longer runs are estimated in parts.

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
    task = Task(estimands, settings, memory or Memory(), progress)
    # Two seeds to begin with, and two for each restart.
    seeds = np.random.SeedSequence(settings.seed).spawn(2 + 2 * _MOST_RESTARTS)
    shape = (settings.ensembles, settings.walkers or _WALKERS)
    transported, points = warm_up(target, shape, seeds[0])
    chain = Chain(task, transported, points, seeds[1], Pace(_STRIDE, _FIRST_ROUND))
    restarts = 0
    fitted_to = 0  # Walker-steps that the transport was fitted to; the warm-up's do not count
    while True:
        chain.extend()
        run = chain.judge()
        accurate = run.gate.passed and run.gate.tolerance_met
        if accurate or chain.at_its_end(run):
            return run
        pays = _restart_pays(chain, run, fitted_to)
        if restarts == _MOST_RESTARTS or not pays:
            chain.go_on(run)
            continue
        restarts += 1
        fitted_to = chain.spanned * run.points.shape[2]
        size = _restart_size(task, run, chain.steps_by_error(run))
        rng = np.random.default_rng(seeds[2 * restarts])
        seed = seeds[2 * restarts + 1]
        flat = run.points.reshape(-1, run.points.shape[-1])
        transported = Transported(target, Transport.fit(flat))
        points = starting_points(transported, rng, (settings.ensembles, size.walkers))
        chain = Chain(task, transported, points, seed, Pace(_RESTART_STRIDE, size.first_round))


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


def _restart_pays(chain: Chain, run: Run, fitted_to: int) -> bool:
    """Whether to restart a run whose transport was fitted to so many walker-steps."""
    _, _, walkers, dimension = run.points.shape
    if fitted_to < _GOOD_FIT * dimension:
        needed = chain.steps_needed(run)
        least = _LONG * chain.spanned
    else:
        needed = run.steps_to_settle
        least = _SLOW * chain.spanned
    return needed > least and needed * walkers > _LARGER_SAMPLE * fitted_to


@dataclass(frozen=True)
class _RestartSize:
    """Size of a restarted run."""

    walkers: int  # Of an ensemble
    first_round: int  # Steps


def _restart_size(task: Task, run: Run, steps_by_error: float) -> _RestartSize:
    """Choose the walkers with which the predicted walker-steps take about `_RESTART_STEPS` steps.

    `steps_by_error` predicts the steps until the errors meet the tolerance, were the run to go on.
    """
    walkers = run.points.shape[2]
    steps = _TIME_RATIO * steps_by_error
    if not task.settings.walkers:
        walker_steps = steps * walkers
        # No fewer steps than the autocorrelation time asks for, whatever the number of walkers.
        wanted_steps = max(_RESTART_STEPS, _TIME_RATIO * run.steps_to_settle)
        walkers = _nearest_walkers(task, run, walker_steps / wanted_steps)
        steps = walker_steps / walkers
    most = min(_MOST_RESTART_ROUND, task.settings.most_steps - BURN_IN)
    first_round = max(min(steps, most), _LEAST_RESTART_ROUND)
    return _RestartSize(walkers, math.ceil(first_round))


def _nearest_walkers(task: Task, run: Run, wanted: float) -> int:
    """Walkers of an ensemble, nearest to the wanted in ratio, of whom memory has room."""
    room = task.memory.draws_of(run.points.shape[-1], run.components.shape[-1])
    most = room // (task.settings.ensembles * task.memory.fewest_positions)
    fitting = [walkers for walkers in _RESTART_WALKERS if walkers <= max(most, _WALKERS)]
    return min(fitting, key=lambda walkers: abs(math.log(wanted / walkers)))
