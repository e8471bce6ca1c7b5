"""Run every engine in processes of its own and reduce what they gave to one table."""

from __future__ import annotations

import dataclasses
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from percept.bench.measure import as_installed
from percept.bench.peers.engines import Engine
from percept.bench.peers.reference import Reference
from percept.bench.peers.responses import Responses
from percept.errors import RefusalError

_SPACING = 1000  # seeds between processes


@dataclasses.dataclass(frozen=True)
class Startup:
    """What the first run of a process takes beyond a later one: imports, data, building and compiling."""

    engine: str
    seconds: tuple[float, ...]  # Wall time of every process
    processor: float  # Median processor time of the same, s


@dataclasses.dataclass(frozen=True)
class Measured:
    """One engine at one budget, limits worked out in one way; medians over repeats."""

    engine: str
    how: str
    size: float  # Budget in the engine's unit
    repeats: int  # Runs
    warm: float
    cold: float
    warm_range: tuple[float, float]  # Shortest and longest warm time
    processor: float  # Processor time of a warm run, s
    error: float  # Root mean square over all limits of the difference from the reference, over half-widths
    error_range: tuple[float, float]  # Smallest and largest
    effective_per_second: float  # Effective draws of the slowest quantity, per second of a warm run
    effective_per_processor_second: float  # The same per second of processor time
    agreement: float  # Root mean square of (limit - reference) over the Monte Carlo error of both
    notes: dict[str, float]  # Medians of what the engine said


def measure(
    engines: Sequence[Engine],
    source: str,
    reference: Reference,
    *,
    starts: int = 3,
    seconds: float = 150.0,
    quick: bool = False,
    told: Callable[[str], None] = lambda line: None,
) -> tuple[list[Startup], list[Measured]]:
    """Measure engines one after the other."""
    startups: list[Startup] = []
    measured: list[Measured] = []
    with tempfile.TemporaryDirectory() as folder:
        study = str(Path(folder, "study.npz"))
        Responses.of_sessions(source).save(study)
        for one in engines:
            sizes = [[size, 1] for size in one.quick] if quick else [[b.size, b.repeats] for b in one.budgets]
            found = []
            for start in range(1 if quick else starts):
                told(f"{one.title}: process {start + 1}")
                task = {
                    "engine": one.name, "study": study, "source": str(Path(source).resolve()),
                    "budgets": sizes if start == 0 else [[sizes[0][0], 0]], "seconds": seconds,
                    "seed": 1 + _SPACING * start,
                }  # fmt: skip
                found.append(_child(task, Path(folder, "task.json")))
            startup = _startup(one.name, found)
            startups.append(startup)
            measured += _reduced(one.name, found[0]["runs"], startup, reference)
    return startups, measured


def _startup(name: str, found: list[dict[str, Any]]) -> Startup:
    runs = found[0]["runs"]
    again = [run for run in runs if run["size"] == runs[0]["size"]]
    warm, processor = (statistics.median(run[key] for run in again) for key in ("seconds", "processor"))
    return Startup(
        name,
        tuple(max(child["first"] - warm, 0.0) for child in found),
        max(statistics.median(child["first_processor"] for child in found) - processor, 0.0),
    )


def _child(task: dict[str, Any], file: Path) -> dict[str, Any]:
    file.write_text(json.dumps(task | {"started": time.time()}), encoding="utf-8")
    command = [sys.executable, "-m", "percept.bench.peers.child", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=as_installed())
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise RefusalError(
            f"the process of {task['engine']} failed: {last[0]}",
            hint="The other samplers come with the extra: pip install 'percept[peers]'.",
        )
    # Some libraries print to standard output, around the result.
    found: dict[str, Any] = json.JSONDecoder().raw_decode(done.stdout, done.stdout.index('{"first"'))[0]
    return found


def _reduced(name: str, runs: list[dict[str, Any]], startup: Startup, reference: Reference) -> list[Measured]:
    begin = statistics.median(startup.seconds)
    rows = []
    for size in dict.fromkeys(run["size"] for run in runs):
        group = [run for run in runs if run["size"] == size]
        seconds = [run["seconds"] for run in group]
        warm, processor = statistics.median(seconds), statistics.median(run["processor"] for run in group)
        for how in group[0]["limits"]:
            limits = [run["limits"][how] for run in group]
            errors = [reference.relative_error(np.array(one["value"])) for one in limits]
            effective = statistics.median(one["effective"] for one in limits)
            notes = group[0]["notes"]
            rows.append(
                Measured(
                    engine=name,
                    how=how,
                    size=size,
                    repeats=len(group),
                    warm=warm,
                    cold=begin + warm,
                    warm_range=(min(seconds), max(seconds)),
                    processor=processor,
                    error=statistics.median(errors),
                    error_range=(min(errors), max(errors)),
                    effective_per_second=effective / warm,
                    effective_per_processor_second=effective / processor,
                    agreement=_agreement(limits, reference),
                    notes={key: statistics.median(run["notes"][key] for run in group) for key in notes},
                )
            )
    return rows


def _agreement(limits: list[dict[str, Any]], reference: Reference) -> float:
    """Pooled over the repeats, whose errors are independent."""
    apart = [
        (np.array(one["value"]) - reference.own.value) / np.hypot(np.array(one["error"]), reference.own.error)
        for one in limits
    ]
    return float(np.sqrt(np.mean(np.square(apart))))
