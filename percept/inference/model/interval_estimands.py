"""Limits of the intervals that a fit reports, of every cell of any model.

A cell is a quantity in an environment. Given draw s, its location beta is N(mean_s, sd_s²) and a
user about beta is N(0, population_sd_s²). So each kind of interval has limits that are roots of a
mean over S draws of a normal law:

    mean    beta lies in it with the level's probability
    user    beta + a user lies in it with the level's probability
    share   it holds a share of all users with the confidence's probability
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.laws import ConditionalMoments
from percept.inference.model.model import Model
from percept.inference.sampling.endpoints import mixture_quantile, share_half_width
from percept.inference.sampling.gate import Estimates

__all__ = ["KINDS", "IntervalEstimands", "IntervalLimits"]

Array = NDArray[np.float64]

#: What an interval covers: the average user, the next user, a share of all users.
KINDS = ("mean", "user", "share")


@dataclasses.dataclass(frozen=True, eq=False)
class IntervalLimits:
    """Limits of one kind in C cells, on the response scale."""

    lower: Array  # (C,)
    upper: Array  # (C,)
    influence: Array  # (S, 2 C) Pull of each draw on the lower limits, then on the upper ones


class IntervalEstimands:
    """Limits of the requested intervals, of every cell.

    Parameters
    ----------
    model : Model
        Whose cells they are.
    kinds : tuple of str
        Of `KINDS`.
    level : float
        Credibility of the intervals of the average user and of the next user.
    share, confidence : float
        The third kind holds this share of all users with this probability.
    """

    def __init__(
        self,
        model: Model,
        *,
        kinds: tuple[str, ...] = KINDS,
        level: float = 0.99,
        share: float = 0.99,
        confidence: float = 0.95,
    ) -> None:
        self.model = model
        self.cells = model.cells
        self.kinds = kinds
        self.level = level
        self.share = share
        self.confidence = confidence

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("intervals", self.kinds, self.level, self.share, self.confidence)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, packed: shape (W, 3 C)."""
        return self.model.laws(points).pack()

    def limits(self, kind: str, laws: ConditionalMoments) -> IntervalLimits:
        """Limits of one kind from the laws of all draws."""
        if kind == "share":
            return self._share_limits(laws)
        sd = laws.sd
        if kind == "user":
            sd = np.hypot(laws.sd, laws.population_sd)
        tail = 0.5 * (1.0 - self.level)
        lower, on_lower = mixture_quantile(laws.mean, sd, tail, upper=False)
        upper, on_upper = mixture_quantile(laws.mean, sd, tail, upper=True)
        influence = np.hstack([on_lower, on_upper])
        return IntervalLimits(lower, upper, influence)

    def _share_limits(self, laws: ConditionalMoments) -> IntervalLimits:
        centre, half_width, influence = share_half_width(
            laws.mean,
            laws.sd,
            laws.population_sd,
            share=self.share,
            confidence=self.confidence,
        )
        return IntervalLimits(centre - half_width, centre + half_width, influence)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of one kind after another, with their influence; the scale is the half-width."""
        laws = ConditionalMoments.unpack(components)
        for kind in self.kinds:
            limits = self.limits(kind, laws)
            lower_names = []
            upper_names = []
            for parameter, environment in self.cells:
                lower_names.append(f"lower {kind} limit of {parameter} in {environment}")
                upper_names.append(f"upper {kind} limit of {parameter} in {environment}")
            half_width = 0.5 * (limits.upper - limits.lower)
            estimates = Estimates(
                names=(*lower_names, *upper_names),
                value=np.concatenate([limits.lower, limits.upper]),
                scale=np.tile(half_width, 2),
            )
            yield estimates, limits.influence
