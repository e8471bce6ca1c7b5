"""Laws of locations and users given draws of the scales.

The R locations are the cells by quantity, slopes of covariates, and coefficients of fixed terms.
Whatever is reported is a row of weights on them: a cell is a unit row, a contrast has ones of
either sign, and a trend weighs coefficients. Given the scales all laws are normal. A user differs
from the locations by effects on all cells, with columns Z, and by a departure in each cell.

Arrays have S or W draws, L rows, P quantities and C cells.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.rows import Rows
from percept.inference.model.scales import CellScales

__all__ = [
    "IndependentLaw",
    "Joint",
    "JointLaw",
    "Law",
    "LinearLaw",
    "Moments",
    "Solved",
    "joined",
]

Array = NDArray[np.float64]


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


class Law(ABC):
    """Law of the R locations, and of one user about them, at W sets of scales."""

    locations: int  # R

    @property
    @abstractmethod
    def mean(self) -> Array:
        """Means of the locations, (W, R)."""

    @abstractmethod
    def columns(self, weights: Array) -> Array:
        """Columns (W, L, K) whose products are the covariance of combinations (L, R)."""

    @abstractmethod
    def user_columns(self, weights: Array) -> Array:
        """Columns (W, L, K) of the same combinations of one user about the locations'."""

    def sd(self, weights: Array) -> Array:
        """SDs (W, L) of combinations (L, R) of the locations."""
        columns = self.columns(weights)
        return np.sqrt(np.einsum("wlk,wlk->wl", columns, columns))

    def user_sd(self, weights: Array) -> Array:
        """SDs (W, L) of the same combinations of one user about the locations'."""
        columns = self.user_columns(weights)
        return np.sqrt(np.einsum("wlk,wlk->wl", columns, columns))

    def moments(self, weights: Array) -> Moments:
        """Laws of combinations (L, R), each by itself."""
        return Moments(self.mean @ weights.T, self.sd(weights), self.user_sd(weights))

    def joint(self, weights: Array) -> Joint:
        """Joint laws of groups of combinations, (groups, n, R)."""
        groups, count, _ = weights.shape
        flat = weights.reshape(groups * count, -1)
        columns = self.columns(flat)
        by_group = columns.reshape(len(columns), groups, count, -1)
        of_users = self.user_columns(flat).reshape(len(columns), groups, count, -1)
        mean = self.mean @ flat.T
        return Joint(
            mean=mean.reshape(len(mean), groups, count),
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
        latents = rng.standard_normal((repeats, len(columns), columns.shape[2]))
        locations = self.mean @ weights.T + np.einsum("wlk,rwk->rwl", columns, latents)
        of_users = self.user_columns(weights)
        normals = rng.standard_normal((repeats, len(columns), of_users.shape[2]))
        return locations, locations + np.einsum("wlk,rwk->rwl", of_users, normals)


class Solved(Protocol):
    """Latents of a study, given W sets of scales."""

    best: Array  # (a J + r, W) Own deviations over their SDs and the rest, that fit best

    def columns(self, weights: Array) -> Array:
        """Columns (n, L, W) of combinations with weights (a J + r, L, W)."""


class LinearLaw(Law):
    """Law of a linear design; the latents are solved for when they are first asked for.

    Parameters
    ----------
    rows : Rows
        Units and columns of the study.
    scales : CellScales
        The scales.
    solve : callable
        Gives the latents.
    """

    def __init__(
        self,
        rows: Rows,
        scales: CellScales,
        solve: Callable[[], Solved],
    ) -> None:
        self.locations = rows.locations
        self._rows = rows
        self._scales = scales
        self._solve = solve

    @cached_property
    def _solved(self) -> Solved:
        return self._solve()

    @cached_property
    def mean(self) -> Array:
        """Means of the locations, (W, R)."""
        latents = self._solved.best * self._rows.latent_sd(self._scales.tau)
        return (self._rows.basis @ latents).T

    def columns(self, weights: Array) -> Array:
        """Columns (W, L, K) whose products are the covariance of combinations (L, R)."""
        of_latents = weights @ self._rows.basis
        sd = self._rows.latent_sd(self._scales.tau)
        return self._solved.columns(of_latents.T[..., None] * sd[:, None]).T

    def user_columns(self, weights: Array) -> Array:
        """Columns (W, L, K) of the same combinations of one user about the locations'."""
        quantities = self._rows.size
        cells = self._rows.cells
        of_cells = weights[:, : quantities * cells].reshape(-1, quantities, cells)
        columns = [np.einsum("lpc,qpcw->wlq", of_cells, self._scales.effects)]
        for parts in self._scales.between.factor_columns():
            columns.append(np.einsum("lpc,pcw->wlc", of_cells, np.stack(parts)))
        return np.concatenate(columns, axis=2)


class IndependentLaw(Law):
    """Law of R locations about zero, each with users of its own: SDs (W, R)."""

    def __init__(self, sd: Array, user_sd: Array) -> None:
        self.locations = sd.shape[1]
        self._sd = sd
        self._user_sd = user_sd

    @property
    def mean(self) -> Array:
        """Means of the locations, (W, R)."""
        return np.zeros_like(self._sd)

    def columns(self, weights: Array) -> Array:
        """Columns (W, L, R) of combinations (L, R)."""
        return weights * self._sd[:, None]

    def user_columns(self, weights: Array) -> Array:
        """Columns (W, L, R) of the same combinations of one user."""
        return weights * self._user_sd[:, None]


class JointLaw(Law):
    """Law of the locations of independent models, those of one after those of another."""

    def __init__(self, laws: Sequence[Law]) -> None:
        self.locations = sum(law.locations for law in laws)
        self._laws = laws

    def _shares(self, weights: Array) -> Iterator[tuple[Law, Array]]:
        """Each law with its part of weights (L, R)."""
        ends = np.cumsum([law.locations for law in self._laws])
        yield from zip(self._laws, np.split(weights, ends[:-1], axis=1), strict=True)

    @property
    def mean(self) -> Array:
        """Means of the locations, (W, R)."""
        return np.hstack([law.mean for law in self._laws])

    def columns(self, weights: Array) -> Array:
        """Columns (W, L, K) of combinations (L, R)."""
        return np.concatenate([law.columns(share) for law, share in self._shares(weights)], axis=2)

    def user_columns(self, weights: Array) -> Array:
        """Columns (W, L, K) of the same combinations of one user."""
        parts = [law.user_columns(share) for law, share in self._shares(weights)]
        return np.concatenate(parts, axis=2)
