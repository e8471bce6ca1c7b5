"""What is worked on, what comes back, and the mapper that does it in this process."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, Protocol, TypeVar

Given = TypeVar("Given")
Found = TypeVar("Found")


@dataclasses.dataclass(frozen=True)
class Job(Generic[Given]):
    """One call of the function.

    Attributes
    ----------
    key : str
        Name of the job. On a cluster equal keys mean the same job, so it stands for function and argument.
    argument : object
        What the function is called with.
    """

    key: str
    argument: Given


@dataclasses.dataclass(frozen=True)
class Answer(Generic[Given, Found]):
    """What became of one job.

    Attributes
    ----------
    job : Job
        The job.
    result : object
        What the function returned, or the Exception it or its worker ended with.
    """

    job: Job[Given]
    result: Found | Exception


class Mapper(Protocol):
    """Whoever calls a function for many arguments."""

    def map(
        self, function: Callable[[Given], Found], jobs: Iterable[Job[Given]]
    ) -> Iterator[Answer[Given, Found]]:
        """Call a function once per job and give the answers as they come, in any order.

        Parameters
        ----------
        function : callable
            Its result depends on its argument alone; it and what it takes and returns can be pickled.
        jobs : iterable of Job
            Taken one by one, shortly before they are worked on, so that it may be long and may end early.

        Yields
        ------
        Answer
        """
        ...


class InProcess:
    """One worker: the process that asks."""

    def map(
        self, function: Callable[[Given], Found], jobs: Iterable[Job[Given]]
    ) -> Iterator[Answer[Given, Found]]:
        """Call a function once per job, in order; see `Mapper.map`."""
        for job in jobs:
            try:
                result: Found | Exception = function(job.argument)
            except Exception as error:  # noqa: BLE001 - it is this job's, and the others go on
                result = error
            yield Answer(job, result)
