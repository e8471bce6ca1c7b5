"""Many arguments on one process or many: the same results, and a bad argument is never fatal.

The worker processes need nothing but the standard library. Its `concurrent.futures` gives up all
workers when one dies. Here each process has a pipe of its own, so that a death concerns only the
argument it worked on.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import pickle
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Protocol, TypeVar

from percept.errors import RefusalError, UsageError

__all__ = ["Given", "Mapper", "Result", "cores", "in_process", "processes"]

Given = TypeVar("Given")
Result = TypeVar("Result")

# A fresh interpreter everywhere: a fork would copy the threads' locks of numerical libraries.
_SPAWN = multiprocessing.get_context("spawn")
# Each worker has a core, and its matrices are a few tens wide: a second thread costs time.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
# What a process sends first. No pickle is empty.
_READY = b""
# How many processes may die with an argument: the first may have been killed for another's memory.
_MOST_DEATHS = 2


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


@contextmanager
def processes(workers: int | None = None) -> Iterator[Mapper]:
    """Give a mapper on processes of this machine, and end them.

    Parameters
    ----------
    workers : int, optional
        The most processes, one per core by default. One is the process that asks. Others are
        started when there is work for them, and kept for the next call.

    Yields
    ------
    Mapper
        An argument with which two processes died has a `RuntimeError` that says so for result.

    Raises
    ------
    UsageError
        Fewer than one worker.
    RefusalError
        A process ends before it can work.
    """
    count = cores() if workers is None else workers
    if count < 1:
        raise UsageError("must be at least 1.", key="--workers", value=count)
    if count == 1:
        yield in_process
        return
    pool = _Pool(count)
    try:
        yield pool.call
    finally:
        pool.end()


@dataclass(eq=False)
class _Job(Generic[Given]):
    """An argument that is worked on."""

    argument: Given
    message: bytes  # The function and the argument, as a worker takes them
    deaths: int = 0  # Of processes that had it


class _Worker:
    """A process that works on one argument at a time."""

    def __init__(self) -> None:
        self.pipe, other_end = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(other_end,), daemon=True)
        self.is_ready = False
        with _environment(_ONE_THREAD):
            self.process.start()
        # With no other copy of it open, a process that dies closes the pipe.
        other_end.close()

    def end(self) -> int | None:
        """End the process, whatever it does, and return its exit code."""
        self.process.kill()
        self.process.join()
        exit_code = self.process.exitcode
        self.process.close()
        self.pipe.close()
        return exit_code


class _Pool:
    """Workers, of which some are busy."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.idle: list[_Worker] = []
        self.busy: dict[object, tuple[_Worker, _Job[Any]]] = {}  # By the worker's pipe

    def call(
        self, function: Callable[[Given], Result], arguments: Iterable[Given], /
    ) -> Iterator[tuple[Given, Result | Exception]]:
        """Call a function once per argument; see `Mapper`."""
        waiting = iter(arguments)
        try:
            while True:
                for argument in itertools.islice(waiting, self.count - len(self.busy)):
                    try:
                        message = pickle.dumps((function, argument))
                    except Exception as error:  # noqa: BLE001 - any object may refuse to be sent
                        yield argument, error
                    else:
                        self._hand_out(_Job(argument, message))
                if not self.busy:
                    return
                for pipe in wait([worker.pipe for worker, _ in self.busy.values()]):
                    yield from self._received(pipe)
        finally:
            # Whoever asked may stop before the end: the next call gets no answer of this one.
            self._end_busy()

    def end(self) -> None:
        """End all workers."""
        self._end_busy()
        while self.idle:
            self.idle.pop().end()

    def _end_busy(self) -> None:
        while self.busy:
            _, (worker, _) = self.busy.popitem()
            worker.end()

    def _hand_out(self, job: _Job[Any]) -> None:
        """Give a job to an idle worker, or to a new one."""
        worker = self.idle.pop() if self.idle else _Worker()
        self.busy[worker.pipe] = worker, job
        # A worker that has died is seen when its answer is awaited.
        with suppress(OSError):
            worker.pipe.send_bytes(job.message)

    def _received(self, pipe: object) -> Iterator[tuple[Any, Any]]:
        """Take what a worker sent: its answer, that it is ready, or by its silence that it died."""
        worker, job = self.busy[pipe]
        try:
            message = worker.pipe.recv_bytes()
        except (EOFError, OSError):
            del self.busy[pipe]
            yield from self._after_death(worker, job)
            return
        if message == _READY:
            worker.is_ready = True
            return
        del self.busy[pipe]
        self.idle.append(worker)
        try:
            result = pickle.loads(message)  # noqa: S301 - from a process of our own
        except Exception as error:  # noqa: BLE001 - an object may raise anything when it is copied
            result = error
        yield job.argument, result

    def _after_death(self, worker: _Worker, job: _Job[Any]) -> Iterator[tuple[Any, Any]]:
        """Let another worker try the job once more, or give it up."""
        exit_code = worker.end()
        if not worker.is_ready:
            raise RefusalError(
                f"a worker process ended before it could work (exit code {exit_code}).",
                hint='A script that starts workers does so under `if __name__ == "__main__":`.',
            )
        job.deaths += 1
        if job.deaths < _MOST_DEATHS:
            self._hand_out(job)
            return
        message = f"{job.deaths} worker processes died over it (exit code {exit_code})"
        if exit_code == -signal.SIGKILL:
            message += "; the machine may lack memory"
        yield job.argument, RuntimeError(message)


def _serve(pipe: Connection) -> None:
    """Answer what comes through the pipe until it is closed: the life of a worker process."""
    # An interrupt goes to every process of a terminal; the one that asks ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The pipe is closed when the process that asks has ended, however that ended.
    with suppress(EOFError, OSError):
        pipe.send_bytes(_READY)
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _answer(message: bytes) -> bytes:
    """Call the function of a message; return its pickled result or error."""
    try:
        function, argument = pickle.loads(message)  # noqa: S301 - from the process that asks
        result = function(argument)
    except Exception as error:  # noqa: BLE001 - it is this argument's, and the others go on
        error.add_note("".join(traceback.format_exception(error)))
        result = error
    try:
        return pickle.dumps(result)
    except Exception as error:  # noqa: BLE001 - any object may refuse to be sent
        reason = f"a result of {type(result).__name__} cannot be sent to another process: {error}"
        return pickle.dumps(RuntimeError(reason))


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for a while: a process takes over those at its start."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
