"""Long runs are judged in parts, each as long as memory allows: what is kept of the parts before."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.sampling.judgement import Judged

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Closed:
    """Parts of a run that were judged and settled: their estimates, and some of their positions.

    Estimates of parts are averaged, which costs a bias of the order of a part's squared Monte Carlo error.
    """

    steps: int  # Steps per ensemble they span
    value: Array  # (Q,)
    error: Array  # (Q,)
    points: Array  # (E, T, W, d) Kept coordinates of the target
    components: Array  # (E, T, W, C) What the estimands keep per draw
    stride: int  # Steps between kept positions

    def judged(self, part: Judged, steps: int) -> Judged:
        """Average with the estimates of the next part, by steps; errors are those of independent parts."""
        share = steps / (self.steps + steps)
        value = self.value + share * (part.estimates.value - self.value)
        together = np.hypot((1.0 - share) * self.error, share * part.errors)
        return dataclasses.replace(
            part, estimates=dataclasses.replace(part.estimates, value=value), errors=together
        )

    def positions(self, points: Array, components: Array, stride: int, most: int) -> tuple[Array, Array, int]:
        """Append the next part's positions, thinned to one stride and to `most` of a walker in all."""
        common = max(stride, self.stride)
        while True:
            parts = ((self.points, self.components, self.stride), (points, components, stride))
            if sum(kept.shape[1] // (common // own) for kept, _, own in parts) <= most:
                break
            common *= 2
        gaps = [common // own for *_, own in parts]
        all_points = [kept[:, gap - 1 :: gap] for (kept, _, _), gap in zip(parts, gaps, strict=True)]
        all_components = [kept[:, gap - 1 :: gap] for (_, kept, _), gap in zip(parts, gaps, strict=True)]
        return np.concatenate(all_points, axis=1), np.concatenate(all_components, axis=1), common
