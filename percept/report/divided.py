"""A study worked on by several processes for as long as it is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from percept.processes import Processes

if TYPE_CHECKING:
    from percept.study import Study

__all__ = ["divided"]

_SAMPLING = ("percept.inference.sampling.pieces", "percept.inference.hierarchy.estimands")


@contextmanager
def divided(study: Study, count: int | None = None, *, also: Sequence[str] = ()) -> Iterator[Processes]:
    """Have other processes share a study's work.

    Parameters
    ----------
    study : Study
        Its `share` is theirs within the context, and what it was afterwards.
    count : int, optional
        Processes in all, as `Processes` takes it.
    also : sequence of str
        Modules that the others will need, beside those of the study's own work.

    Yields
    ------
    Processes
    """
    sampled = study.scene.inference.method != "classical"
    before = study.share
    with Processes(count, preload=(*(_SAMPLING if sampled else ()), *also)) as beside:
        study.share = beside
        try:
            yield beside
        finally:
            study.share = before
