"""Scales of a linear design: all that the laws of its locations depend on.

Axes are named as in the whole folder: W sets of scales (draws), P quantities, C cells, T groups of
trials, q columns of a subject's effects, o columns of the environments' own deviations.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block

__all__ = ["CellScales"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class CellScales:
    """W sets of scales."""

    between: Block  # (C, W) Covariance between subjects within a cell
    trial: Block | None  # (T, W) Covariance between the trials of a group; None without repeats
    covariances: list[Block]  # (W,) Of subjects' effects over the quantities, one for each term
    effects: Array  # (q, P, C, W) Columns Z: what a unit of each subject's effect adds to a cell
    tau: Array  # (o, P, W) SDs of the environments' own deviations, one for each column

    def at(self, draws: NDArray[np.intp]) -> CellScales:
        """Scales of some of the draws."""
        return CellScales(
            between=self.between[..., draws],
            trial=None if self.trial is None else self.trial[..., draws],
            covariances=[covariance[draws] for covariance in self.covariances],
            effects=self.effects[..., draws],
            tau=self.tau[..., draws],
        )
