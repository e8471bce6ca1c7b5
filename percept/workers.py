"""Many arguments on one process or many, here or on a dask cluster: a bad one is never fatal."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from percept.cache import numbers_version
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from distributed import Client

Given = TypeVar("Given")
Result = TypeVar("Result")

# Each worker has a core, and its matrices are a few tens wide: a second thread costs time.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
# s until a scheduler that does not answer counts as none.
_PATIENCE = 20.0
# How often dask gives a job to another worker when it ends in an error, such as a full disk.
_RETRIES = 1
# Arguments per thread: one at work and one waiting. More would only fill memory.
_PER_THREAD = 2


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
        yield argument, _outcome(partial(function, argument))


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
    return _map_on(partial(_pool, count), lambda: count, BrokenExecutor)


def _map_on(
    executor: Callable[[], AbstractContextManager[Executor]],
    room: Callable[[], int],
    death: type[Exception],
) -> Mapper:
    """Return a mapper on executors of `concurrent.futures` that take so many arguments at once.

    An executor gives up all arguments at work when a worker dies, and says `death` of them. They
    are tried again one by one on executors of their own, which tells the culprit.
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
                    yield suspect, _outcome(_submitted(opened, function, suspect).result)

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
            outcome = _outcome(future.result)
            if isinstance(outcome, death):
                suspects.append(argument)
            else:
                yield argument, outcome


def _submitted(
    executor: Executor, function: Callable[..., Result], *arguments: object
) -> Future[Result]:
    """Hand out arguments; an executor that broke, or cannot start, says so in the future."""
    try:
        return executor.submit(function, *arguments)
    except (BrokenExecutor, OSError) as error:
        future: Future[Result] = Future()
        future.set_exception(error)
        return future


def _outcome(work: Callable[[], Result]) -> Result | Exception:
    """Give a result or an error."""
    try:
        return work()
    except Exception as error:  # noqa: BLE001 - it is this argument's, and the others go on
        return error


@contextmanager
def beside(
    prepare: Callable[[], Callable[..., Result]],
) -> Iterator[Callable[..., Callable[[], Result]]]:
    """Work in a copy of this process while the caller goes on.

    The copy sees all that this process has computed. Of locks that other threads hold it would wait
    for ever: it may compute and write files of its own, and not print.

    Parameters
    ----------
    prepare : callable
        Called in the copy at once, it returns what does the work. The arguments and the result of
        that must be such as can be pickled.

    Yields
    ------
    callable
        Takes the arguments, lets the work begin, and returns a function that waits for the result.
        That does the work itself where no copy can start, on one core, and where the copy ended
        without a result.
    """
    if cores() == 1 or "fork" not in multiprocessing.get_all_start_methods():
        yield lambda *given: partial(prepare(), *given)
        return
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    copy = context.Process(target=_serve, args=(prepare, theirs, ours), daemon=True)
    with warnings.catch_warnings():
        # Python warns of a fork beside other threads: ours only show progress.
        warnings.simplefilter("ignore", DeprecationWarning)
        copy.start()
    # With our end of it open we would wait for ever for a copy that died.
    theirs.close()

    def begin(*given: Any) -> Callable[[], Result]:
        with suppress(OSError):
            ours.send(given)

        def result() -> Result:
            try:
                found: Result = ours.recv()
            except (EOFError, OSError):
                # The work itself says what is wrong.
                return prepare()(*given)
            return found

        return result

    try:
        yield begin
    finally:
        copy.kill()
        copy.join()
        ours.close()


def _serve(prepare: Callable[[], Callable[..., Any]], pipe: Connection, other: Connection) -> None:
    """Work in a copy of the process, which has the other end too; one that fails sends nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Open, the copy would wait for ever for a process that died.
    other.close()
    with suppress(Exception):
        work = prepare()
        pipe.send(work(*pipe.recv()))


@contextmanager
def _pool(count: int) -> Iterator[Executor]:
    """Open fresh processes, and end them whatever they do: an interrupted run waits for none."""
    # A fork would copy locks that a thread may hold.
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    executor = ProcessPoolExecutor(
        count, mp_context=context, initializer=_begin_worker, initargs=(theirs,)
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
    several workers died, even one that only waited there. `_map_on` tells the culprit.

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

    return _map_on(opened, partial(_room, client), KilledWorker)


def require_same_code(client: Client) -> None:
    """Refuse workers, also those that come later, with other code or packages than this process.

    Parameters
    ----------
    client : distributed.Client
        Connected to the cluster.

    Raises
    ------
    RefusalError
        A worker has another one, or the scheduler is lost.
    """
    from distributed import WorkerPlugin

    # All of percept's code: a worker that differs in any of it is not asked whether the difference
    # counts.
    required = numbers_version(".")

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
