"""A batch at full load for as long as is wanted, its memory, files and processes watched.

    python -m percept.bench.soak --minutes 60

Studies are made as they are needed, each a different one; the batch, its scheduler and its workers are the
real ones. What is told at the end is the slope of each series over time with its standard error: flat is a
slope within its error of zero, or one that would not matter in a month. For POSIX systems.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from percept.bench.small_studies import write_small_studies
from percept.errors import UsageError

_BATCH = 16  # studies per call: each opens, locks and combines anew, over the same workers
# Part of the time that is left out of the slopes: imports, first allocations.
_START = 0.25


@dataclasses.dataclass(frozen=True)
class Slope:
    """How a series changes."""

    name: str  # Of the series
    unit: str  # Of the series
    mean: float  # Over the time looked at
    per_hour: float
    error: float


@dataclasses.dataclass(frozen=True)
class Soak:
    """What was seen."""

    minutes: float  # How long it ran
    workers: int
    studies: int
    samples: int
    slopes: tuple[Slope, ...]  # Resident memory of this process and of the workers together


def slope(seconds: Sequence[float], values: Sequence[float], name: str, unit: str) -> Slope:
    """Fit a line to a series, its first quarter left out."""
    t, y = np.asarray(seconds, dtype=float) / 3600.0, np.asarray(values, dtype=float)
    late = t >= t[0] + _START * (t[-1] - t[0])
    t, y = t[late], y[late]
    if t.size < 3:
        raise UsageError("a slope needs at least three values.", value=int(t.size), hint="Soak longer.")
    apart = t - t.mean()
    rate = float(apart @ y / (apart @ apart))
    left = y - y.mean() - rate * apart
    error = float(np.sqrt(left @ left / (t.size - 2) / (apart @ apart)))
    return Slope(name, unit, float(y.mean()), rate, error)


def soak(minutes: float, *, workers: int = 2, every: float = 5.0, tolerance: float = 0.1) -> Soak:
    """Run batches for so long and watch them."""
    from percept.batch import run_batch, sources
    from percept.workers import OnCluster, connected

    watch = _Watch(every)
    stop = time.monotonic() + 60.0 * minutes
    rng = np.random.default_rng(1)
    started, studies = time.monotonic(), 0
    with tempfile.TemporaryDirectory(prefix="percept-soak-") as root, connected(workers=workers) as client:
        mapper = OnCluster(client)
        watch.start()
        try:
            for number in itertools.count():
                paths = write_small_studies(Path(root), _BATCH, rng)
                found = sources(paths, changes={"tolerance": tolerance})
                studies += run_batch(found, Path(root) / f"out-{number % 2}", mapper).studies
                if time.monotonic() > stop:
                    break
        finally:
            watch.stop()
    slopes = tuple(slope(watch.seconds, values, name, unit) for (name, unit), values in watch.series.items())
    return Soak((time.monotonic() - started) / 60.0, workers, studies, len(watch.seconds), slopes)


class _Watch:
    """Looks at this process and those below it, from a thread of its own."""

    def __init__(self, every: float) -> None:
        import psutil

        self._process = psutil.Process()
        self._gone = psutil.NoSuchProcess
        self._every = every
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.seconds: list[float] = []
        self.series: dict[tuple[str, str], list[float]] = {
            ("memory of the process that hands out", "MB"): [],
            ("memory of the workers", "MB"): [],
            ("open files", ""): [],
            ("processes", ""): [],
        }

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._every):
            memory, files, processes = [0.0, 0.0], 0, 0
            for one in (self._process, *self._process.children(recursive=True)):
                try:
                    memory[one != self._process] += one.memory_info().rss / 1e6
                    files += one.num_fds()
                    processes += 1
                except self._gone:
                    continue
            self.seconds.append(time.monotonic())
            for values, value in zip(self.series.values(), (*memory, files, processes), strict=True):
                values.append(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Soak for as long as asked and print what was seen, as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0, metavar="M", help="how long (60)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (2)")
    parser.add_argument("--every", type=float, default=5.0, metavar="S", help="seconds between looks (5)")
    asked = parser.parse_args(arguments)
    found = soak(asked.minutes, workers=asked.workers, every=asked.every)
    json.dump(dataclasses.asdict(found), sys.stdout, indent=1)
    sys.stdout.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
