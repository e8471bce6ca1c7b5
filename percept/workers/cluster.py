"""The way to workers: this process, a cluster of this machine, or a scheduler somewhere."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from percept.cores import cores
from percept.errors import UsageError
from percept.workers.jobs import InProcess, Mapper
from percept.workers.on_cluster import OnCluster

if TYPE_CHECKING:
    from distributed import Client

_SECONDS = 20.0
# What dask keeps for its dashboard grows for an hour: some 0.4 MB per second and worker of sampled call
# stacks, and some MB of measurements.
_FEW_RECORDS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.log-length": 60,
}


@contextmanager
def open_mapper(workers: int | None = None, scheduler: str | None = None) -> Iterator[Mapper]:
    """Open the way to workers that is asked for: one is this process itself, more are a dask cluster.

    Parameters
    ----------
    workers : int, optional
        Processes on this machine, one per core by default.
    scheduler : str, optional
        Address of a running scheduler, in place of workers here.

    Yields
    ------
    Mapper

    Raises
    ------
    UsageError
        As `connected`.
    """
    if scheduler is None and (cores() if workers is None else workers) == 1:
        yield InProcess()
    else:
        with connected(workers, scheduler) as client:
            yield OnCluster(client)


@contextmanager
def connected(workers: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """Connect to a scheduler, or start one with workers of its own and end them afterwards.

    Every worker here has one thread, and its BLAS one: the matrices are a few tens wide. Their memory stays
    level: dask's profiler is off. For workers elsewhere that is their environment's affair
    (``DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False``).

    Parameters
    ----------
    workers : int, optional
        Processes on this machine, one per core by default.
    scheduler : str, optional
        Address of a running scheduler, such as "tcp://10.0.0.5:8786", in place of workers here.

    Yields
    ------
    distributed.Client

    Raises
    ------
    UsageError
        A number of workers below one, both given, no scheduler answering, or distributed not installed.
    """
    if workers is not None and scheduler is not None:
        raise UsageError("a scheduler has workers of its own.", hint="Give --workers or --scheduler.")
    if workers is not None and workers < 1:
        raise UsageError("must be at least 1.", key="--workers", value=workers)
    try:
        from dask import config
        from distributed import Client, LocalCluster
    except ImportError:
        raise UsageError(
            "more than one worker needs dask.distributed, which is not installed.",
            hint="Install percept with its extra, percept[cluster], or give --workers 1.",
        ) from None
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"no scheduler answers ({error}).",
                value=scheduler,
                hint="Start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`.",
            ) from error
        with client:
            yield client
        return
    with (
        config.set(_FEW_RECORDS),
        LocalCluster(
            n_workers=workers or cores(),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client
