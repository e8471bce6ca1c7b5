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

Task: TypeAlias = Callable[[], object]

ROWS, SUBJECTS, PATTERNS, ENVIRONMENTS = (
    "trial rows",
    "subjects, equal patterns",
    "patterns",
    "environments",
)
OMEGA, DRAWS = "frequencies", "draws"
#: Sizes along every axis.
SIZES: Mapping[str, tuple[int, ...]] = {
    ROWS: (50, 500, 5_000, 50_000, 500_000, 5_000_000),
    SUBJECTS: (10, 100, 1_000, 10_000),
    PATTERNS: (1, 2, 5, 10, 20, 40),
    ENVIRONMENTS: (1, 2, 5, 10, 20, 50, 100, 200),
    OMEGA: (10, 100, 1_000, 10_000),
    DRAWS: (100, 1_000, 10_000, 100_000, 1_000_000),
}
#: Growth of a density call that is promised not to be passed.
_PROMISED = {ROWS: 1.10, SUBJECTS: 1.10}

_CELLS = 5  # subjects and environments of the studies whose rows are counted
_MANY = 40  # subjects of the studies whose patterns are counted
_POINTS = 256  # four ensembles of 64 walkers
_SHORTEST = 0.01  # s; shorter tasks are repeated within a round
_OTHER_OMEGA, _OTHER_DRAWS = 10, 1_000


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
    sizes: Mapping[str, Sequence[int]] = SIZES,
    log: Callable[[str], None] = lambda line: None,
) -> list[Growth]:
    """Time density calls and propagation along every axis."""
    rows = []
    for along, values in sizes.items():
        log(f"growth with {along}")
        studied = along not in (OMEGA, DRAWS)
        name, task = ("density call", _density_call) if studied else ("propagation", _propagation)
        rows += _rows(name, along, {size: task(along, size) for size in values}, rounds)
    return rows


def growth_study(along: str, size: int, *, seed: int = 1) -> Statistics:
    """Reduce a simulated study of stiffness and damping to what the density reads."""
    counts = _counts(along, size)
    subjects, environments = counts.shape
    rng = np.random.default_rng(seed)
    cell_means = 0.1 * rng.standard_normal((subjects, 1, 2)) + 0.2 * rng.standard_normal(
        (*counts.shape, 2)
    )
    cell = np.repeat(np.arange(counts.size), counts.ravel())
    response = cell_means.reshape(-1, 2)[cell]
    response += 0.05 * rng.standard_normal(response.shape)
    return from_trials(
        response,
        cell // environments,
        cell % environments,
        np.tile(np.linspace(-1.5, 1.5, environments) if environments > 1 else 0.0, (2, 1)),
        parameters=("k", "b"),
        environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1}" for i in range(subjects)),
    )


def _counts(along: str, size: int) -> NDArray[np.intp]:
    """Trials per subject and environment."""
    if along == ROWS:
        return np.full((_CELLS, _CELLS), math.ceil(size / _CELLS**2))
    if along == SUBJECTS:
        return np.ones((size, _CELLS), dtype=np.intp)
    if along == ENVIRONMENTS:
        return np.ones((10, size), dtype=np.intp)
    # From the second on: the first has no repeats, and with it a study of one pattern no trial
    # level.
    distinct = itertools.islice(itertools.product((1, 2, 3), repeat=_CELLS), 1, size + 1)
    return np.resize(np.array(list(distinct)), (_MANY, _CELLS))


def _density_call(along: str, size: int) -> Task:
    density = CollapsedDensity(growth_study(along, size))
    points = 0.5 * np.random.default_rng(1).standard_normal((_POINTS, density.dimension))
    return lambda: density(points)


def _propagation(along: str, size: int) -> Task:
    omegas, draws = (size, _OTHER_DRAWS) if along == OMEGA else (_OTHER_OMEGA, size)
    rng = np.random.default_rng(1)
    mean = np.array([9.0, 2.0]) + 0.1 * rng.standard_normal((draws, 2))
    covariance, batch = np.tile(0.01 * np.eye(2), (draws, 1, 1)), np.arange(draws) % 32
    omega = np.geomspace(0.1, 100.0, omegas)

    given = Device(1.0, 5.0), 1e-3, omega
    return lambda: Magnitude(mixture_law(mean, covariance, batch, "lognormal"), *given).limits(0.99)


def _rows(name: str, along: str, tasks: Mapping[int, Task], rounds: int) -> list[Growth]:
    """Time tasks in turn, round by round, after one call each that is not counted."""
    calls = {
        size: max(1, round(_SHORTEST / max(_time(task), 1e-9))) for size, task in tasks.items()
    }
    seconds = np.array(
        [[_time(task, calls[size]) for size, task in tasks.items()] for _ in range(rounds)]
    )
    ratios = np.median(seconds / seconds[:, :1], axis=0).tolist()
    promised = _PROMISED.get(along) if name == "density call" else None
    numbers = zip(tasks, np.median(seconds, axis=0).tolist(), ratios, strict=True)
    return [Growth(name, along, size, typical, ratio, promised) for size, typical, ratio in numbers]


def _time(task: Task, calls: int = 1) -> float:
    started = time.process_time()
    for _ in range(calls):
        task()
    return (time.process_time() - started) / calls
