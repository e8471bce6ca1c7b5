"""Engines and whole commands timed in processes of their own.

``python -m percept.bench.peers.processes TASK`` is the process of one engine: a first run from the
start of the process, then runs of every budget. It prints JSON.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shlex
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from percept.bench.measure import in_a_process, print_result, python_output
from percept.bench.peers.engines import Engine, engine, study_statistics

if TYPE_CHECKING:
    # What it needs would count as the start of every engine's process.
    from percept.bench.peers.reference import Reference


@dataclasses.dataclass(frozen=True)
class Measured:
    """One engine at one budget; medians over repeats."""

    study: str
    engine: str
    size: float  # Budget in the engine's unit
    repeats: int
    warm: float  # Wall time of sampling and limits, s
    cold: float  # The same with the start of the process, s
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
    study: str,
    reference: Reference,
    *,
    seconds: float = 150.0,
    quick: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> list[Measured]:
    """Measure engines on one study, one after the other."""
    measured: list[Measured] = []
    for one in engines:
        log(f"{study}, {one.title}")
        task = {
            "engine": one.name, "study": study, "seconds": seconds, "seed": 1,
            "budgets": ((one.quick, 1),) if quick else one.budgets, "started": time.time(),
        }  # fmt: skip
        measured += _reduced(study, one.name, in_a_process(__name__, task), reference)
    return measured


def _reduced(study: str, name: str, given: dict[str, Any], reference: Reference) -> list[Measured]:
    runs, rows = given["runs"], []
    # What the first run of a process takes beyond a later one: imports, building and compiling.
    again = median(run["seconds"] for run in runs if run["size"] == runs[0]["size"])
    start = max(given["first"] - again, 0.0)
    for size in dict.fromkeys(run["size"] for run in runs):
        group = [run for run in runs if run["size"] == size]
        seconds, values = (
            [run["seconds"] for run in group],
            np.array([run["value"] for run in group]),
        )
        claimed = np.hypot([run["error"] for run in group], reference.error)
        errors = [reference.relative_error(value) for value in values]
        warm, worked, draws = (
            median(run[key] for run in group) for key in ("seconds", "processor", "effective")
        )
        rows.append(
            Measured(
                study=study,
                engine=name,
                size=size,
                repeats=len(group),
                warm=warm,
                cold=start + warm,
                warm_range=(min(seconds), max(seconds)),
                processor=worked,
                error=median(errors),
                error_range=(min(errors), max(errors)),
                effective_per_second=draws / warm,
                effective_per_processor_second=draws / worked,
                agreement=float(np.sqrt(np.mean(((values - reference.value) / claimed) ** 2))),
                notes={
                    key: median(run["notes"][key] for run in group) for key in group[0]["notes"]
                },
            )
        )
    return rows


_NEEDED = "numpy, scipy.stats, pandas, emcee, arviz_base, arviz_stats, h5netcdf"
_REPORT, _FIT = (
    ("-m", "percept", command, "SESSIONS", "--out", "OUT") for command in ("report", "fit")
)
#: Name to arguments of Python; SESSIONS, SCENE, OUT and SEED, another in every round, are filled
#: in.
COMMANDS = {
    "import pymc": ("-c", "import pymc"),
    "import what percept fit needs": ("-c", f"import {_NEEDED}"),
    "percept report": (*_REPORT, "--seed", "SEED", "--scene", "SCENE"),
    "percept report, no checks": (*_REPORT, "--seed", "SEED", "--scene", "SCENE", "--no-checks"),
    "percept fit": (*_FIT, "--seed", "SEED"),
    "percept fit, 2 %": (*_FIT, "--seed", "SEED", "--tolerance", "0.02"),
    "percept fit, classical": (*_FIT, "--method", "classical"),
}
#: Commands that a quick benchmark leaves out.
LONGEST = ("percept report", "percept report, no checks", "percept fit", "percept fit, 2 %")
#: Command, what it is compared with, and the largest ratio promised.
_PROMISES = (
    ("percept report", "import pymc", 4.5),
    ("percept report, no checks", "import pymc", 3.2),
    ("percept fit", "import pymc", 1.1),
    ("percept fit, classical", "import pymc", 0.5),
    ("percept fit, 2 %", "import what percept fit needs", 1.6),
)


@dataclasses.dataclass(frozen=True)
class Whole:
    """Wall times of one command, each in a new process."""

    name: str
    command: str  # As typed
    seconds: tuple[float, ...]  # Every run, s, in order
    median: float  # Their median
    processor: float  # Median processor time, s


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A command's time over another's."""

    command: str
    against: str
    ratio: float  # Median over the rounds, of wall times
    processor_ratio: float  # Of the median processor times
    promised: float  # Largest ratio promised
    kept: bool  # Whether wall and processor time both keep the promise


def whole_commands(
    sessions: str, scene: str, *, repeats: int, commands: Mapping[str, Sequence[str]]
) -> list[Whole]:
    """Run every command in turn, round by round, so that all see the machine alike.

    One round more comes before those, and counts only where `repeats` is 0.
    """
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    for round_ in range(repeats + 1):
        for name, words in commands.items():
            with tempfile.TemporaryDirectory() as out:
                spent = _timed(_filled(words, sessions, scene, str(Path(out, "out")), str(round_)))
            if round_ or not repeats:  # the first fills the system's caches
                times[name].append(spent)
    rows = []
    for name, words in commands.items():
        wall, processor = zip(*times[name], strict=True)
        typed = shlex.join(["python", *_filled(words, "SESSIONS", "SCENE", "DIR", "SEED")])
        typed = typed.replace("python -m percept", "percept")
        rows.append(Whole(name, typed, wall, median(wall), median(processor)))
    return rows


def comparisons(rows: Sequence[Whole]) -> list[Comparison]:
    """Return the ratios that are promised, of the commands that were run."""
    by_name = {one.name: one for one in rows}
    found = []
    for command, against, promised in _PROMISES:
        if command in by_name and against in by_name:
            one, other = by_name[command], by_name[against]
            ratio = median(a / b for a, b in zip(one.seconds, other.seconds, strict=True))
            processor = one.processor / other.processor
            kept = max(ratio, processor) <= promised
            found.append(Comparison(command, against, ratio, processor, promised, kept))
    return found


def _filled(words: Sequence[str], sessions: str, scene: str, out: str, seed: str) -> list[str]:
    values = {"SESSIONS": sessions, "SCENE": scene, "OUT": out, "SEED": seed}
    return [values.get(word, word) for word in words]


def _timed(words: Sequence[str]) -> tuple[float, float]:
    """Wall and processor seconds of one process; percept finds no posterior kept from an earlier one."""
    before, started = processor_seconds(), time.perf_counter()
    python_output(*words, PERCEPT_CACHE="off")
    return time.perf_counter() - started, processor_seconds() - before


def main(given: str) -> None:
    """Run an engine as its task says and print what it gave."""
    task = json.loads(given)
    warnings.simplefilter(
        "ignore"
    )  # samplers warn about runs as short as some of these are meant to be
    began = time.time()
    statistics = study_statistics(task["study"])
    # Reading is the same for all engines, and no part of any of them.
    read = time.time() - began
    sampler = engine(task["engine"]).prepare(statistics)
    seed = task["seed"]
    runs: list[dict[str, Any]] = []
    sampler(task["budgets"][0][0], seed)
    first = time.time() - task["started"] - read
    for size, repeats in task["budgets"]:
        for _ in range(repeats):
            if runs and time.time() - task["started"] > task["seconds"]:
                break
            seed += 1
            before = processor_seconds()
            fitted = sampler(size, seed)
            spent = processor_seconds() - before
            runs.append({"size": size, "processor": spent} | dataclasses.asdict(fitted))
    print_result({"first": first, "runs": runs})


def processor_seconds() -> float:
    """Processor seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    main(sys.argv[1])
