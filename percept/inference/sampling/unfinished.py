"""A run that can be stopped at any moment, stored, and taken up again to the same digits."""

from __future__ import annotations

import dataclasses
import time
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.parts import Closed
from percept.inference.sampling.transport import Transport
from percept.inference.sampling.transported import Affine

__all__ = ["Ensembles", "Keeper", "Saver", "Unfinished"]

Array = NDArray[np.float64]
_SECONDS = 2.0  # between two savings: less would be lost than saving costs


@dataclasses.dataclass(frozen=True, eq=False)
class Ensembles:
    """Everything E ensembles of W walkers need to go on.

    Attributes
    ----------
    coords : ndarray, shape (E, W, d)
        Walkers.
    log_density : ndarray, shape (E, W)
        Their log densities.
    schedule : tuple
        State of the generator that chooses the kind of step (legacy Mersenne Twister tuple).
    generators : tuple of dict
        State of each ensemble's own generator.
    accepted : ndarray of int, shape (E, W)
        Accepted steps per walker so far.
    steps : int
        Steps taken so far.
    """

    coords: Array
    log_density: Array
    schedule: tuple[Any, ...]
    generators: tuple[dict[str, Any], ...]
    accepted: NDArray[np.int64]
    steps: int


@dataclasses.dataclass(frozen=True, eq=False)
class Unfinished:
    """Everything a run needs to go on; no object of the sampler's library among it.

    Attributes
    ----------
    transport : Affine or Transport
        The map, frozen since the warm-up or since it was refined.
    state : Ensembles
        Where the walkers stand.
    points : ndarray, shape (E, T, W, d)
        Kept coordinates of the target, of the part at work.
    components : ndarray, shape (E, T, W, C)
        What the estimands keep per draw.
    stride : int
        Steps between kept positions.
    goal : int
        Steps the kept positions must span before they are judged.
    refined : bool
        Whether the first round became part of the warm-up.
    closed : Closed or None
        What is left of the parts before.
    """

    transport: Affine | Transport
    state: Ensembles
    points: Array
    components: Array
    stride: int
    goal: int
    refined: bool
    closed: Closed | None


class Keeper(Protocol):
    """Keeps an unfinished run where the next attempt finds it."""

    def load(self) -> Unfinished | None:
        """Return what was kept; None where there is nothing."""

    def save(self, unfinished: Unfinished) -> None:
        """Keep it in place of what was kept before."""


class Saver:
    """Hands an unfinished run to a keeper now and then, and when the run is interrupted.

    Parameters
    ----------
    keeper : Keeper or None
        None keeps nothing.
    """

    def __init__(self, keeper: Keeper | None) -> None:
        self._keeper = keeper
        self._latest: Unfinished | None = None
        self._saved = time.monotonic()

    def __enter__(self) -> Saver:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        if kind is KeyboardInterrupt:
            self._save()

    def offer(self, unfinished: Unfinished) -> None:
        """Note a state the run could go on from."""
        self._latest = unfinished
        if time.monotonic() - self._saved >= _SECONDS:
            self._save()

    def _save(self) -> None:
        if self._keeper is not None and self._latest is not None:
            self._keeper.save(self._latest)
        self._saved = time.monotonic()
