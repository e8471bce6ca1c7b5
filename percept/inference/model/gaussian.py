"""Gaussian unknowns given scales: eliminated block by block, and the laws of what they make.

The unknowns are own deviations, a in each of J environments, with SDs tau; effects, q of each
pattern; and the rest, r fixed terms and slopes of covariates. Effects and the rest are standard
normal a priori. Given the others, own deviations of two environments are independent, and so are
effects of two patterns. W are the sets of scales, last in all arrays up to `Moments`.

They make R locations: the cells by quantity, slopes of covariates, and coefficients of fixed terms.
Whatever is reported is a row of weights on these: a cell is a unit row, a contrast has ones of
either sign, and a trend weighs coefficients. Given the scales all laws are normal. A user differs
from the locations by effects on all cells, with columns Z, and by a departure in each cell. From
`Moments` on draws come first: arrays have S or W draws, L rows, P quantities and C cells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import (
    Block,
    Vector,
    add_to_diagonal,
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Pattern

Array = NDArray[np.float64]
#: Few groups of combinations weigh few environments and cells, whose columns alone are worked out.
_GROUPS_AT_ONCE = 16
#: Share of squares that must be left where explained ones are subtracted: four digits are lost.
_LEAST_LEFT = 1e-4
#: From weights (L, R) to columns (W, L, K).
Columns = Callable[[Array], Array]


class Eliminated:
    """Unknowns in two groups: B blocks of k that are independent given K others.

    With the joint precision [[A, X], [X', Y]] and A^(-1/2) the inverse of a lower factor, T is
    A^(-1/2) X, and Y - T'T is the precision of the others. The data are one more column of X and
    Y, the last one: the right side of the equations.

    Parameters
    ----------
    factor : ndarray
        Lower factors of A, (k, k, B, W).
    explained : ndarray
        T, (k, K + 1, B, W).
    joint : ndarray
        Y - T'T, of which the lower triangle is read, (K + 1, K + 1, W).

    Attributes
    ----------
    best : ndarray
        The unknowns that fit best, blocks first, (k B + K, W).
    log_determinant : ndarray
        Of the joint precision, (W,).
    pivots : ndarray
        Of Y - T'T, (K, W).
    """

    def __init__(
        self,
        factor: Array,
        explained: Array,
        joint: Array,
    ) -> None:
        self._factor = factor
        self._explained = explained[:, :-1]
        other_count = len(joint) - 1
        # The row of the data below the square becomes the whitened right side.
        whole = lower_factor(joint[:, :other_count])
        self._factor_of_others = whole[:other_count]
        others = solve_upper(self._factor_of_others, whole[other_count])
        fitted = np.einsum("kcbw,cw->kbw", self._explained, others)
        blocks = solve_upper(factor, explained[:, -1] - fitted)
        in_blocks = blocks.reshape(-1, blocks.shape[-1])
        self.best = np.concatenate([in_blocks, others])
        self.log_determinant = 2.0 * log_diagonal(factor).sum(axis=0)
        self.log_determinant += 2.0 * log_diagonal(self._factor_of_others)
        self.pivots = np.einsum("ccw->cw", self._factor_of_others) ** 2

    def columns(self, weights: Array) -> Array:
        """Columns (n, L, W) of combinations with weights (k B + K, L, 1).

        Their products sum to the covariance.
        """
        size, _, blocks, _ = self._factor.shape
        of_blocks, of_others = np.split(weights, [size * blocks])
        by_block = of_blocks.reshape(size, blocks, *weights.shape[1:])
        is_weighed = by_block.any(axis=(0, 2, 3))
        factor = self._factor[:, :, is_weighed, None]
        explained = self._explained[:, :, is_weighed]
        whitened = solve_lower(factor, by_block[:, is_weighed])
        by_blocks = np.einsum("kcbw,kblw->clw", explained, whitened)
        columns = solve_lower(self._factor_of_others[:, :, None], of_others - by_blocks)
        flat = whitened.reshape(-1, *columns.shape[1:])
        return np.concatenate([flat, columns])


def eliminate(
    blocks: Array,
    cross: Array,
    joint: Array,
) -> tuple[Eliminated, Array]:
    """Integrate out independent blocks of unknowns.

    Parameters
    ----------
    blocks : ndarray
        Their precision, (k, k, B, W).
    cross : ndarray
        By the K others and the data, which are last, (k, K + 1, B, W).
    joint : ndarray
        The others by themselves and the data, (K + 1, K + 1, W); it is overwritten.

    Returns
    -------
    Eliminated
    ndarray
        Least ratio of a pivot of the others to its diagonal entry before the blocks are taken out,
        (W,). Rounding errors grow by its inverse.
    """
    factor = lower_factor(blocks)
    explained = solve_lower(factor[:, :, None], cross)
    diagonal = np.einsum("ccw->cw", joint)[:-1].copy()
    for row in range(len(joint)):
        end = row + 1
        of_row = explained[:, row]
        joint[row, :end] -= np.einsum("kbw,kcbw->cw", of_row, explained[:, :end])
    solved = Eliminated(factor, explained, joint)
    return solved, (solved.pivots / diagonal).min(axis=0, initial=1.0)


class SubjectCovariance:
    """Covariance V = D + ZZ' of one subject's cell means, used without being formed.

    D is the noise of the E cells, and Z are the columns of the q effects. With H = D⁻¹Z,
    LL' = I + Z'H, and r a vector of cell means less their locations,

        log det V = log det D + 2 log det L
        r'V⁻¹r    = (r - Zb)'D⁻¹(r - Zb) + b'b,    b = (LL')⁻¹H'r

    b are the effects that fit r best: squares are added, and nothing is subtracted. Over many r it
    is faster to subtract, r'D⁻¹r less the square of L⁻¹H'r, and enough digits stay in most draws.

    Parameters
    ----------
    noise : Block
        D, entries (E, W).
    effects : ndarray
        Z, shape (q, P, E, W).
    """

    def __init__(
        self,
        noise: Block,
        effects: Array,
    ) -> None:
        self.noise = noise
        self._effects = effects
        by_quantity = np.moveaxis(effects, 1, 0)
        #: H, (q, P, E, W)
        self._weighted_effects = np.stack(noise.solve(tuple(by_quantity)), axis=1)
        products = np.einsum("apew,bpew->abw", effects, self._weighted_effects)
        factor = lower_factor(add_to_diagonal(products, 1.0))
        determinant = noise.log_determinant().sum(axis=0)
        #: log det V, (W,)
        self.log_determinant = determinant + 2.0 * log_diagonal(factor)
        #: L, to be used for n vectors at once, (q, q, 1, W)
        self._factor = factor[:, :, None]

    def whiten(self, rows: Array) -> Array:
        """Vectors (n, P E + q, W) whose products are r'V⁻¹r of rows r (n, P, E, W)."""
        whitened = self._whitened_products(rows)
        effects = solve_upper(self._factor, whitened)
        of_cells = self.noise.whiten(self._unexplained(rows, effects))
        return np.concatenate([*of_cells, effects.swapaxes(0, 1)], axis=1)

    def scatter_distance(self, pattern: Pattern) -> Array:
        """Sum of r'V⁻¹r over the rows r of a pattern's scatter, (W,).

        Squares of L⁻¹H'r are subtracted from r'D⁻¹r, except in draws that little would be left of.
        """
        effects, quantities, cells, width = self._weighted_effects.shape
        rows = pattern.rows.swapaxes(0, 1)
        # One product of matrices: faster than a sum for each draw.
        by_cell = self._weighted_effects.reshape(effects, quantities * cells, width)
        products = rows.reshape(len(rows), quantities * cells) @ by_cell
        explained = solve_lower(self._factor, products)
        whole = self.noise.distance(tuple(pattern.triangles[..., None])).sum(axis=0)
        left = whole - np.einsum("qnw,qnw->w", explained, explained)
        is_lost = left < _LEAST_LEFT * whole
        if is_lost.any():
            few = SubjectCovariance(self.noise[:, is_lost], self._effects[..., is_lost])
            by_row = few.whiten(rows[..., None])
            left[is_lost] = np.einsum("nkw,nkw->w", by_row, by_row)
        return np.asarray(left)

    def draw_effects(
        self,
        rows: Array,
        rng: np.random.Generator,
    ) -> Array:
        """Draw subjects' effects (q, n, W) given rows r (n, P, E, W).

        Given r, effects have the mean b and the covariance (LL')⁻¹: b + L'⁻¹ times normal draws.
        """
        whitened = self._whitened_products(rows)
        return solve_upper(self._factor, whitened + rng.standard_normal(whitened.shape))

    def _whitened_products(self, rows: Array) -> Array:
        """L⁻¹H'r of rows r (n, P, E, W), (q, n, W)."""
        products = np.einsum("npew,qpew->qnw", rows, self._weighted_effects)
        return solve_lower(self._factor, products)

    def _unexplained(
        self,
        rows: Array,
        effects: Array,
    ) -> Vector:
        """Rows (n, P, E, W or 1) less what effects b (q, n, W) explain, Zb."""
        unexplained = []
        for p in range(rows.shape[1]):
            explained = np.einsum("qew,qnw->new", self._effects[:, p], effects)
            unexplained.append(rows[:, p] - explained)
        return tuple(unexplained)


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
        return Moments(*(values[:, numbers] for values in vars(self).values()))

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
        count = self.mean.shape[1]
        means = np.split(self.mean, count, axis=1)
        locations = np.split(self.location, count, axis=1)
        users = np.split(self.users, count, axis=1)
        return [Joint(*law) for law in zip(means, locations, users, strict=True)]

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


def joined(laws: Sequence[Joint]) -> Joint:
    """Join laws at some draws and laws at others into one at all of them, in this order."""
    return Joint(
        mean=np.concatenate([law.mean for law in laws]),
        location=np.concatenate([law.location for law in laws]),
        users=np.concatenate([law.users for law in laws]),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """Law of the R locations, and of one user about them, at W sets of scales.

    Columns of combinations with weights (L, R) are (W, L, K); their products are a covariance.
    """

    mean: Array  # (W, R) Means of the locations
    columns: Columns  # Of the locations
    user_columns: Columns  # Of one user about the locations

    def joint(self, weights: Array) -> Joint:
        """Joint laws of groups of combinations, (groups, n, R)."""
        return Joint(
            mean=np.tensordot(self.mean, weights, axes=(1, 2)),
            location=group_covariances(self.columns, weights),
            users=group_covariances(self.user_columns, weights),
        )

    def draw(
        self,
        weights: Array,
        rng: np.random.Generator,
        repeats: int,
    ) -> tuple[Array, Array]:
        """Draw combinations (L, R) of the locations and of new users, (repeats W, L) each."""
        mean = self.mean @ weights.T
        locations = mean + _drawn(self.columns(weights), rng, repeats)
        users = locations + _drawn(self.user_columns(weights), rng, repeats)
        shape = (-1, len(weights))
        return locations.reshape(shape), users.reshape(shape)


def _drawn(
    columns: Array,
    rng: np.random.Generator,
    repeats: int,
) -> Array:
    """Draw departures (repeats, W, L) whose covariance is that of columns (W, L, K)."""
    width, _, count = columns.shape
    normals = rng.standard_normal((repeats, width, count))
    return np.einsum("wlk,rwk->rwl", columns, normals)


def group_covariances(columns: Columns, weights: Array) -> Array:
    """Covariances (W, groups, n, n) of groups of combinations (groups, n, R)."""
    by_group = []
    for start in range(0, len(weights), _GROUPS_AT_ONCE):
        some = weights[start : start + _GROUPS_AT_ONCE]
        groups, count, locations = some.shape
        of_some = columns(some.reshape(groups * count, locations))
        roots = of_some.reshape(len(of_some), groups, count, -1)
        by_group.append(roots @ roots.swapaxes(2, 3))
    return np.concatenate(by_group, axis=1)


def user_columns(scales: CellScales, weights: Array) -> Array:
    """Columns (W, L, K) of one user about the locations, in combinations with weights (L, R)."""
    _, quantities, cells, _ = scales.effects.shape
    in_cells = weights[:, : quantities * cells]
    of_cells = in_cells.reshape(-1, quantities, cells)
    is_weighed = of_cells.any(axis=(0, 1))
    of_cells = of_cells[..., is_weighed]
    effects = scales.effects[:, :, is_weighed]
    columns = [np.einsum("lpc,qpcw->wlq", of_cells, effects)]
    for parts in scales.between.factor_columns():
        of_weighed = np.stack(parts)[:, is_weighed]
        columns.append(np.einsum("lpc,pcw->wlc", of_cells, of_weighed))
    return np.concatenate(columns, axis=2)
