"""Engines and whole commands timed in processes of their own.

``python -m reports.benchmark.peers.processes TASK`` is the process of one engine: a first run
from the start of the process, then runs of every budget. It prints JSON.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from reports.benchmark.measure import Printed, in_a_process, print_result, python_output
from reports.benchmark.peers.engines import Engine, engine, study_of
from reports.command import say

if TYPE_CHECKING:
    # What it needs would count as the start of every engine's process.
    from reports.benchmark.peers.reference import Reference


@dataclass(frozen=True)
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
    error: float  # Root mean square of all limits' differences from the reference, over half-widths
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
) -> list[Measured]:
    """Measure engines on one study, one after the other.

    Parameters
    ----------
    engines : sequence of Engine
        Installed ones.
    study : str
        Of `STUDIES`.
    reference : Reference
        Its limits.
    seconds : float
        After these no run of an engine begins.
    quick : bool
        One run each, of the size that shows that it works.

    Returns
    -------
    list of Measured
        Engine by engine, the smallest budget first.
    """
    measured: list[Measured] = []
    for sampler in engines:
        say(f"{study}, {sampler.title}")
        task = {
            "engine": sampler.name,
            "study": study,
            "seconds": seconds,
            "seed": 1,
            "budgets": ((sampler.quick, 1),) if quick else sampler.budgets,
            "started": time.time(),
        }
        measured += _reduced(study, sampler.name, in_a_process(__name__, task), reference)
    return measured


def _reduced(study: str, name: str, printed: Printed, reference: Reference) -> list[Measured]:
    """Reduce the runs of an engine to a row for each budget."""
    by_size: dict[float, list[Printed]] = {}
    for run in printed["runs"]:
        by_size.setdefault(run["size"], []).append(run)
    smallest = next(iter(by_size.values()))
    # What the first run of a process takes beyond a later one: imports, building and compiling.
    start = max(printed["first"] - median(run["seconds"] for run in smallest), 0.0)
    return [_row(study, name, start, runs, reference) for runs in by_size.values()]


def _row(
    study: str, name: str, start: float, runs: Sequence[Printed], reference: Reference
) -> Measured:
    seconds = [run["seconds"] for run in runs]
    values = np.array([run["value"] for run in runs])
    errors = [reference.relative_error(value) for value in values]
    warm = median(seconds)
    processor = median(run["processor"] for run in runs)
    effective = median(run["effective"] for run in runs)
    difference = values - reference.value
    claimed = np.hypot([run["error"] for run in runs], reference.error)
    notes = {}
    for key in runs[0]["notes"]:
        notes[key] = median(run["notes"][key] for run in runs)
    return Measured(
        study=study,
        engine=name,
        size=runs[0]["size"],
        repeats=len(runs),
        warm=warm,
        cold=start + warm,
        warm_range=(min(seconds), max(seconds)),
        processor=processor,
        error=median(errors),
        error_range=(min(errors), max(errors)),
        effective_per_second=effective / warm,
        effective_per_processor_second=effective / processor,
        agreement=float(np.sqrt(np.mean((difference / claimed) ** 2))),
        notes=notes,
    )


_NEEDED = "numpy, scipy.optimize, pandas, emcee, h5netcdf"
_REPORT = ("-m", "percept", "report", "SESSIONS", "--out", "OUT")
_FIT = ("-m", "percept", "fit", "SESSIONS", "--out", "OUT")
_SEEDED_REPORT = (*_REPORT, "--seed", "SEED", "--scene", "SCENE")
#: Name to arguments of Python; SESSIONS, SCENE, OUT and SEED, another in every round, are filled
#: in.
COMMANDS: dict[str, tuple[str, ...]] = {
    "import pymc": ("-c", "import pymc"),
    "import what percept fit needs": ("-c", f"import {_NEEDED}"),
    "percept report": _SEEDED_REPORT,
    "percept report, no checks": (*_SEEDED_REPORT, "--no-checks"),
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


@dataclass(frozen=True)
class Whole:
    """Wall times of one command, each in a new process."""

    name: str
    command: str  # As typed
    seconds: tuple[float, ...]  # Every run, s, in order
    median: float  # Their median
    processor: float  # Median processor time, s


@dataclass(frozen=True)
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
    """Run every command in turn, round by round, so that all meet the same machine load.

    One round more comes before those, and counts only where `repeats` is 0.

    Parameters
    ----------
    sessions, scene : str
        Files of the study.
    repeats : int
        Rounds that count.
    commands : mapping
        As `COMMANDS`.

    Returns
    -------
    list of Whole
        A row for each command.

    Raises
    ------
    RefusalError
        Where a command fails.
    """
    wall: dict[str, list[float]] = {name: [] for name in commands}
    processor: dict[str, list[float]] = {name: [] for name in commands}
    for round_ in range(repeats + 1):
        for name, words in commands.items():
            with tempfile.TemporaryDirectory() as folder:
                out = str(Path(folder, "out"))
                seconds, worked = _timed(_filled(words, sessions, scene, out, str(round_)))
            # The first round fills the system's caches.
            if round_ or not repeats:
                wall[name].append(seconds)
                processor[name].append(worked)
    rows = []
    for name, words in commands.items():
        typed = shlex.join(["python", *_filled(words, "SESSIONS", "SCENE", "DIR", "SEED")])
        typed = typed.replace("python -m percept", "percept")
        times = tuple(wall[name])
        rows.append(Whole(name, typed, times, median(times), median(processor[name])))
    return rows


def comparisons(rows: Sequence[Whole]) -> list[Comparison]:
    """Return the ratios that are promised, of the commands that were run."""
    by_name = {row.name: row for row in rows}
    compared = []
    for command, against, promised in _PROMISES:
        if command not in by_name or against not in by_name:
            continue
        timed = by_name[command]
        other = by_name[against]
        ratio = median(a / b for a, b in zip(timed.seconds, other.seconds, strict=True))
        processor = timed.processor / other.processor
        kept = max(ratio, processor) <= promised
        compared.append(Comparison(command, against, ratio, processor, promised, kept))
    return compared


def _filled(words: Sequence[str], sessions: str, scene: str, out: str, seed: str) -> list[str]:
    values = {"SESSIONS": sessions, "SCENE": scene, "OUT": out, "SEED": seed}
    return [values.get(word, word) for word in words]


def _timed(words: Sequence[str]) -> tuple[float, float]:
    """Return wall and processor seconds of one process; it finds no posterior of an earlier one."""
    before = _processor_seconds()
    started = time.perf_counter()
    python_output(*words, PERCEPT_CACHE="off")
    return time.perf_counter() - started, _processor_seconds() - before


def _main(text: str) -> None:
    """Run an engine as its task says and print what it gave."""
    task = json.loads(text)
    # Samplers warn about runs as short as some of these are meant to be.
    warnings.simplefilter("ignore")
    began = time.time()
    study = study_of(task["study"])
    # Reading is the same for all engines, and no part of any of them.
    read = time.time() - began
    sampler = engine(task["engine"]).prepare(study)
    seed = task["seed"]
    smallest, _ = task["budgets"][0]
    sampler(smallest, seed)
    first = time.time() - task["started"] - read
    runs: list[Printed] = []
    for size, repeats in task["budgets"]:
        for _ in range(repeats):
            if runs and time.time() - task["started"] > task["seconds"]:
                break
            seed += 1
            before = _processor_seconds()
            fitted = asdict(sampler(size, seed))
            runs.append({"size": size, "processor": _processor_seconds() - before, **fitted})
    print_result({"first": first, "runs": runs})


def _processor_seconds() -> float:
    """Return processor seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    _main(sys.argv[1])
