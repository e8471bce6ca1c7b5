"""What other processes save of the wall time of `fit` and `report`, whose files they must not change.

percept bench processes
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from percept.bench.as_installed import as_installed
from percept.cores import cores

__all__ = ["ProcessGain", "process_gains"]

_WRITTEN = "2026-01-01"


@dataclasses.dataclass(frozen=True)
class ProcessGain:
    """One command on the published study, in so many processes; medians over repeats.

    Attributes
    ----------
    task : str
        "fit" or "report".
    tolerance : float
        Of the sampler.
    processes : int
        In all.
    wall_s : float
        From the start of the interpreter to its end, s.
    gain : float
        Wall time in one process over this one.
    same : bool
        Whether every file is that of one process, byte for byte.
    """

    task: str
    tolerance: float
    processes: int
    wall_s: float
    gain: float
    same: bool


def process_gains(
    tasks: Sequence[tuple[str, float]] = (("fit", 0.01), ("fit", 0.003), ("report", 0.01)),
    *,
    most: int | None = None,
    repeats: int = 3,
    told: Callable[[str], None] = lambda line: None,
) -> list[ProcessGain]:
    """Run commands in one process and in several, by turns.

    Parameters
    ----------
    tasks : sequence of (str, float)
        "fit" or "report", and the tolerance.
    most : int, optional
        Processes to go up to; by default all cores.
    repeats : int
        Runs of each.
    told : callable
        Told one line per round.

    Returns
    -------
    list of ProcessGain
    """
    counts = range(1, (cores() if most is None else most) + 1)
    found = []
    for task, tolerance in tasks:
        seconds: dict[int, list[float]] = {count: [] for count in counts}
        digests: dict[int, set[str]] = {count: set() for count in counts}
        for turn in range(repeats):
            told(f"{task} at {tolerance:g}: round {turn + 1}")
            for count in counts:
                took, digest = _timed(task, tolerance, count)
                seconds[count].append(took)
                digests[count].add(digest)
        alone = statistics.median(seconds[1])
        for count in counts:
            wall = statistics.median(seconds[count])
            found.append(
                ProcessGain(task, tolerance, count, wall, alone / wall, len(digests[1] | digests[count]) == 1)
            )
    return found


def _timed(task: str, tolerance: float, count: int) -> tuple[float, str]:
    command = [sys.executable, "-m", "percept.bench.processes", task, str(tolerance), str(count)]
    started = time.perf_counter()
    # As the command line sets it.
    environment = as_installed(OPENBLAS_NUM_THREADS="1")
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return time.perf_counter() - started, done.stdout.strip()


def _main(words: Sequence[str] | None = None) -> None:
    """Write the published study's files in so many processes, and print a digest of them."""
    parser = argparse.ArgumentParser(description=_main.__doc__)
    parser.add_argument("task", choices=("fit", "report"))
    parser.add_argument("tolerance", type=float)
    parser.add_argument("processes", type=int)
    asked = parser.parse_args(words)

    from percept.report import write_fit, write_report
    from percept.reproduce.published import dataset
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study import Study

    scene = Scene.load(dataset("hbfd.toml")).with_inference(tolerance=asked.tolerance)
    study = Study(read_sessions(dataset("hbfd_sessions.csv")), scene)
    digest = hashlib.sha256()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        rest: dict[str, Any] = {"processes": asked.processes}
        if asked.task == "fit":
            write_fit(study, out, **rest)
        else:
            write_report(study, out, date=_WRITTEN, **rest)
        for path in sorted(path for path in out.rglob("*") if path.is_file()):
            digest.update(path.relative_to(out).as_posix().encode() + b"\0" + path.read_bytes())
    sys.stdout.write(digest.hexdigest())


if __name__ == "__main__":
    _main()
