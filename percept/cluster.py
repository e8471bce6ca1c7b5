"""The workers of a running dask cluster, on any machine; needs the extra `cluster`."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING

from percept.cache import numbers_version
from percept.errors import RefusalError, UsageError
from percept.workers import Mapper, map_on

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["connected", "on_cluster", "require_same_code"]

# s until a scheduler that does not answer counts as none.
_PATIENCE = 20.0
# How often dask gives a job to another worker when it ends in an error, such as a full disk.
_RETRIES = 1
# Arguments per thread: one at work and one waiting. More would only fill memory.
_PER_THREAD = 2


@contextmanager
def connected(scheduler: str, patience: float = _PATIENCE) -> Iterator[Client]:
    """Connect to a scheduler.

    Parameters
    ----------
    scheduler : str
        Address, such as ``"tcp://127.0.0.1:8786"``.
    patience : float
        Time to wait for an answer, s.

    Yields
    ------
    distributed.Client

    Raises
    ------
    UsageError
        dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UsageError(
            "a scheduler needs dask.distributed, which is not installed.",
            hint="Install the extra, percept-haptics[cluster], or leave --scheduler out.",
        ) from None
    try:
        client = Client(scheduler, timeout=patience, set_as_default=False)
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


def on_cluster(client: Client) -> Mapper:
    """Take the workers of a dask cluster, whose code must be this process's own.

    dask gives what a lost worker was working on to another. It gives up an argument with which
    several workers died, even one that only waited there. `map_on` tells the culprit.

    Parameters
    ----------
    client : distributed.Client
        Connected to the cluster.

    Returns
    -------
    Mapper

    Raises
    ------
    RefusalError
        A worker has other code, or the scheduler is lost.
    """
    require_same_code(client)

    from distributed import KilledWorker

    def opened() -> AbstractContextManager[Executor]:
        return nullcontext(client.get_executor(pure=False, retries=_RETRIES))

    return map_on(opened, partial(_room, client), KilledWorker)


def require_same_code(client: Client, version: str | None = None) -> None:
    """Refuse workers, also those that come later, with other code or packages than this process.

    Parameters
    ----------
    client : distributed.Client
        Connected to the cluster.
    version : str, optional
        What they must have, this process's own by default.

    Raises
    ------
    RefusalError
        A worker has another one, or the scheduler is lost.
    """
    from distributed import WorkerPlugin

    # All of percept's code: a worker that differs in any of it is not asked whether the difference
    # counts.
    required = version or numbers_version(".")

    class SameCode(WorkerPlugin):  # type: ignore[misc]
        name = f"percept {required}"

        def setup(self, worker: object) -> None:
            if numbers_version(".") != required:
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


def _room(client: Client) -> int:
    """Return how many arguments the workers take; refuse a scheduler that was lost."""
    try:
        threads = sum(client.nthreads().values())
    except OSError as error:  # what dask calls a closed connection
        raise _scheduler_lost() from error
    return _PER_THREAD * max(1, threads)


def _scheduler_lost() -> RefusalError:
    return RefusalError(
        "the scheduler was lost.",
        hint="What is finished is kept; run the same command again for the rest.",
    )
