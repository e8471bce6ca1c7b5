"""One process for one engine: a first run from the start of the process, then runs of every budget.

``python -m percept.bench.peers.child TASK.json`` prints JSON; `percept.bench.peers.measure` writes the task.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

from percept.bench.peers.engines import Fitted, engine
from percept.bench.peers.responses import Responses


def main(task_file: str) -> None:
    """Run an engine and print what it gave."""
    task = json.loads(Path(task_file).read_text(encoding="utf-8"))
    warnings.simplefilter("ignore")  # samplers warn about runs as short as some of these are meant to be
    sampler = engine(task["engine"]).prepare(Responses.load(task["study"]), task["source"])
    seed = task["seed"]
    runs: list[dict[str, Any]] = []
    sampler(task["budgets"][0][0], seed)
    first, first_processor = time.time() - task["started"], _processor()
    for size, repeats in task["budgets"]:
        for _ in range(repeats):
            if runs and time.time() - task["started"] > task["seconds"]:
                break
            seed += 1
            before = _processor()
            found = sampler(size, seed)
            runs.append({"size": size, "processor": _processor() - before} | _plain(found))
    json.dump({"first": first, "first_processor": first_processor, "runs": runs}, sys.stdout)


def _processor() -> float:
    """Processor seconds of this process, of those it has waited for, and of its children that still run."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system + _of_running_children()


def _of_running_children() -> float:
    """Processor seconds of running children, 0 on systems that do not list them."""
    ticks = 0
    for listed in Path("/proc/self/task").glob("*/children"):
        for pid in listed.read_text().split():
            with suppress(FileNotFoundError, ProcessLookupError):
                # User and system time, the 14th and 15th fields; the second may hold spaces.
                fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK") if ticks else 0.0


def _plain(run: Fitted) -> dict[str, Any]:
    limits = {
        how: {"value": found.value.tolist(), "error": found.error.tolist(), "effective": found.effective}
        for how, found in run.limits.items()
    }
    return {"seconds": run.seconds, "notes": run.notes, "limits": limits}


if __name__ == "__main__":
    main(sys.argv[1])
