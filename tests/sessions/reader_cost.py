"""The session reader against pandas' C parser: seconds and memory, each in a process of its own.

Run as `python -m tests.sessions.reader_cost --rows 5000000`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
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
way, path = sys.argv[1:]
if way == "pandas":
    import pandas as pd
    kinds = dict.fromkeys(("subject", "session", "environment"), "str") | {"trial": "int64"}
    kinds |= dict.fromkeys(("k_ref", "b_ref", "k_adj", "b_adj"), "float64")
    run = lambda: pd.read_csv(path, dtype=kinds, engine="c")
else:
    import percept.sessions
    run = lambda: percept.sessions.read_sessions(path)
start, used = time.perf_counter(), time.process_time()
run()
print(json.dumps([time.perf_counter() - start, time.process_time() - used,
                  resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


@dataclasses.dataclass(frozen=True)
class ReadCost:
    """What reading one file cost, the best of several runs."""

    way: str  # "percept", or "pandas" with the columns' types given
    rows: int
    seconds: float
    cpu_seconds: float
    megabytes: float  # Peak resident memory of the process
    time_ratio: float  # Over pandas'
    cpu_ratio: float
    memory_ratio: float


def read_costs(rows: int = 1_000_000, *, repeats: int = 3) -> list[ReadCost]:
    """Read a plain long table both ways."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.csv"
        rows = write_study(path, rows)
        best = {way: _best(way, path, repeats) for way in ("pandas", "percept")}
    return [ReadCost(way, rows, *cost, *(cost / best["pandas"])) for way, cost in best.items()]


def _best(way: str, path: Path, repeats: int) -> np.ndarray:
    command = [sys.executable, "-W", "ignore", "-c", _CHILD, way, str(path)]
    runs = [
        json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        for _ in range(repeats)
    ]
    return np.min(runs, axis=0)


def write_study(path: str | Path, rows: int, *, seed: int = 0) -> int:
    """Write about `rows` trials with full-precision numbers; how many they became."""
    rng = np.random.default_rng(seed)
    subjects = max(2, min(1000, rows // 50))
    trials = max(1, rows // (subjects * len(_REFERENCES)))
    with Path(path).open("w", encoding="utf-8", newline="") as out:
        out.write("subject,session,environment,k_ref,b_ref,trial,k_adj,b_adj\n")
        for subject in range(subjects):
            for environment, (k, b) in _REFERENCES.items():
                adjusted = np.exp(rng.normal(0, (0.1, 0.2), (trials, 2))) * (k, b)
                cell = f"{subject:04d},1,{environment},{k!r},{b!r}"
                out.writelines(
                    f"{cell},{t},{x!r},{y!r}\n" for t, (x, y) in enumerate(adjusted.tolist(), 1)
                )
    return subjects * trials * len(_REFERENCES)


def main(arguments: list[str] | None = None) -> None:
    """Print one JSON line per way."""
    parser = argparse.ArgumentParser(prog="tests.sessions.reader_cost", description=__doc__)
    parser.add_argument("--rows", type=int, default=5_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args(arguments)
    for cost in read_costs(given.rows, repeats=given.repeats):
        sys.stdout.write(json.dumps(dataclasses.asdict(cost)) + "\n")


if __name__ == "__main__":
    main()
