"""Limits of contrasts of a linear design: of bias, and of one user's own contrast."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.hierarchy.linear import LinearModel
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.sampling.gate import Estimates

__all__ = ["ContrastEstimands", "ContrastLimits", "ContrastRows"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastRows:
    """Weights of the model's locations, (L, R) each."""

    users: Array  # Contrasts that each user has too
    groups: Array  # Contrasts of different users, and slopes


@dataclasses.dataclass(frozen=True, eq=False)
class ContrastLimits:
    """Limits and estimates on the response scale."""

    users: dict[str, Array]  # (2, L) By kind
    groups: Array  # (2, L)
    users_estimate: Array
    groups_estimate: Array


class ContrastEstimands:
    """Limits of contrasts, all under one tolerance.

    Parameters
    ----------
    model : LinearModel
        Whose locations they weigh.
    rows : ContrastRows
        The contrasts.
    names : tuple of str
        Of contrasts that users have, and of the other ones.
    claims : IntervalEstimands
        Kinds, level, share and confidence.
    """

    def __init__(
        self,
        model: LinearModel,
        rows: ContrastRows,
        names: tuple[str, ...],
        claims: IntervalEstimands,
    ) -> None:
        self._model = model
        self._rows = rows
        self._claims = claims
        users = len(rows.users)
        self._users = users
        self._of_users = self._intervals(claims.kinds, names[:users])
        self._of_groups = self._intervals(("mean",), names[users:])

    def _intervals(self, kinds: tuple[str, ...], names: tuple[str, ...]) -> IntervalEstimands:
        """Limits of intervals whose cells are contrasts."""
        claims = self._claims
        found = IntervalEstimands(
            claims.model,
            kinds=kinds,
            level=claims.level,
            share=claims.share,
            confidence=claims.confidence,
        )
        found.cells = tuple(("contrast", name) for name in names)
        return found

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return ("contrasts", dataclasses.astuple(self._rows), self._claims.identity())

    def components(self, points: Array) -> Array:
        """Laws of the contrasts per draw, those of users first: shape (W, 3 L)."""
        rows = self._rows
        laws = self._model.laws_of(np.vstack([rows.users, rows.groups]), points)
        parts = []
        for part in (slice(self._users), slice(self._users, None)):
            own = ConditionalMoments(
                laws.mean[:, part], laws.sd[:, part], laws.population_sd[:, part]
            )
            parts.append(own.pack())
        return np.hstack(parts)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits in parts, their scale being the interval's half-width."""
        of_users = components[:, : 3 * self._users]
        of_groups = components[:, 3 * self._users :]
        if of_users.shape[1]:
            yield from self._of_users.estimates(of_users)
        if of_groups.shape[1]:
            yield from self._of_groups.estimates(of_groups)

    def limits(self, value: Array, components: Array) -> ContrastLimits:
        """Sort a run's estimates, and estimate the centres from its components (S, columns)."""
        users = self._users
        groups = len(self._rows.groups)
        kinds = self._claims.kinds if users else ()
        of_kinds = value[: 2 * users * len(kinds)].reshape(len(kinds), 2, users)
        of_groups = value[2 * users * len(kinds) :].reshape(2, groups)
        return ContrastLimits(
            users=dict(zip(kinds, of_kinds, strict=True)),
            groups=of_groups,
            users_estimate=components[:, :users].mean(axis=0),
            groups_estimate=components[:, 3 * users : 3 * users + groups].mean(axis=0),
        )
