"""What a batch of small studies costs on one worker and on several.

The gain in wall time over one worker is n · (worker_s(1) / worker_s(n)) · (busy(n) / busy(1)): how much less
processor time a study takes alone (cores share caches and memory), and how busy the workers are kept.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np


@dataclasses.dataclass(frozen=True)
class BatchCost:
    """What a batch cost on workers that have their imports behind them."""

    workers: Annotated[int, "Processes of one thread."]
    studies: Annotated[int, "Studies of four subjects and two environments."]
    wall_s: Annotated[float, "From the first study read to the table written, s."]
    gain: Annotated[float, "Wall time on the first number of workers over this one's."]
    busy: Annotated[float, "Processor time of the workers over wall time times workers."]
    worker_s: Annotated[float, "Processor time of the workers per study, s."]
    coordinator_ms: Annotated[
        float, "Processor time of the process that hands out per study, dask's scheduler included, ms."
    ]


def batch_costs(
    studies: int = 200, *, workers: Sequence[int] = (1, 2), tolerance: float = 0.1
) -> list[BatchCost]:
    """Run a batch of small studies on each number of workers."""
    from percept.batch import analyse, run_batch, sources
    from percept.workers import connected, on_cluster

    costs: list[BatchCost] = []
    with tempfile.TemporaryDirectory(prefix="percept-workers-") as root:
        paths = _write_studies(Path(root), studies, np.random.default_rng(1))
        batch = sources(paths, changes={"tolerance": tolerance})
        for count in workers:
            with connected(workers=count) as client:
                client.run(analyse, batch[0].read())  # imports, on every worker
                before = sum(client.run(time.process_time).values())
                here, started = time.process_time(), time.perf_counter()
                run_batch(batch, Path(root) / f"out-{count}", on_cluster(client))
                wall, here = time.perf_counter() - started, time.process_time() - here
                worked = sum(client.run(time.process_time).values()) - before
            gain = costs[0].wall_s / wall if costs else 1.0
            busy = worked / (wall * count)
            costs.append(BatchCost(count, studies, wall, gain, busy, worked / studies, 1e3 * here / studies))
    return costs


def _write_studies(folder: Path, count: int, rng: np.random.Generator) -> list[str]:
    paths = [folder / f"study-{number}.csv" for number in range(count)]
    for path in paths:
        lines = ["subject,environment,k_ref,b_ref,k_adj,b_adj\n"]
        for subject in range(4):
            shared = rng.normal(0.0, 0.1, 2)
            for j, (k, b) in enumerate(((1e3, 5.0), (1e4, 20.0))):
                k_adj, b_adj = np.array([k, b]) * np.exp(shared + rng.normal(0.0, 0.1, 2))
                lines.append(f"S{subject},VE{j},{k},{b},{k_adj:.6g},{b_adj:.6g}\n")
        path.write_text("".join(lines), encoding="utf-8")
    return [str(path) for path in paths]
