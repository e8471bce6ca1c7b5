"""Studies of a plan by their numbers, on whatever workers there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from percept.errors import RefusalError
from percept.workers import Job, Mapper

__all__ = ["computed"]

Found = TypeVar("Found")


def computed(
    function: Callable[[int], Found], wanted: Iterable[int], mapper: Mapper, *, name: str
) -> Iterator[tuple[int, Found]]:
    """Call a function for the numbers of studies and give what it finds as it comes.

    Parameters
    ----------
    function : callable
        From the number of a study; can be pickled.
    wanted : iterable of int
        Numbers, taken as workers become free.
    mapper : Mapper
        The workers.
    name : str
        Of function and plan together, for the jobs' keys.

    Yields
    ------
    tuple of int, object
        The number and what was found.

    Raises
    ------
    RefusalError
        After all others, where a study ended in an error: figures over the rest would leave out what may be
        the hardest studies.
    """
    errors: dict[int, Exception] = {}
    for answer in mapper.map(function, (Job(f"{name}-{index}", index) for index in wanted)):
        index, found = answer.job.argument, answer.result
        if isinstance(found, Exception):
            errors[index] = found
        else:
            yield index, found
    if errors:
        first = min(errors)
        raise RefusalError(
            f"{len(errors)} studies ended in an error; study {first}: "
            f"{type(errors[first]).__name__}: {errors[first]}",
            hint="The others are kept where there is a checkpoint: the same run again tries these only.",
        ) from errors[first]
