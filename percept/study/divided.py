"""Studies worked on by several processes for a while."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from percept.inference.share import Share
from percept.processes import Processes

if TYPE_CHECKING:
    from percept.study import Study

__all__ = ["divided", "for_sampling"]

#: Runs to such a tolerance are mostly over before another process has imported what it needs.
_SOON = 0.02
_SAMPLING = ("percept.inference.sampling.pieces", "percept.inference.hierarchy.estimands")


@contextmanager
def divided(*studies: Study, count: int | None = None, also: Sequence[str] = ()) -> Iterator[Processes]:
    """Have other processes share the work of studies.

    Parameters
    ----------
    *studies : Study
        Their `share` is the processes within the context, and what it was afterwards.
    count : int, optional
        Processes in all, as `Processes` takes it.
    also : sequence of str
        Modules that the others will need, beside those of the study's own work.

    Yields
    ------
    Processes
    """
    sampled = any(study.scene.inference.method != "classical" for study in studies)
    before = [study.share for study in studies]
    with Processes(count, preload=(*(_SAMPLING if sampled else ()), *also)) as beside:
        _lend(studies, [beside] * len(studies))
        try:
            yield beside
        finally:
            _lend(studies, before)


def for_sampling(*studies: Study, count: int | None = None) -> int | None:
    """Return the processes that pay where fits are all the work: one, where they are soon over.

    Parameters
    ----------
    *studies : Study
        Of which nothing is computed.
    count : int, optional
        Processes asked for.

    Returns
    -------
    int or None
        As `divided` takes it.
    """
    asked = [study.scene.inference for study in studies]
    return 1 if all(one.method == "classical" or one.tolerance >= _SOON for one in asked) else count


def _lend(studies: Sequence[Study], shares: Sequence[Share]) -> None:
    for study, share in zip(studies, shares, strict=True):
        study.share = share
