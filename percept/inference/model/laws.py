"""Laws of locations and users given draws of the scales.

The R locations are the cells by quantity, slopes of covariates, and coefficients of fixed terms.
Whatever is reported is a row of weights on them: a cell is a unit row, a contrast has ones of
either sign, and a trend weighs coefficients. Given the scales all laws are normal. A user differs
from the locations by effects on all cells, with columns Z, and by a departure in each cell.

Arrays have S or W draws, L rows, P quantities and C cells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.blocks import entries
from percept.inference.model.rows import Rows
from percept.inference.model.scales import CellScales

__all__ = ["Joint", "Law", "Moments", "Solved", "joined", "user_columns", "user_sd"]

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
    """Laws of some draws after another, as one."""
    fields = {}
    for field in dataclasses.fields(laws[0]):
        fields[field.name] = np.concatenate([getattr(law, field.name) for law in laws])
    return dataclasses.replace(laws[0], **fields)


class Solved(Protocol):
    """Latents of a study, given W sets of scales."""

    latents: Array  # (a J + r, W) Own deviations over their SDs and the rest, that fit best

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (n, L, W) of combinations with weights (L, a J) and (L, r)."""


class Law:
    """Law of the locations, and of one user, at W sets of scales.

    Parameters
    ----------
    rows : Rows
        Units and columns of the study.
    scales : CellScales
        The scales.
    solved : Solved
        The latents.

    Attributes
    ----------
    mean : ndarray
        Means of the locations, (W, R).
    """

    def __init__(
        self,
        rows: Rows,
        scales: CellScales,
        solved: Solved,
    ) -> None:
        self._rows = rows
        self._scales = scales
        self._solved = solved
        latents = solved.latents.copy()
        own_sd = rows.own_sd(scales.tau)
        latents[: rows.deviations] *= np.repeat(own_sd, rows.environments, axis=0)
        self.mean = (rows.basis @ latents).T

    def columns(self, weights: Array) -> Array:
        """Columns (W, L, K) whose products are the covariance of combinations (L, R)."""
        of_latents = weights @ self._rows.basis
        own, rest = np.split(of_latents, [self._rows.deviations], axis=1)
        return self._solved.columns_of(own, rest).T

    def sd(self, weights: Array) -> Array:
        """SDs (W, L) of combinations (L, R) of the locations."""
        columns = self.columns(weights)
        return np.sqrt(np.einsum("wlk,wlk->wl", columns, columns))

    def user_sd(self, weights: Array) -> Array:
        """SDs (W, L) of the same combinations of one user's cells about the locations'."""
        return user_sd(self._scales, self._of_cells(weights))

    def joint(self, weights: Array) -> Joint:
        """Joint laws of groups of combinations, (groups, n, R)."""
        groups, count, _ = weights.shape
        flat = weights.reshape(groups * count, -1)
        columns = self.columns(flat)
        by_group = columns.reshape(len(columns), groups, count, -1)
        of_users = user_columns(self._scales, self._of_cells(flat))
        of_users = of_users.reshape(len(columns), groups, count, -1)
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
        of_users = user_columns(self._scales, self._of_cells(weights))
        normals = rng.standard_normal((repeats, len(columns), of_users.shape[2]))
        return locations, locations + np.einsum("wlk,rwk->rwl", of_users, normals)

    def _of_cells(self, weights: Array) -> Array:
        """Weights (L, P, C) of the cells among those (L, R) of all locations."""
        size = self._rows.size
        cells = self._rows.cells
        return weights[:, : size * cells].reshape(-1, size, cells)


def user_sd(scales: CellScales, weights: Array) -> Array:
    """SDs (W, L) of combinations (L, P, C) of one user's cells about the locations."""
    count = len(weights)
    width = scales.tau.shape[-1]
    # Most combinations are of few cells.
    flat = sparse.csr_array(weights.reshape(count, -1))
    variance = np.zeros((count, width))
    for column in scales.effects:
        variance += (flat @ column.reshape(-1, width)) ** 2
    first = weights[:, 0]
    last = weights[:, -1]
    products = [first * first]
    if weights.shape[1] == 2:
        products += [2.0 * first * last, last * last]
    of_cells = sparse.csr_array(np.concatenate(products, axis=1))
    variance += of_cells @ np.concatenate(entries(scales.between))
    return np.sqrt(variance).T


def user_columns(scales: CellScales, weights: Array) -> Array:
    """Columns (W, L, K) of combinations (L, P, C) of one user's cells about the locations."""
    columns = [np.einsum("lpc,qpcw->wlq", weights, scales.effects)]
    for parts in scales.between.factor_columns():
        columns.append(np.einsum("lpc,pcw->wlc", weights, np.stack(parts)))
    return np.concatenate(columns, axis=2)
