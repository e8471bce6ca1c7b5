"""Many arguments on one process or many: the same results, and a bad argument is never fatal."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Protocol, TypeVar

from percept.errors import RefusalError, UsageError

__all__ = ["Given", "Mapper", "Result", "cores", "in_process", "map_on", "processes"]

Given = TypeVar("Given")
Result = TypeVar("Result")

# A fresh interpreter everywhere: a fork would copy the threads' locks of numerical libraries.
_SPAWN = multiprocessing.get_context("spawn")
# Each worker has a core, and its matrices are a few tens wide: a second thread costs time.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


class Mapper(Protocol):
    """Whoever calls a function for many arguments."""

    def __call__(
        self, function: Callable[[Given], Result], arguments: Iterable[Given], /
    ) -> Iterator[tuple[Given, Result | Exception]]:
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
    function: Callable[[Given], Result], arguments: Iterable[Given], /
) -> Iterator[tuple[Given, Result | Exception]]:
    """Call a function in the process that asks, in order; see `Mapper`."""
    for argument in arguments:
        try:
            result: Result | Exception = function(argument)
        except Exception as error:  # noqa: BLE001 - it is this argument's, and the others go on
            result = error
        yield argument, result


def processes(workers: int | None = None) -> Mapper:
    """Return a mapper on processes of this machine, which end with each call.

    Parameters
    ----------
    workers : int, optional
        The most processes, one per core by default. One is the process that asks.

    Returns
    -------
    Mapper
        An argument with which a process died twice has a `BrokenExecutor` for result.

    Raises
    ------
    UsageError
        Fewer than one worker.
    RefusalError
        When it is called: a process ends before it can work.
    """
    count = cores() if workers is None else workers
    if count < 1:
        raise UsageError("must be at least 1.", key="--workers", value=count)
    if count == 1:
        return in_process
    return map_on(partial(_pool, count), lambda: count, BrokenExecutor)


def map_on(
    executor: Callable[[], AbstractContextManager[Executor]],
    room: Callable[[], int],
    death: type[Exception],
) -> Mapper:
    """Return a mapper on an executor of `concurrent.futures`.

    An executor gives up all arguments at work when a worker dies. They are tried again one by one,
    which tells the culprit.

    Parameters
    ----------
    executor : callable
        Opens the executor; called again after a death.
    room : callable
        How many arguments it takes at once.
    death : type of Exception
        What it says of arguments whose worker died.

    Returns
    -------
    Mapper
    """

    def call(
        function: Callable[[Given], Result], arguments: Iterable[Given], /
    ) -> Iterator[tuple[Given, Result | Exception]]:
        waiting = iter(arguments)
        while True:
            with executor() as opened:
                suspects = yield from _until_death(opened, function, waiting, room, death)
            if not suspects:
                return
            for suspect in suspects:
                with executor() as opened:
                    yield suspect, _outcome(_submitted(opened, function, suspect))

    return call


def _until_death(
    executor: Executor,
    function: Callable[[Given], Result],
    waiting: Iterator[Given],
    room: Callable[[], int],
    death: type[Exception],
) -> Generator[tuple[Given, Result | Exception], None, list[Given]]:
    """Hand out arguments until none is left or a worker died; return those it may have died of."""
    pending: dict[Future[Result], Given] = {}
    suspects: list[Given] = []
    while True:
        free = 0 if suspects else max(0, room() - len(pending))
        for argument in itertools.islice(waiting, free):
            pending[_submitted(executor, function, argument)] = argument
        if not pending:
            return suspects
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            argument = pending.pop(future)
            outcome = _outcome(future)
            if isinstance(outcome, death):
                suspects.append(argument)
            else:
                yield argument, outcome


def _submitted(
    executor: Executor, function: Callable[[Given], Result], argument: Given
) -> Future[Result]:
    """Hand out an argument; an executor that broke meanwhile says so in the future."""
    try:
        return executor.submit(function, argument)
    except BrokenExecutor as error:
        future: Future[Result] = Future()
        future.set_exception(error)
        return future


def _outcome(future: Future[Result]) -> Result | Exception:
    """Wait for a result or an error."""
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001 - it is this argument's, and the others go on
        return error


@contextmanager
def _pool(count: int) -> Iterator[Executor]:
    """Open processes, and end them whatever they do: a run that was interrupted waits for none."""
    theirs, ours = _SPAWN.Pipe(duplex=False)
    executor = ProcessPoolExecutor(
        count, mp_context=_SPAWN, initializer=_begin_worker, initargs=(theirs,)
    )
    try:
        try:
            executor.submit(os.getpid).result()
        except BrokenExecutor as error:
            raise RefusalError(
                "a worker process ended before it could work.",
                hint='A script that starts workers does so under `if __name__ == "__main__":`.',
            ) from error
        yield executor
    finally:
        ours.close()
        executor.shutdown(cancel_futures=True)
        theirs.close()


def _begin_worker(pipe: Connection) -> None:
    """Prepare a worker process."""
    # An interrupt goes to every process of a terminal; the one that asks ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(_ONE_THREAD)
    threading.Thread(target=_end_worker, args=(pipe,), daemon=True).start()


def _end_worker(pipe: Connection) -> None:
    """End this process when the one that asks closes the pipe or has ended, however that ended."""
    with suppress(EOFError, OSError):
        pipe.recv()
    os._exit(1)
