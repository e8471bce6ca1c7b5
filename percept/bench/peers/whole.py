"""Whole commands beside the import of what people use today: the wall time of processes."""

from __future__ import annotations

import dataclasses
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from percept.bench.measure import as_installed
from percept.errors import RefusalError

_NEEDED = "numpy, scipy.stats, pandas, emcee, arviz_base, arviz_stats, h5netcdf"


def _percept(command: str) -> tuple[str, ...]:
    return ("-m", "percept", command, "SESSIONS", "--out", "OUT")


#: Name to arguments of Python; SESSIONS, SCENE, OUT and SEED, another in every round, are filled in.
COMMANDS = {
    "import pymc": ("-c", "import pymc"),
    "import what percept fit needs": ("-c", f"import {_NEEDED}"),
    "percept report": (*_percept("report"), "--seed", "SEED", "--scene", "SCENE"),
    "percept fit": (*_percept("fit"), "--seed", "SEED"),
    "percept fit, 2 %": (*_percept("fit"), "--seed", "SEED", "--tolerance", "0.02"),
    "percept fit, classical": (*_percept("fit"), "--method", "classical"),
}
#: Command, what it is compared with, and the largest ratio promised.
_PROMISES = (
    ("percept report", "import pymc", 2.0),
    ("percept fit", "import pymc", 1.0),
    ("percept fit, classical", "import pymc", 0.35),
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

    command: str  # Names
    against: str  # Names
    ratio: float
    processor_ratio: float  # Of the median processor times
    promised: float  # Largest ratio promised

    @property
    def kept(self) -> bool:
        """Whether the wall time keeps the promise."""
        return self.ratio <= self.promised


def whole_commands(
    sessions: str, scene: str, *, repeats: int = 5, commands: Mapping[str, Sequence[str]] = COMMANDS
) -> list[Whole]:
    """Run every command in turn, round by round, so that all see the machine alike."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    for round_ in range(repeats + 1):
        for name, arguments in commands.items():
            with tempfile.TemporaryDirectory() as out:
                spent = _run(_filled(arguments, sessions, scene, str(Path(out, "out")), str(round_)))
            if round_:
                times[name].append(spent)
    found = []
    for name, arguments in commands.items():
        wall, processor = zip(*times[name], strict=True)
        typed = " ".join(_quoted(part) for part in _filled(arguments, "SESSIONS", "SCENE", "DIR", "SEED"))
        typed = f"python {typed}".replace("python -m percept", "percept")
        found.append(Whole(name, typed, wall, statistics.median(wall), statistics.median(processor)))
    return found


def comparisons(found: Sequence[Whole]) -> list[Comparison]:
    """Return the ratios that are promised."""
    by_name = {one.name: one for one in found}
    rows = []
    for command, against, promised in _PROMISES:
        one, other = by_name[command], by_name[against]
        ratio = statistics.median(a / b for a, b in zip(one.seconds, other.seconds, strict=True))
        rows.append(Comparison(command, against, ratio, one.processor / other.processor, promised))
    return rows


def _filled(arguments: Sequence[str], sessions: str, scene: str, out: str, seed: str) -> list[str]:
    places = {"SESSIONS": sessions, "SCENE": scene, "OUT": out, "SEED": seed}
    return [places.get(part, part) for part in arguments]


def _quoted(part: str) -> str:
    return f'"{part}"' if " " in part else part


def _run(arguments: Sequence[str]) -> tuple[float, float]:
    """Wall and processor seconds of one process; percept finds no posterior kept from an earlier one."""
    before, started = os.times(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False,
        env=as_installed(PERCEPT_CACHE="off"),
    )  # fmt: skip
    wall, after = time.perf_counter() - started, os.times()
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise RefusalError(f"{' '.join(arguments[:3])} failed: {last[0]}")
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, processor
