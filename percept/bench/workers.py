"""What a batch costs on one worker and on several, and what keeps several from being as many times as fast.

    percept bench workers --studies 200

Two rates multiply to the gain in wall time over one worker: how much less processor time a study takes when
no other is worked on beside it (cores share caches and memory), and how busy the workers are kept:
gain(n) = n · (worker_s(1) / worker_s(n)) · (busy(n) / busy(1)).
"""

from __future__ import annotations

import dataclasses
import pickle
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from percept.bench.small_studies import write_small_studies

if TYPE_CHECKING:
    from distributed import Client

    from percept.batch import StudySource

Done = TypeVar("Done")

# Of the published design, where each study takes some four seconds of a worker.
_PUBLISHED = 8
_IDLE_SECONDS = 4.0


@dataclasses.dataclass(frozen=True)
class BatchCost:
    """What a batch cost on workers that have their imports behind them."""

    design: str  # "small" (four subjects, two environments) or "published"
    workers: int
    studies: int
    wall_s: float  # From the first study read to the table written, s
    gain: float | None  # Wall time of the same batch on one worker over this one's
    busy: float  # Processor time of the workers over wall time times workers
    worker_s: float  # Processor time of the workers per study, s
    idle: float
    coordinator_ms: float  # Its processor time per study beyond that, ms
    read_ms: float
    write_ms: float
    combine_ms: float
    write_wait_ms: float  # Wall time to write the rows, the disk's part included, ms
    sent_bytes: float
    returned_bytes: float


def batch_costs(
    studies: int = 200,
    *,
    workers: Sequence[int] = (1, 2),
    published: int = _PUBLISHED,
    tolerance: float = 0.1,
) -> list[BatchCost]:
    """Run a batch of small studies on each number of workers, and one of the published design on the last."""
    from percept.batch import StudySource, sources
    from percept.batch.work import analyse
    from percept.reproduce.published import dataset
    from percept.scene import Scene
    from percept.workers import connected

    found: list[BatchCost] = []
    with tempfile.TemporaryDirectory(prefix="percept-workers-") as root:
        folder = Path(root)
        paths = write_small_studies(folder, studies, np.random.default_rng(1))
        small = sources(paths, changes={"tolerance": tolerance})
        # One file under many seeds: each is a study of its own.
        sessions = str(dataset("hbfd_sessions.csv"))
        large = [
            StudySource(sessions, Scene(), {"tolerance": 0.02, "seed": seed}) for seed in range(published)
        ]
        for count in workers:
            with connected(workers=count) as client:
                client.run(analyse, small[0].read())  # imports, on every worker
                found.append(_measured("small", small, folder / f"small-{count}", client))
                if published and count == workers[-1]:
                    found.append(_measured("published", large, folder / "published", client))
    alone = [one.wall_s for one in found if one.workers == 1 and one.design == "small"]
    return [
        dataclasses.replace(one, gain=alone[0] / one.wall_s) if alone and one.design == "small" else one
        for one in found
    ]


def _measured(design: str, studies: Sequence[StudySource], out: Path, client: Client) -> BatchCost:
    from percept.batch import run_batch
    from percept.workers import OnCluster

    mapper = OnCluster(client)
    workers = len(client.nthreads())
    at_work = sum(client.run(time.process_time).values())
    idle = _idle()
    here, started = time.process_time(), time.perf_counter()
    run_batch(studies, out, mapper)
    wall, here = time.perf_counter() - started, time.process_time() - here
    at_work = sum(client.run(time.process_time).values()) - at_work
    count = len(studies)
    return BatchCost(
        design=design,
        workers=workers,
        studies=count,
        wall_s=wall,
        gain=None,
        busy=at_work / (wall * workers),
        worker_s=at_work / count,
        idle=idle,
        coordinator_ms=1e3 * (here - idle * wall) / count,
        **_coordinator_steps(studies, out),
    )


def _idle() -> float:
    """Watch this process do nothing: its scheduler and connections have work of their own."""
    before = time.process_time()
    time.sleep(_IDLE_SECONDS)
    return (time.process_time() - before) / _IDLE_SECONDS


def _coordinator_steps(studies: Sequence[StudySource], out: Path) -> dict[str, float]:
    """Do once more, alone, what the process that hands out does itself; fields of `BatchCost` by name."""
    from percept.batch import BatchFolder
    from percept.batch.rows import Outcome

    count = len(studies)
    read, files = _timed(lambda: [study.read() for study in studies])
    hashed, keys = _timed(lambda: [one.key for one in files])
    outcomes = [
        Outcome("done", None, (out / "studies" / key[:2] / f"{key}.parquet").read_bytes(), 0.0)
        for key in keys
    ]
    with BatchFolder.opened(out / "again") as folder:
        started, waited = time.process_time(), time.perf_counter()
        for key, outcome in zip(keys, outcomes, strict=True):
            folder.save(key, outcome)
        written, waited = time.process_time() - started, time.perf_counter() - waited
        combined, _ = _timed(lambda: folder.combine(keys))
    return {
        "read_ms": 1e3 * (read + hashed) / count,
        "write_ms": 1e3 * written / count,
        "combine_ms": 1e3 * combined / count,
        "write_wait_ms": 1e3 * waited / count,
        "sent_bytes": float(np.mean([len(pickle.dumps(one)) for one in files])),
        "returned_bytes": float(np.mean([len(pickle.dumps(one)) for one in outcomes])),
    }


def _timed(work: Callable[[], Done]) -> tuple[float, Done]:
    started = time.process_time()
    done = work()
    return time.process_time() - started, done
