"""A number of steps of all ensembles, worked on by as many processes as there are.

Ensembles draw from generators of their own and a value does not depend on the batch it is computed in, so the
answer is the same in every bit, however the ensembles are divided.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.ensembles import advance
from percept.inference.sampling.estimands import Estimands
from percept.inference.sampling.heap import keep_freed_memory
from percept.inference.sampling.transported import Transported
from percept.inference.sampling.unfinished import Ensembles
from percept.inference.share import Share

__all__ = ["Piece", "run_piece"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """What steps led to, and what was kept of them.

    Attributes
    ----------
    state : Ensembles
        Where the ensembles stand now.
    points : ndarray, shape (E, T, W, d)
        Kept coordinates of the target.
    components : ndarray, shape (E, T, W, C)
        What the estimands keep per draw.
    """

    state: Ensembles
    points: Array
    components: Array


def run_piece(
    here: Transported,
    estimands: Estimands,
    state: Ensembles,
    *,
    steps: int,
    stride: int,
    walkers: int,
    share: Share,
) -> Piece:
    """Run all ensembles for some steps.

    Parameters
    ----------
    here : Transported
        The target in the coordinates of the walkers.
    estimands : Estimands
        What is kept per draw.
    state : Ensembles
        Where to go on from.
    steps, stride : int
        Steps to take, a multiple of `stride`; one position in so many is kept.
    walkers : int
        Of how many walkers of each ensemble positions are kept.
    share : Share
        Who works on it.

    Returns
    -------
    Piece
    """
    parts = [
        (here, estimands, part, steps, stride, walkers)
        for part in _divided(state, min(share.parts, len(state.coords)))
    ]
    found = share(_run, parts)
    if len(found) == 1:
        return found[0]
    return Piece(
        _together([piece.state for piece in found]),
        np.concatenate([piece.points for piece in found]),
        np.concatenate([piece.components for piece in found]),
    )


def _run(
    here: Transported, estimands: Estimands, state: Ensembles, steps: int, stride: int, walkers: int
) -> Piece:
    keep_freed_memory()
    state, points = advance(here, state, steps=steps, stride=stride, walkers=walkers)
    # In one order of memory, however many pieces there are: the last bits of sums depend on it.
    flat = np.ascontiguousarray(here.map(points.reshape(-1, points.shape[-1])))
    components = np.ascontiguousarray(estimands.components(flat))
    return Piece(state, flat.reshape(points.shape), components.reshape(*points.shape[:3], -1))


def _divided(state: Ensembles, parts: int) -> list[Ensembles]:
    """Divide ensembles into groups as equal as can be; the schedule of moves is every group's."""
    ends = [len(state.coords) * part // parts for part in range(parts + 1)]
    return [
        dataclasses.replace(
            state,
            coords=state.coords[start:end],
            log_density=state.log_density[start:end],
            generators=state.generators[start:end],
            accepted=state.accepted[start:end],
        )
        for start, end in itertools.pairwise(ends)
    ]


def _together(groups: list[Ensembles]) -> Ensembles:
    return dataclasses.replace(
        groups[0],
        coords=np.concatenate([group.coords for group in groups]),
        log_density=np.concatenate([group.log_density for group in groups]),
        generators=tuple(generator for group in groups for generator in group.generators),
        accepted=np.concatenate([group.accepted for group in groups]),
    )
