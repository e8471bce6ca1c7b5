"""Intervals of all three kinds from the posterior, as estimands of a sampling run."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import Laws, Model
from percept.inference.sampling.estimands import Estimates
from percept.inference.sampling.mixture import mixture_quantile, share_half_width

Array = NDArray[np.float64]
KINDS = ("mean", "user", "share")


class IntervalEstimands:
    """Endpoints of the intervals asked for, of every cell."""

    def __init__(
        self,
        model: Model,
        *,
        kinds: tuple[str, ...] = KINDS,
        level: float = 0.99,
        share: float = 0.99,
        confidence: float = 0.95,
    ) -> None:
        self._model = model
        self.kinds = kinds
        self.level, self.share, self.confidence = level, share, confidence
        self.cells = model.cells

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all limits, in their order."""
        return tuple(
            f"{side} {kind} limit of {p} in {e}"
            for kind in self.kinds
            for side in ("lower", "upper")
            for p, e in self.cells
        )

    def components(self, points: Array) -> Array:
        """Laws per draw, packed: shape (W, 3 C)."""
        return self._model.laws(points).pack()

    def limits(self, kind: str, laws: Laws) -> tuple[Array, Array, Array]:
        """Limits of one kind on the response scale."""
        if kind == "share":
            centre, half, influence = share_half_width(
                laws.mean, laws.sd, laws.spread, share=self.share, confidence=self.confidence
            )
            return centre - half, centre + half, influence
        sd = laws.sd if kind == "mean" else np.hypot(laws.sd, laws.spread)
        tail = 0.5 * (1.0 - self.level)
        lower, on_lower = mixture_quantile(laws.mean, sd, tail, upper=False)
        upper, on_upper = mixture_quantile(laws.mean, sd, tail, upper=True)
        return lower, upper, np.concatenate([on_lower, on_upper], axis=1)

    def parts(self) -> list[IntervalEstimands]:
        """Limits of one kind each."""
        return [self._of(kind) for kind in self.kinds]

    def _of(self, kind: str) -> IntervalEstimands:
        one = copy.copy(self)
        one.kinds = (kind,)
        return one

    def estimate(self, components: Array) -> tuple[Estimates, Array]:
        """All limits of all kinds asked for, their scale being the interval's half-width."""
        laws = Laws.unpack(components)
        values, scales, influences = [], [], []
        for kind in self.kinds:
            lower, upper, influence = self.limits(kind, laws)
            values += [lower, upper]
            scales += [0.5 * (upper - lower)] * 2
            influences.append(influence)
        found = Estimates(self.names, np.concatenate(values), np.concatenate(scales))
        return found, np.concatenate(influences, axis=1)
