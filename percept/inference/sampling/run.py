"""Sample until the gate passes and every limit meets the tolerance, or to a cap of steps.

A run that will be long begins again after its first round, which then counts as warm-up: a
transport fitted to its draws shortens the autocorrelation time by about a third. The cap counts
from the last restart, and never cuts short the first round. There are four restarts at most, so a
run takes five times the cap at most, and its warm-up.
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
from percept.inference.sampling.coordinates import Target, Transported
from percept.inference.sampling.gate import Estimands, Progress, Run, Settings
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import starting_points, warm_up

__all__ = ["sample"]

Array = NDArray[np.float64]

#: Steps of the first round: enough to fit a transport to, and all that a plain target needs.
_FIRST_ROUND = 144
#: Steps between kept positions, a fraction of an autocorrelation time. Keeping and judging a
#: position takes as long as a few steps: long runs keep fewer.
_STRIDE = 3
_REFINED_STRIDE = 6
#: Restart only if the run is predicted to take in all this multiple of its steps so far. A restart
#: throws those away and gains a third of what follows. A prediction is at most four times the
#: steps. A study with conditions takes 1.6 to 1.9 times the density values if this is 6, and no
#: others if it is 1.5.
_WORTH_REFINING = 3.0
#: Draws of an ensemble per coordinate. A transport fitted to fewer is little better than that of
#: the warm-up, and the run may begin again for accuracy once more.
_THIN_SAMPLE = 100.0
#: With a better transport a run begins again at this multiple, and only if its walkers are slow:
#: slow walkers show a bad transport, which more draws mend. From 1.1 to 3 that study is the same.
_WORTH_AGAIN = 1.5
#: Restart only if predicted draws exceed this many times those the transport was fitted to. Larger
#: values restart less often, each time from a better sample. From 2 to 20 that study is the same.
_LARGER_SAMPLE = 6.0
#: Times a run may begin again: each transport follows many coordinates better than the one before.
_MOST_REFINED = 4
#: Expected ratio of autocorrelation times after and before that.
_SHORTENED = 0.65
#: Walkers of an ensemble, and how many times as many a refined run may have: array calls cost least
#: for some thousand positions.
_WALKERS = 64
_MULTIPLES = (1, 2, 4, 8)
#: Steps that a refined run aims at, so that walkers have time to settle.
_REFINED_STEPS = 168
#: Least and most steps of its first round. Fewer would span too few autocorrelation times to judge
#: the run by. More would be spent before a bad prediction of the length is found out. Half or twice
#: as many change the density values of that study by 2 % at most.
_LEAST_REFINED_ROUND = 96
_MOST_REFINED_ROUND = 384

#: Names of two settings in glibc's malloc.h.
_TRIM_THRESHOLD = -1
_MMAP_THRESHOLD = -3
#: Bytes of freed memory that are kept: more than what one pass over a density needs.
_KEPT = 1 << 28
#: Bytes of the largest array that is taken from it, the most that glibc allows.
_LARGEST = 1 << 25


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
    seeds = np.random.SeedSequence(settings.seed).spawn(2 + 2 * _MOST_REFINED)
    shape = (settings.ensembles, settings.walkers or _WALKERS)
    transported, points = warm_up(target, shape, seeds[0])
    chain = Chain(task, transported, points, seeds[1], Pace(_STRIDE, _FIRST_ROUND))
    refinements = 0
    transport_draws = 0  # Steps times walkers that the transport at work was fitted to
    while True:
        chain.extend()
        run = chain.judge()
        accurate = run.gate.passed and run.gate.tolerance_met
        if accurate or chain.at_its_end(run):
            return run
        draws = chain.spanned * run.points.shape[2]
        worth = _worth_refining(chain, run, draws, transport_draws)
        if refinements == _MOST_REFINED or not worth:
            chain.go_on(run)
            continue
        refinements += 1
        transport_draws = draws
        size = _refined_size(task, run, chain.steps_by_error(run))
        rng = np.random.default_rng(seeds[2 * refinements])
        seed = seeds[2 * refinements + 1]
        flat = run.points.reshape(-1, run.points.shape[-1])
        transported = Transported(target, Transport.fit(flat))
        points = starting_points(transported, rng, (settings.ensembles, size.walkers))
        chain = Chain(task, transported, points, seed, Pace(_REFINED_STRIDE, size.first_round))


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
    library.mallopt(_TRIM_THRESHOLD, _KEPT)
    library.mallopt(_MMAP_THRESHOLD, _LARGEST)


def _worth_refining(chain: Chain, run: Run, draws: int, transport_draws: int) -> bool:
    """Whether to begin again: for accuracy after a thin sample, and else for slow walkers alone."""
    if transport_draws < _THIN_SAMPLE * run.points.shape[-1]:
        needed = chain.steps_needed(run)
        least = _WORTH_REFINING
    else:
        needed = run.steps_to_settle
        least = _WORTH_AGAIN
    rounds = needed / chain.spanned
    return rounds > least and rounds * draws > _LARGER_SAMPLE * transport_draws


@dataclass(frozen=True)
class _Size:
    """Size of a run that begins again."""

    walkers: int  # Of an ensemble
    first_round: int  # Steps


def _refined_size(
    task: Task,
    run: Run,
    steps_by_error: float,
) -> _Size:
    """Choose the number of walkers by which the predicted work takes the wanted steps."""
    walkers = run.points.shape[2]
    steps = _SHORTENED * steps_by_error
    if not task.settings.walkers:
        work = steps * walkers
        # No fewer steps than the autocorrelation time asks for, whatever the number of walkers.
        wanted = max(_REFINED_STEPS, _SHORTENED * run.steps_to_settle)
        walkers = _WALKERS * _best_multiple(task, run, work / _WALKERS / wanted)
        steps = work / walkers
    most = min(_MOST_REFINED_ROUND, task.settings.most_steps - BURN_IN)
    first_round = max(min(steps, most), _LEAST_REFINED_ROUND)
    return _Size(walkers, math.ceil(first_round))


def _best_multiple(
    task: Task,
    run: Run,
    wanted: float,
) -> int:
    """Multiple of the usual walkers that fits in memory and is nearest to the wanted one."""
    room = task.memory.draws_of(run.points.shape[-1], run.components.shape[-1])
    positions = task.settings.ensembles * task.memory.fewest_positions * _WALKERS
    most = max(room // positions, 1)
    fitting = [multiple for multiple in _MULTIPLES if multiple <= most]
    return min(fitting, key=lambda multiple: abs(math.log(wanted / multiple)))
