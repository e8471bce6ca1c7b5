"""Jobs on a dask cluster: a few ahead of the workers, handed out again when a worker dies with its result."""

from __future__ import annotations

import asyncio
import concurrent.futures
import dataclasses
import enum
import hashlib
import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Generic, TypeVar

from percept.cache import numbers_version
from percept.errors import RefusalError
from percept.workers.jobs import Answer, Job

if TYPE_CHECKING:
    from distributed import Client, Future

Given = TypeVar("Given")
Found = TypeVar("Found")

# Jobs handed out per worker thread: one at work, one waiting there. More would only fill memory.
_AHEAD = 2
# Seconds between counts of the threads: each asks the scheduler, a quarter of what a job costs here.
_COUNTED = 1.0
# How often a result may be lost with the worker that held it before the job counts as failed.
_LOSSES = 3
# All of percept's code: a worker that differs in any of it is not asked whether the difference counts.
_EVERYTHING = "."


class _Lost(enum.Enum):
    """What is left of a result whose worker died with it."""

    RESULT = enum.auto()


@dataclasses.dataclass(frozen=True)
class _Attempt(Generic[Given]):
    job: Job[Given]
    number: int = 1

    def again(self) -> _Attempt[Given]:
        return dataclasses.replace(self, number=self.number + 1)


class OnCluster:
    """The workers of a dask cluster, whose code must be this process's own.

    A worker that dies costs no answer: dask gives what it was working on to another, and what it had
    finished and not yet handed back is asked for again. dask gives up a job with which several workers died,
    also one that only waited there; such jobs are done last and one by one, which tells who it was.

    Parameters
    ----------
    client : distributed.Client
        Connected; see `percept.workers.connected`.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._version = numbers_version(_EVERYTHING)
        self._counted, self._count = -math.inf, 1

    def map(
        self, function: Callable[[Given], Found], jobs: Iterable[Job[Given]]
    ) -> Iterator[Answer[Given, Found]]:
        """Call a function once per job, two jobs per worker thread at a time; see `Mapper.map`.

        Raises
        ------
        RefusalError
            Where the scheduler was lost.
        """
        from distributed import KilledWorker

        suspects = []
        for tried, result in self._tried(function, map(_Attempt, jobs)):
            if isinstance(result, KilledWorker):
                suspects.append(tried.again())
            else:
                yield Answer(tried.job, result)
        for suspect in suspects:
            for tried, result in self._tried(function, [suspect]):
                yield Answer(tried.job, result)

    def _tried(
        self, function: Callable[[Given], Found], attempts: Iterable[_Attempt[Given]]
    ) -> Iterator[tuple[_Attempt[Given], Found | Exception]]:
        """Hand out jobs as threads become free and give what they came to."""
        from distributed import as_completed

        waiting = iter(attempts)
        out: dict[Future, _Attempt[Given]] = {}
        done = as_completed(loop=self._client.loop)

        def hand_out(attempt: _Attempt[Given]) -> None:
            future = self._submit(function, attempt)
            out[future] = attempt
            done.add(future)

        while True:
            while len(out) < _AHEAD * self._threads() and (attempt := next(waiting, None)):
                hand_out(attempt)
            if not out:
                return
            future = next(done)
            attempt = out.pop(future)
            result = self._result(future)
            if not isinstance(result, _Lost):
                yield attempt, result
            elif attempt.number < _LOSSES:
                hand_out(attempt.again())
            else:
                message = f"its result was lost {_LOSSES} times with the worker that held it"
                yield attempt, RuntimeError(message)

    def _threads(self) -> int:
        """Count the workers' threads; one where none is there yet, so that a job waits for it."""
        now = time.monotonic()
        if now > self._counted + _COUNTED:
            try:
                self._count = max(1, sum(self._client.nthreads().values()))
            except OSError as error:  # what dask calls a closed connection
                raise _lost() from error
            self._counted = now
        return self._count

    def _submit(self, function: Callable[[Given], Found], attempt: _Attempt[Given]) -> Future:
        # Other code under the same key would be another job.
        code = hashlib.sha256(self._version.encode()).hexdigest()[:16]
        return self._client.submit(
            call_checked,
            self._version,
            function,
            attempt.job.argument,
            key=f"percept-{attempt.job.key}-{code}-{attempt.number}",
            pure=False,
        )

    def _result(self, future: Future) -> Found | Exception | _Lost:
        try:
            return future.result()
        except (asyncio.CancelledError, concurrent.futures.CancelledError):
            if self._client.status != "running":
                raise _lost() from None
            return _Lost.RESULT
        except Exception as error:  # noqa: BLE001 - the job's own, or workers died over it as often as dask tries
            return error


def call_checked(version: str, function: Callable[[Given], Found], argument: Given) -> Found:
    """Call a function on a worker, if its code is that of the process that asks."""
    if version != numbers_version(_EVERYTHING):
        raise RuntimeError(
            "this worker has another version of percept or of its dependencies than the process that asks; "
            "give both the same."
        )
    return function(argument)


def _lost() -> RefusalError:
    return RefusalError(
        "the scheduler was lost.", hint="What is finished is kept; run the same command again for the rest."
    )
