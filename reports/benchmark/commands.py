"""Whole commands in new processes, next to the import of what they stand on."""

from __future__ import annotations

import shlex
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Annotated

from reports import dataset
from reports.benchmark.measure import processor_seconds, python_output

#: What every ratio is over.
IMPORTS = "imports"
_NEEDED = (
    "numpy, scipy.stats, pandas, emcee, xarray, h5netcdf, matplotlib.pyplot"  # As a report needs
)
_REPORT = ("-m", "percept", "report", "SESSIONS", "--scene", "SCENE", "--out", "OUT")
_FIT = ("-m", "percept", "fit", "SESSIONS", "--out", "OUT")
#: Name to arguments of Python. SESSIONS, SCENE, OUT and SEED, another in every round, are filled
#: in.
COMMANDS: dict[str, tuple[str, ...]] = {
    IMPORTS: ("-c", f"import {_NEEDED}"),
    "report": (*_REPORT, "--seed", "SEED"),
    "report, classical": (*_REPORT, "--method", "classical"),
    "fit": (*_FIT, "--seed", "SEED"),
    "fit, 2 %": (*_FIT, "--seed", "SEED", "--tolerance", "0.02"),
    "fit, classical": (*_FIT, "--method", "classical"),
    "validate": ("-m", "percept", "validate", "SESSIONS"),
}
#: Largest ratios of wall and of processor time to the imports that are promised.
_PROMISED = {"report": (4.0, 5.0), "report, classical": (2.9, 2.9), "fit": (2.1, 2.1)}


@dataclass(frozen=True)
class CommandCost:
    """Commands on the published study; medians over rounds, in which all take turns."""

    command: Annotated[str, "What is run."]
    typed: Annotated[str, "As it is typed."]
    wall_s: Annotated[float, "Wall time of the process, s."]
    processor_s: Annotated[float, "Its processor time, s."]
    wall_ratio: Annotated[float, "Wall time over that of the imports of its libraries."]
    processor_ratio: Annotated[float, "The same of processor time."]
    promised: Annotated[tuple[float, ...], "Largest ratios promised: wall, processor."]
    kept: Annotated[bool, "Whether both are."]


def command_costs(
    repeats: int, commands: Mapping[str, Sequence[str]] = COMMANDS
) -> list[CommandCost]:
    """Run every command in turn, round by round, so that all meet the same machine load.

    A round more comes first, which fills the system's caches and does not count.
    """
    wall: dict[str, list[float]] = {name: [] for name in commands}
    processor: dict[str, list[float]] = {name: [] for name in commands}
    for seed in range(repeats + 1):
        for name, words in commands.items():
            with tempfile.TemporaryDirectory() as folder:
                before = processor_seconds()
                started = time.perf_counter()
                # No posterior of an earlier run is found.
                python_output(*_filled(words, f"{folder}/out", seed), PERCEPT_CACHE="off")
                if seed:
                    wall[name].append(time.perf_counter() - started)
                    processor[name].append(processor_seconds() - before)
    rows = []
    for name, words in commands.items():
        typed = shlex.join(["python", *words]).replace("python -m percept", "percept")
        ratios = []
        for times in (wall, processor):
            pairs = zip(times[name], times[IMPORTS], strict=True)
            ratios.append(median(mine / imports for mine, imports in pairs))
        promised = _PROMISED.get(name, ())
        kept = all(ratio <= most for ratio, most in zip(ratios, promised, strict=False))
        row = CommandCost(
            command=name,
            typed=typed,
            wall_s=median(wall[name]),
            processor_s=median(processor[name]),
            wall_ratio=ratios[0],
            processor_ratio=ratios[1],
            promised=promised,
            kept=kept,
        )
        rows.append(row)
    return rows


def _filled(words: Sequence[str], out: str, seed: int) -> list[str]:
    sessions = str(dataset("hbfd_sessions.csv"))
    scene = str(dataset("hbfd.toml"))
    values = {"SESSIONS": sessions, "SCENE": scene, "OUT": out, "SEED": str(seed)}
    return [values.get(word, word) for word in words]
