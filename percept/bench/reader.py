"""The session reader against pandas' C parser: seconds and memory, each in a process of its own.

Run as `python -m percept.bench.reader --rows 5000000`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

_REFERENCES = {
    "VE1": (15.0, 0.7),
    "VE2": (1e3, 1.5),
    "VE3": (1e4, 10.0),
    "VE4": (2.5e4, 25.0),
    "VE5": (5e4, 100.0),
}
_CHILD = """
import json, resource, sys, time
task, path = sys.argv[1:]
if task == "pandas":
    import pandas as pd
    kinds = dict.fromkeys(("subject", "session", "environment"), "str") | {"trial": "int64"}
    kinds |= dict.fromkeys(("k_ref", "b_ref", "k_adj", "b_adj"), "float64")
    run = lambda: pd.read_csv(path, dtype=kinds, engine="c")
else:
    import percept.sessions
    run = lambda: getattr(percept.sessions, task)(path)
start, used = time.perf_counter(), time.process_time()
run()
print(json.dumps([time.perf_counter() - start, time.process_time() - used,
                  resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


@dataclass(frozen=True)
class Cost:
    """What one way of reading cost, the best of several runs."""

    task: str
    seconds: float
    cpu_seconds: float
    megabytes: float  # Peak resident memory of the process


def write_study(path: str | Path, rows: int, *, seed: int = 0) -> None:
    """Write a plain long table of about `rows` trials with full-precision numbers."""
    rng = np.random.default_rng(seed)
    subjects = max(2, min(1000, rows // 50))
    trials = max(1, rows // (subjects * len(_REFERENCES)))
    with Path(path).open("w", encoding="utf-8", newline="") as out:
        out.write("subject,session,environment,k_ref,b_ref,trial,k_adj,b_adj\n")
        for subject in range(subjects):
            for environment, (k, b) in _REFERENCES.items():
                adjusted = np.exp(rng.normal(0, (0.1, 0.2), (trials, 2))) * (k, b)
                place = f"{subject:04d},1,{environment},{k!r},{b!r}"
                out.writelines(f"{place},{t},{x!r},{y!r}\n" for t, (x, y) in enumerate(adjusted.tolist(), 1))


def measure(path: str | Path, task: str, *, repeats: int = 3) -> Cost:
    """Cost of one way of reading a file."""
    runs = []
    for _ in range(repeats):
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _CHILD, task, str(path)], capture_output=True, check=True
        )
        runs.append(json.loads(done.stdout))
    seconds, cpu, megabytes = (min(run[i] for run in runs) for i in range(3))
    return Cost(task, seconds, cpu, megabytes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: measure, print one JSON line per task with its ratios to pandas."""
    parser = argparse.ArgumentParser(prog="percept.bench.reader", description=__doc__)
    parser.add_argument("--rows", type=int, default=5_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--tasks", nargs="*", default=["read_sessions"])
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.csv"
        write_study(path, given.rows)
        base = measure(path, "pandas", repeats=given.repeats)
        for cost in (base, *(measure(path, task, repeats=given.repeats) for task in given.tasks)):
            ratios = {
                "time_ratio": cost.seconds / base.seconds,
                "cpu_ratio": cost.cpu_seconds / base.cpu_seconds,
                "memory_ratio": cost.megabytes / base.megabytes,
            }
            sys.stdout.write(json.dumps(asdict(cost) | ratios) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
