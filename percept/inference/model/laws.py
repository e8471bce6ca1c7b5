"""Laws of locations and users given draws of the scales.

The R locations are the cells by quantity, slopes of covariates, and coefficients of fixed terms.
Whatever is reported is a row of weights on them: a cell is a unit row, a contrast has ones of
either sign, and a trend weighs coefficients. Given the scales all laws are normal. A user differs
from the locations by effects on all cells, with columns Z, and by a departure in each cell.

Arrays have S or W draws, L rows, P quantities and C cells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.scales import CellScales

Array = NDArray[np.float64]
#: From weights (L, R) to columns (W, L, K).
Columns = Callable[[Array], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Moments:
    """Law of each of L quantities and of users about it, given each draw: both are normal."""

    mean: Array  # (S, L) Mean of the location, and of the users
    sd: Array  # (S, L) SD of the location
    population_sd: Array  # (S, L) SD of users about the location

    def pack(self) -> Array:
        """Return all three side by side, shape (S, 3 L)."""
        return np.hstack([self.mean, self.sd, self.population_sd])

    def of(self, numbers: slice | list[int]) -> Moments:
        """Laws of some of the quantities."""
        return Moments(self.mean[:, numbers], self.sd[:, numbers], self.population_sd[:, numbers])

    @classmethod
    def unpack(cls, packed: Array) -> Moments:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))


@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """Joint law of n quantities, in each of some groups, given each draw."""

    mean: Array  # (S, groups, n) Mean of the locations
    location: Array  # (S, groups, n, n) Covariance of the locations
    users: Array  # (S, groups, n, n) Covariance of users about them

    def apart(self) -> list[Joint]:
        """Each group by itself."""
        groups = range(self.mean.shape[1])
        return [Joint(self.mean[:, [g]], self.location[:, [g]], self.users[:, [g]]) for g in groups]

    def moments(self) -> Moments:
        """Each quantity by itself, group by group."""
        variance = np.einsum("sgnn->sgn", self.location)
        of_users = np.einsum("sgnn->sgn", self.users)
        flat = (len(variance), -1)
        return Moments(
            mean=self.mean.reshape(flat),
            sd=np.sqrt(variance).reshape(flat),
            population_sd=np.sqrt(of_users).reshape(flat),
        )


_Laws = TypeVar("_Laws", Moments, Joint)


def joined(laws: Sequence[_Laws]) -> _Laws:
    """Join laws at some draws and laws at others into one at all of them, in this order."""
    fields = {}
    for field in dataclasses.fields(laws[0]):
        fields[field.name] = np.concatenate([getattr(law, field.name) for law in laws])
    return dataclasses.replace(laws[0], **fields)


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """Law of the R locations, and of one user about them, at W sets of scales.

    Columns of combinations with weights (L, R) are (W, L, K); their products are a covariance.
    """

    solve: Callable[[], tuple[Array, Columns]]  # Means (W, R) and columns of the locations
    user_columns: Columns  # Of one user about the locations

    @cached_property
    def _solved(self) -> tuple[Array, Columns]:
        return self.solve()

    @property
    def mean(self) -> Array:
        """Means of the locations, (W, R)."""
        return self._solved[0]

    def columns(self, weights: Array) -> Array:
        """Columns of combinations of the locations."""
        return self._solved[1](weights)

    def user_sd(self, weights: Array) -> Array:
        """SDs (W, L) of combinations of one user about the locations'; nothing is solved for."""
        columns = self.user_columns(weights)
        return np.sqrt(np.einsum("wlk,wlk->wl", columns, columns))

    def moments(self, weights: Array) -> Moments:
        """Laws of combinations (L, R), each by itself."""
        columns = self.columns(weights)
        sd = np.sqrt(np.einsum("wlk,wlk->wl", columns, columns))
        return Moments(self.mean @ weights.T, sd, self.user_sd(weights))

    def joint(self, weights: Array) -> Joint:
        """Joint laws of groups of combinations, (groups, n, R)."""
        groups, count, _ = weights.shape
        flat = weights.reshape(groups * count, -1)
        columns = self.columns(flat)
        of_users = self.user_columns(flat)
        width = len(columns)
        by_group = columns.reshape(width, groups, count, -1)
        of_users = of_users.reshape(width, groups, count, -1)
        mean = self.mean @ flat.T
        return Joint(
            mean=mean.reshape(width, groups, count),
            location=by_group @ by_group.swapaxes(2, 3),
            users=of_users @ of_users.swapaxes(2, 3),
        )

    def draw(
        self,
        weights: Array,
        rng: np.random.Generator,
        repeats: int,
    ) -> tuple[Array, Array]:
        """Draw combinations (L, R) of the locations and of new users, (repeats, W, L) each."""
        columns = self.columns(weights)
        width, _, latent_count = columns.shape
        latents = rng.standard_normal((repeats, width, latent_count))
        departures = np.einsum("wlk,rwk->rwl", columns, latents)
        locations = self.mean @ weights.T + departures
        of_users = self.user_columns(weights)
        normals = rng.standard_normal((repeats, width, of_users.shape[2]))
        return locations, locations + np.einsum("wlk,rwk->rwl", of_users, normals)


def user_columns(scales: CellScales, weights: Array) -> Array:
    """Columns (W, L, K) of one user about the locations, in combinations with weights (L, R)."""
    _, quantities, cells, _ = scales.effects.shape
    of_cells = weights[:, : quantities * cells].reshape(-1, quantities, cells)
    columns = [np.einsum("lpc,qpcw->wlq", of_cells, scales.effects)]
    for parts in scales.between.factor_columns():
        columns.append(np.einsum("lpc,pcw->wlc", of_cells, np.stack(parts)))
    return np.concatenate(columns, axis=2)
