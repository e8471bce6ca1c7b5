"""Sample a target until its estimates are accurate, restarting long runs with a better transport.

A run takes as many steps as its walkers need to forget where they were, many times over. How soon
they forget depends on the transport: the fitted map to coordinates in which the target resembles
the proposals (`transport`). The warm-up fits one to a few thousand draws of short runs. A run has
better draws after its first round. A long run therefore throws its draws away, fits a new transport
to them, and starts again with twice as many walkers: a restart.

`sample` takes these steps:

1. Warm up: a transport and starting points (`warmup`).
2. Advance all walkers by a round, then estimate and judge (`chain`, `gate`).
3. If the gate passes and every estimate meets the tolerance, or the cap of steps is reached: end.
4. If the run will take more than `_LONG` times its steps so far: restart, and go to 2.
5. Otherwise set the goal of the next round by the errors so far, and go to 2.

The cap, `Settings.most_steps`, counts from the last restart, and never cuts short the first round.
So a run takes at most its warm-up and 1 + `_MOST_RESTARTS` times the cap.

Points are (E, W, d) and kept positions (E, T, W, d): ensembles E, positions T, walkers W of each
ensemble, coordinates d. A step moves every walker once.
"""

from __future__ import annotations

import ctypes
import functools
import platform
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.chain import Chain, Memory, Task
from percept.inference.sampling.gate import Estimands, Progress, Run, Settings
from percept.inference.sampling.moves import Target, Transported
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.warmup import starting_points, warm_up

__all__ = ["sample"]

Array = NDArray[np.float64]

#: Times a run may restart. Each time its walkers double.
_MOST_RESTARTS = 2
#: A run restarts if it needs more than this multiple of the steps so far, which a restart wastes.
#: With 5 the published study takes 460,000 density values at one seed of three, and 200,000 with
#: this; studies with more coordinates take as many.
_LONG = 3.0
#: Walkers of an ensemble: the gate's fewest, over whom it averages autocorrelations.
_WALKERS = 64
#: Steps between kept positions. Keeping and judging a position takes as long as a few steps. At a
#: time of 7 to 30 steps, as measured on the studies in tests/golden, neighbours are much alike.
_STRIDE = 3
#: The same after a restart, whose walkers are many and whose run is long: half the positions do.
_RESTART_STRIDE = 6

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
    walkers = settings.walkers or _WALKERS
    transported, points = warm_up(target, (settings.ensembles, walkers), seeds[0])
    chain = Chain(task, transported, points, seeds[1], _STRIDE)
    restarts = 0
    while True:
        chain.extend()
        run = chain.judge()
        accurate = run.gate.passed and run.gate.tolerance_met
        if accurate or chain.at_its_end(run):
            return run
        is_long = chain.steps_needed(run) > _LONG * chain.spanned
        if restarts == _MOST_RESTARTS or not is_long:
            chain.go_on(run)
            continue
        restarts += 1
        if not settings.walkers:
            walkers *= 2
        rng = np.random.default_rng(seeds[2 * restarts])
        flat = run.points.reshape(-1, run.points.shape[-1])
        transported = Transported(target, Transport.fit(flat))
        points = starting_points(transported, rng, (settings.ensembles, walkers))
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
