"""Many arguments on one process or many: the same results whoever works on them, a bad one never fatal."""

from __future__ import annotations

import asyncio
import concurrent.futures
import itertools
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol, TypeVar

from percept.cache import numbers_version
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from distributed import Client, Future

Given = TypeVar("Given")
Found = TypeVar("Found")

_SECONDS = 20.0
# How often dask gives a job to another worker when it ends in an error, such as a full disk.
_RETRIES = 1
# What dask keeps for its dashboard grows for an hour. Sampled call stacks take some 0.4 MB per
# second and worker, measurements some MB.
_FEW_RECORDS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.log-length": 60,
}


class Mapper(Protocol):
    """Whoever calls a function for many arguments."""

    def __call__(
        self, function: Callable[[Given], Found], arguments: Iterable[Given], /
    ) -> Iterator[tuple[Given, Found | Exception]]:
        """Call a function once per argument and give each with its result or error, in any order.

        Arguments are taken one by one, shortly before they are worked on: there may be many, and
        they may end early.
        """
        ...


def cores() -> int:
    """Return how many cores this process may use: all of the machine, or those it is bound to."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_process(
    function: Callable[[Given], Found], arguments: Iterable[Given], /
) -> Iterator[tuple[Given, Found | Exception]]:
    """Call a function in the process that asks, in order; see `Mapper`."""
    for argument in arguments:
        try:
            result: Found | Exception = function(argument)
        except Exception as error:  # noqa: BLE001 - it is this argument's, and the others go on
            result = error
        yield argument, result


@contextmanager
def open_mapper(workers: int | None = None, scheduler: str | None = None) -> Iterator[Mapper]:
    """Open the way to workers that is asked for: one is this process itself, more are a dask cluster."""
    if scheduler is None and (cores() if workers is None else workers) == 1:
        yield in_process
    else:
        with connected(workers, scheduler) as client:
            yield on_cluster(client)


@contextmanager
def connected(workers: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """Connect to a scheduler, or start one with workers of its own and end them afterwards.

    Every worker here has one thread, and its BLAS one: the matrices are a few tens wide. Their
    memory stays level: dask's profiler is off. For workers elsewhere that is their environment's
    affair (``DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False``).
    """
    if workers is not None and scheduler is not None:
        raise UsageError(
            "a scheduler has workers of its own.", hint="Give --workers or --scheduler."
        )
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
                hint=(
                    "Start one with `dask scheduler`, and workers with `dask worker ADDRESS"
                    " --nthreads 1`."
                ),
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


def on_cluster(client: Client) -> Mapper:
    """Take the workers of a dask cluster, whose code must be this process's own.

    dask gives what a lost worker was working on to another. It gives up an argument with which
    several workers died, even one that only waited there. These come last and one by one, which
    tells the culprit.
    """
    require_same_code(client)

    def call(
        function: Callable[[Given], Found], arguments: Iterable[Given], /
    ) -> Iterator[tuple[Given, Found | Exception]]:
        from distributed import KilledWorker

        suspects = []
        for argument, result in _handed_out(client, function, arguments):
            if isinstance(result, KilledWorker):
                suspects.append(argument)
            else:
                yield argument, result
        for argument in suspects:
            yield from _handed_out(client, function, [argument])

    return call


def require_same_code(client: Client, version: str | None = None) -> None:
    """Refuse workers, also those that come later, with other code or packages than this process."""
    from distributed import WorkerPlugin

    # All of percept's code: a worker that differs in any of it is not asked whether the difference
    # counts.
    ours = version or numbers_version(".")

    class SameCode(WorkerPlugin):  # type: ignore[misc]
        name = f"percept {ours}"

        def setup(self, worker: object) -> None:
            if numbers_version(".") != ours:
                raise RuntimeError("it has another version of percept or of its dependencies.")

    try:
        client.register_plugin(SameCode())
    except OSError as error:
        raise _scheduler_lost() from error
    except Exception as error:
        raise RefusalError(
            f"a worker cannot be used: {error}",
            hint="Give it and this process the same code and packages.",
        ) from error


def _handed_out(
    client: Client, function: Callable[[Given], Found], arguments: Iterable[Given]
) -> Iterator[tuple[Given, Found | Exception]]:
    """Hand out two arguments per thread, one at work and one waiting: more would only fill memory."""
    from distributed import as_completed

    waiting, done = iter(arguments), as_completed(loop=client.loop)
    out: dict[Future, Given] = {}
    while True:
        try:
            most = 2 * max(1, sum(client.nthreads().values()))
        except OSError as error:  # what dask calls a closed connection
            raise _scheduler_lost() from error
        for argument in itertools.islice(waiting, max(0, most - len(out))):
            future = client.submit(function, argument, pure=False, retries=_RETRIES)
            out[future] = argument
            done.add(future)
        if not out:
            return
        future = next(done)
        argument = out.pop(future)
        try:
            result: Found | Exception = future.result()
        except (asyncio.CancelledError, concurrent.futures.CancelledError):
            if client.status != "running":
                raise _scheduler_lost() from None
            result = RuntimeError("its result was lost with the worker that held it")
        except Exception as error:  # noqa: BLE001 - the argument's own, or workers died over it
            result = error
        yield argument, result


def _scheduler_lost() -> RefusalError:
    return RefusalError(
        "the scheduler was lost.",
        hint="What is finished is kept; run the same command again for the rest.",
    )
