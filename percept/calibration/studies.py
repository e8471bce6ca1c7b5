"""Studies of a plan by their numbers, on whatever workers there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from percept.errors import RefusalError
from percept.workers import Job, Mapper

Found = TypeVar("Found")


def computed(
    function: Callable[[int], Found], wanted: Iterable[int], mapper: Mapper, *, name: str
) -> Iterator[tuple[int, Found]]:
    """Call a function for the numbers of studies and give what it finds as it comes."""
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
