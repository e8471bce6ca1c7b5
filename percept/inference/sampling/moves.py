"""emcee moves that use a fitted law.

emcee's snooker move is not among them: up to release 3.1.6 it does not sample the density it is
given, and intervals come out too narrow with clean diagnostics.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.proposal import Proposal

__all__ = ["moves"]

Array = NDArray[np.float64]
_SHARES = {"independent": 0.4, "elliptic": 0.4, "differential": 0.2}


def moves(law: Proposal) -> list[tuple[Any, float]]:
    """Return moves and their shares, for `emcee.EnsembleSampler(moves=...)`.

    Independent draws from the law decorrelate at once where it fits. Elliptic steps turn a walker
    about the law's centre by a random angle: they keep the law invariant, and leave places it serves
    badly in steps short enough to be accepted. Differential evolution needs no law.

    Parameters
    ----------
    law : Proposal
        Fitted law, frozen.

    Returns
    -------
    list of (emcee move, share)
    """
    import emcee

    def independent(coords: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        return _judged(coords, law.draw(len(coords), random))

    def elliptic(coords: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        return _judged(coords, law.turn(coords, random))

    def _judged(coords: Array, proposed: Array) -> tuple[Array, Array]:
        both = law.log_density(np.concatenate([coords, proposed]))
        return proposed, both[: len(coords)] - both[len(coords) :]

    return [
        (emcee.moves.MHMove(independent), _SHARES["independent"]),
        (emcee.moves.MHMove(elliptic), _SHARES["elliptic"]),
        (emcee.moves.DEMove(), _SHARES["differential"]),
    ]
