"""Run time against the size of a study, of draws and of a grid."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.boundary.law import mixture_law
from percept.boundary.limits import Magnitude
from percept.haptics import Device
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.statistics import Statistics, from_trials

__all__ = ["Growth", "growth", "growth_study"]

Task: TypeAlias = Callable[[], object]

_ROWS = "trial rows"
_SUBJECTS = "subjects, equal patterns"
_PATTERNS = "patterns"
_ENVIRONMENTS = "environments"
_OMEGA = "frequencies"
_DRAWS = "draws"
#: Sizes along every axis.
_SIZES: Mapping[str, tuple[int, ...]] = {
    _ROWS: (50, 500, 5_000, 50_000, 500_000, 5_000_000),
    _SUBJECTS: (10, 100, 1_000, 10_000),
    _PATTERNS: (1, 2, 5, 10, 20, 40),
    _ENVIRONMENTS: (1, 2, 5, 10, 20, 50, 100, 200),
    _OMEGA: (10, 100, 1_000, 10_000),
    _DRAWS: (100, 1_000, 10_000, 100_000, 1_000_000),
}
#: Growth of a density call that is promised not to be passed.
_PROMISED = {_ROWS: 1.10, _SUBJECTS: 1.10}

_CELLS = 5  # Subjects and environments of the studies whose rows are counted
_MANY = 40  # Subjects of the studies whose patterns are counted
_FEW = 10  # Subjects of the studies whose environments are counted
_POINTS = 256  # Four ensembles of 64 walkers
_SHORTEST = 0.01  # s; shorter tasks are repeated within a round
_OTHER_OMEGA = 10  # Frequencies where draws vary
_OTHER_DRAWS = 1_000  # Draws where frequencies vary
_BATCHES = 32  # Of the draws, for the Monte Carlo error


@dataclass(frozen=True)
class Growth:
    """Run time of one task at one size."""

    task: Annotated[
        str,
        "density call: 256 values of the log density. propagation: quantiles of abs(Z_h) over 1000"
        " draws at 10 frequencies, unless those vary.",
    ]
    along: Annotated[str, "What varies."]
    size: Annotated[int, "Its value."]
    seconds: Annotated[float, "Median processor time over the rounds."]
    ratio: Annotated[
        float, "Median over the rounds of the time over the smallest size's in that round."
    ]
    promised: Annotated[float | None, "What the ratio is promised to stay below."]


def growth(
    *,
    rounds: int = 15,
    sizes: Mapping[str, Sequence[int]] = _SIZES,
    log: Callable[[str], None] = lambda line: None,
) -> list[Growth]:
    """Time density calls and propagation along every axis.

    Parameters
    ----------
    rounds : int
        Times every task is timed, in turn.
    sizes : mapping, optional
        What varies, and its values, the smallest first.
    log : callable
        Told of each axis.

    Returns
    -------
    list of Growth
        A row for each size.
    """
    rows = []
    for along, values in sizes.items():
        log(f"growth with {along}")
        propagated = along in (_OMEGA, _DRAWS)
        name = "propagation" if propagated else "density call"
        task = _propagation if propagated else _density_call
        tasks = {size: task(along, size) for size in values}
        rows += _rows(name, along, tasks, rounds)
    return rows


def growth_study(along: str, size: int, *, seed: int = 1) -> Statistics:
    """Reduce a simulated study of stiffness and damping to what the density reads.

    Parameters
    ----------
    along : str
        What varies.
    size : int
        Its value.
    seed : int
        Of the data.

    Returns
    -------
    Statistics
        As `CollapsedDensity` takes them.
    """
    counts = _counts(along, size)
    subjects, environments = counts.shape
    rng = np.random.default_rng(seed)
    of_subjects = 0.1 * rng.standard_normal((subjects, 1, 2))
    cell_means = of_subjects + 0.2 * rng.standard_normal((*counts.shape, 2))
    cell = np.repeat(np.arange(counts.size), counts.ravel())
    response = cell_means.reshape(-1, 2)[cell]
    response += 0.05 * rng.standard_normal(response.shape)
    x = np.linspace(-1.5, 1.5, environments) if environments > 1 else np.zeros(1)
    return from_trials(
        response,
        cell // environments,
        cell % environments,
        np.tile(x, (2, 1)),
        parameters=("k", "b"),
        environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1}" for i in range(subjects)),
    )


def _counts(along: str, size: int) -> NDArray[np.intp]:
    """Trials per subject and environment."""
    if along == _ROWS:
        return np.full((_CELLS, _CELLS), math.ceil(size / _CELLS**2))
    if along == _SUBJECTS:
        return np.ones((size, _CELLS), dtype=np.intp)
    if along == _ENVIRONMENTS:
        return np.ones((_FEW, size), dtype=np.intp)
    # From the second on: the first has no repeats, and with it a study of one pattern no trial
    # level.
    patterns = list(itertools.product((1, 2, 3), repeat=_CELLS))
    return np.resize(np.array(patterns[1 : size + 1]), (_MANY, _CELLS))


def _density_call(along: str, size: int) -> Task:
    density = CollapsedDensity(growth_study(along, size))
    points = 0.5 * np.random.default_rng(1).standard_normal((_POINTS, density.dimension))
    return lambda: density(points)


def _propagation(along: str, size: int) -> Task:
    draws = size if along == _DRAWS else _OTHER_DRAWS
    omega = np.geomspace(0.1, 100.0, size if along == _OMEGA else _OTHER_OMEGA)
    rng = np.random.default_rng(1)
    mean = np.array([9.0, 2.0]) + 0.1 * rng.standard_normal((draws, 2))
    covariance = np.tile(0.01 * np.eye(2), (draws, 1, 1))
    batch = np.arange(draws) % _BATCHES
    device = Device(1.0, 5.0)

    def task() -> object:
        law = mixture_law(mean, covariance, batch, "lognormal")
        return Magnitude(law, device, 1e-3, omega).limits(0.99)

    return task


def _rows(name: str, along: str, tasks: Mapping[int, Task], rounds: int) -> list[Growth]:
    """Time tasks in turn, round by round, after one call each that is not counted."""
    calls = {}
    for size, task in tasks.items():
        once = max(_time(task), 1e-9)
        calls[size] = max(1, round(_SHORTEST / once))
    times = []
    for _ in range(rounds):
        times.append([_time(task, calls[size]) for size, task in tasks.items()])
    seconds = np.array(times)
    typical = np.median(seconds, axis=0).tolist()
    ratios = np.median(seconds / seconds[:, :1], axis=0).tolist()
    promised = _PROMISED.get(along)
    rows = []
    for size, median, ratio in zip(tasks, typical, ratios, strict=True):
        rows.append(Growth(name, along, size, median, ratio, promised))
    return rows


def _time(task: Task, calls: int = 1) -> float:
    started = time.process_time()
    for _ in range(calls):
        task()
    return (time.process_time() - started) / calls
