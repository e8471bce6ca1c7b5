"""Processor time of work done several times over."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

__all__ = ["timed"]

T = TypeVar("T")


def timed(work: Callable[[], T], repeats: int) -> tuple[T, list[float]]:
    """Do work and time it.

    Parameters
    ----------
    work : callable
        Without arguments, the same every time.
    repeats : int
        How often, at least once.

    Returns
    -------
    found : object
        What it came to the last time.
    seconds : list of float
        Processor time of this process, each time, s.
    """
    seconds = []
    for _ in range(repeats):
        started = time.process_time()
        found = work()
        seconds.append(time.process_time() - started)
    return found, seconds
