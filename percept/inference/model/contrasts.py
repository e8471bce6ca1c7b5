"""Limits of cells and contrasts of a linear design: of bias, and of one user's own contrast."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.interval_estimands import IntervalEstimands
from percept.inference.model.laws import ConditionalMoments
from percept.inference.sampling.gate import Estimates

__all__ = ["ContrastEstimands", "ContrastLimits", "ContrastRows"]

Array = NDArray[np.float64]


class Located(Protocol):
    """A model whose locations are weighed."""

    def laws_of(self, rows: Array, points: Array) -> ConditionalMoments:
        """Law of combinations (L, R) of the locations at coordinates (W, d)."""


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastRows:
    """Weights of the model's locations, (L, R) each."""

    cells: Array
    users: Array  # Contrasts that each user has too
    groups: Array  # Contrasts of different users, and slopes


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastLimits:
    """Limits of L contrasts on the response scale, and the laws they come from."""

    lower: Array  # (L,)
    upper: Array  # (L,)
    laws: ConditionalMoments  # Of all kept draws


class ContrastEstimands:
    """Limits of cells and contrasts, all under one tolerance.

    Parameters
    ----------
    model : LinearPosterior or Product
        Whose locations they weigh.
    rows : ContrastRows
        The cells and contrasts.
    users, groups : tuple of (str, str)
        Names of cells and contrasts that users have, and of the other contrasts, in two parts.
    claims : IntervalEstimands
        Kinds, level, share and confidence.
    """

    def __init__(
        self,
        model: Located,
        rows: ContrastRows,
        users: tuple[tuple[str, str], ...],
        groups: tuple[tuple[str, str], ...],
        claims: IntervalEstimands,
    ) -> None:
        self._model = model
        self._rows = rows
        self._claims = claims
        self._users = len(users)
        self._of_users = self._intervals(claims.kinds, users)
        self._of_groups = self._intervals(("mean",), groups)

    def _intervals(
        self, kinds: tuple[str, ...], names: tuple[tuple[str, str], ...]
    ) -> IntervalEstimands:
        """Limits of intervals whose cells are what is weighed."""
        claims = self._claims
        intervals = IntervalEstimands(
            claims.model,
            kinds=kinds,
            level=claims.level,
            share=claims.share,
            confidence=claims.confidence,
        )
        intervals.cells = names
        return intervals

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("contrasts", dataclasses.astuple(self._rows), self._claims.identity())

    def components(self, points: Array) -> Array:
        """Laws of cells and contrasts per draw, of single users first, then of groups: (W, 3 L)."""
        rows = self._rows
        every = np.vstack([rows.cells, rows.users, rows.groups])
        laws = self._model.laws_of(every, points)
        of_users = laws.of(slice(self._users))
        of_groups = laws.of(slice(self._users, None))
        return np.hstack([of_users.pack(), of_groups.pack()])

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits in parts, their scale being the interval's half-width."""
        of_users = components[:, : 3 * self._users]
        of_groups = components[:, 3 * self._users :]
        yield from self._of_users.estimates(of_users)
        if of_groups.shape[1]:
            yield from self._of_groups.estimates(of_groups)

    def of_users(self, kind: str, value: Array, components: Array) -> ContrastLimits:
        """Pick the contrasts of users, of one kind, from a run's estimates and components."""
        kinds = self._claims.kinds
        first = len(self._rows.cells)
        ends = value[: 2 * self._users * len(kinds)]
        of_kind = ends.reshape(len(kinds), 2, -1)[kinds.index(kind)]
        lower, upper = of_kind[:, first:]
        laws = ConditionalMoments.unpack(components[:, : 3 * self._users])
        return ContrastLimits(lower, upper, laws.of(slice(first, None)))

    def of_groups(self, value: Array, components: Array) -> ContrastLimits:
        """Pick the other contrasts from a run's estimates and components."""
        ends = value[2 * self._users * len(self._claims.kinds) :]
        lower, upper = ends.reshape(2, -1)
        return ContrastLimits(
            lower, upper, ConditionalMoments.unpack(components[:, 3 * self._users :])
        )
