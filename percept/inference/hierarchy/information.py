"""Locations by their information: the form for studies of several patterns of counts.

Given the scales, subject i adds to the information on beta

    V_i⁻¹ = P_i - P_i 1 T_i 1'P_i,  P_ij = (Sigma_w,j + Sigma_e,j/r_ij)⁻¹,  T_i = (Sigma_u⁻¹ + sum_j
    P_ij)⁻¹,

a missing cell having no precision. Cost follows subjects times environments, and trials never. The
difference loses digits where the subject effect dwarfs the rest or a correlation nears one; the
pivots of the Cholesky factor tell how many, and draws that lose more than `LEAST_PIVOT` allows are
left to the orthogonal form. Distances are sums of squares about the weighted means in either case.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, cholesky, gram, weighted_mean
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.statistics import Pattern

__all__ = [
    "LEAST_PIVOT",
    "Information",
    "InformationProblem",
    "lower_solve",
    "precision_entries",
    "upper_solve",
]

Array = NDArray[np.float64]
#: Least part of a pivot that subtraction may leave: log determinants then err by 1e-8 at the most.
LEAST_PIVOT = 1e-7
#: Draws of a pass: more cost the processor's cache, fewer cost calls.
_MOST_DRAWS, _FEWEST_DRAWS = 128, 8
#: Numbers in a temporary of a pass, over cells and over the matrix of the locations.
_CELLS, _MATRIX = 1 << 17, 1 << 22


class InformationProblem:
    """What cells say of the locations, pattern by pattern, before any scale is known."""

    def __init__(self, patterns: tuple[Pattern, ...], prior_columns: Array) -> None:
        size, environments = prior_columns.shape[1:]
        kinds = sorted(
            {cell for p in patterns for cell in zip(p.environments.tolist(), p.trials, strict=True)}
        )
        index = {kind: k for k, kind in enumerate(kinds)}
        self.environment = np.array([j for j, _ in kinds])  # (K,) of each kind of cell
        self.trials = np.array([trials for _, trials in kinds])  # (K,)
        self.weight = np.array([pattern.subjects for pattern in patterns], dtype=float)  # (G,)
        self.cell = np.full(
            (environments, len(patterns)), len(kinds)
        )  # (J, G) kind; K where there is none
        mean = np.zeros((size, environments, len(patterns)))
        for g, pattern in enumerate(patterns):
            cells = zip(pattern.environments.tolist(), pattern.trials, strict=True)
            self.cell[pattern.environments, g] = [index[cell] for cell in cells]
            mean[:, pattern.environments, g] = pattern.mean
        # About the environments' means, so that a common offset does not enter the products.
        share = np.where(self.cell < len(kinds), self.weight, 0.0)
        self.centre = np.einsum("jg,pjg->pj", share, mean) / share.sum(axis=1)
        self.mean = np.where(
            self.cell < len(kinds), mean - self.centre[..., None], 0.0
        )  # (P, J, G)
        self.member = (
            (self.cell == np.arange(len(kinds))[:, None, None]).any(axis=1).astype(float)
        )  # (K, G)
        self.count = self.member @ self.weight  # (K,) subjects
        self.value = self.mean[:, self.environment] * self.member  # (P, K, G)
        self.in_environment = (self.environment == np.arange(environments)[:, None]).astype(
            float
        )  # (J, K)
        # As if the patterns' means were what is observed, with covariances V_g over the subjects.
        self.constant = 0.5 * size * float(np.log(self.weight) @ self.member.sum(axis=0))
        self.prior_columns = prior_columns  # (Q, P, J) of alpha and gamma, times their prior SDs
        self.rows, self.row_group = _scatter_rows(patterns, size, environments)

    @property
    def draws_per_pass(self) -> int:
        """Draws worked on at once."""
        cells = len(self.cell) * (self.cell.shape[1] + self.row_group.size)
        most = min(_CELLS // cells, _MATRIX // self.centre.size**2, _MOST_DRAWS)
        return max(most, _FEWEST_DRAWS)


def _scatter_rows(
    patterns: tuple[Pattern, ...], size: int, environments: int
) -> tuple[Array, NDArray[np.intp]]:
    """Rows of scatter within patterns, (P, J, R), zero where unmeasured, and their pattern."""
    several = [(g, pattern) for g, pattern in enumerate(patterns) if pattern.subjects > 1]
    count = [pattern.rows.shape[1] for _, pattern in several]
    rows = np.zeros((size, environments, sum(count)))
    ends = np.cumsum([0, *count])
    for (_, pattern), start, end in zip(several, ends[:-1], ends[1:], strict=True):
        rows[:, pattern.environments, start:end] = pattern.rows.transpose(0, 2, 1)
    return rows, np.repeat(np.array([g for g, _ in several], dtype=np.intp), count)


class Information:
    """Locations at W sets of scales: density of the cell means, and on demand the law of beta."""

    def __init__(self, problem: InformationProblem, scales: Scales, kinds: Block) -> None:
        assert scales.tau is not None
        self._problem = problem
        self._size, self._environments = problem.centre.shape
        self._cells = _padded(kinds)[problem.cell]  # entries (J, G, W)
        self._precisions = self._cells.inverse()
        self._known = self._precisions.total()
        self._outer = None if scales.shared is None else scales.shared + self._known.inverse()
        left = None if scales.shared is None else (scales.shared.inverse() + self._known).inverse()
        self._tau = np.concatenate(
            [np.broadcast_to(t, (self._environments, t.size)) for t in scales.tau]
        ).T
        matrix, right, before = self._normal_equations(precision_entries(kinds.inverse()), left)
        self._factor = cholesky(matrix)
        pivots = np.einsum("wii->wi", self._factor)
        #: Whether enough digits are left, (W,).
        self.sound = (pivots * pivots >= LEAST_PIVOT * before).all(axis=1)
        self._latents = upper_solve(self._factor, lower_solve(self._factor, right))
        self.mean: Vector = tuple(self._of_latents(self._latents))
        determinants = problem.count @ kinds.log_determinant()
        if scales.shared is not None and left is not None:
            subjects = scales.shared.log_determinant() - left.log_determinant()
            determinants = determinants + problem.weight @ subjects
        distance = np.einsum("wq,wq->w", self._latents, self._latents) + self._distance()
        self.log_density = (
            problem.constant - 0.5 * (determinants + distance) - np.log(pivots).sum(axis=1)
        )

    def _normal_equations(self, precision: Array, left: Block | None) -> tuple[Array, Array, Array]:
        """Precision of the latents (delta, alpha, gamma), right side, and the first diagonal."""
        problem, size = self._problem, self._size
        width = precision.shape[-1]
        count = size * self._environments
        own = problem.in_environment * problem.count @ precision  # (P, P, J, W)
        per_kind = (problem.value @ problem.weight)[..., None]
        information = np.zeros((width, count, count))
        if left is not None:
            padded = np.concatenate([precision, np.zeros((size, size, 1, width))], axis=2)[
                :, :, problem.cell
            ]
            root = np.sqrt(problem.weight)[:, None]
            # P_ij times the factor of T_i: what the subject effects take away is a sum of outer
            # products.
            taken = np.stack(
                [
                    sum(padded[:, q] * (root * part) for q, part in enumerate(column))
                    for column in left.factor_columns()
                ]
            )  # (P, P, J, G, W)
            taken = taken.transpose(4, 1, 2, 0, 3).reshape(width, count, -1)
            information = -taken @ taken.transpose(0, 2, 1)
            data = (problem.value.transpose(0, 2, 1) @ precision).sum(axis=1)  # (P, G, W)
            pulled = np.stack(left.apply(tuple(data)))
            per_kind = per_kind - problem.member @ (problem.weight[:, None] * pulled)
        target = problem.in_environment @ (precision * per_kind).sum(axis=1)
        at = np.arange(self._environments)
        for p in range(size):
            for q in range(size):
                information[:, p * self._environments + at, q * self._environments + at] += own[
                    p, q
                ].T
        trend = problem.prior_columns.reshape(len(problem.prior_columns), count)
        target = target.reshape(count, width).T + information @ problem.centre.ravel()
        along = information @ trend.T
        matrix = np.empty((width, count + len(trend), count + len(trend)))
        matrix[:, :count, :count] = self._tau[:, :, None] * information * self._tau[:, None, :]
        matrix[:, :count, count:] = self._tau[:, :, None] * along
        matrix[:, count:, :count] = matrix[:, :count, count:].transpose(0, 2, 1)
        matrix[:, count:, count:] = trend @ along
        np.einsum("wii->wi", matrix)[...] += 1.0
        right = np.concatenate([self._tau * target, target @ trend.T], axis=1)
        full = np.einsum("ppjw->wpj", own).reshape(width, count)
        before = 1.0 + np.concatenate([self._tau**2 * full, full @ (trend**2).T], axis=1)
        return matrix, right, before

    def _of_latents(self, latents: Array) -> Array:
        """Locations (P, J, W) of latents (W, Q)."""
        count = self._tau.shape[1]
        trend = self._problem.prior_columns.reshape(-1, count)
        beta = self._tau * latents[:, :count] + latents[:, count:] @ trend
        return np.asarray(beta.T.reshape(self._size, self._environments, -1))

    def _distance(self) -> Array:
        """Sum of squares of means about the locations, and of scatter within patterns, whitened."""
        problem = self._problem
        apart = tuple(
            mean[..., None] + (centre[:, None] - beta)[:, None]
            for mean, centre, beta in zip(problem.mean, problem.centre, self.mean, strict=True)
        )
        total = problem.weight @ self._squares(apart, slice(None))
        if problem.row_group.size:
            total = total + self._squares(tuple(problem.rows[..., None]), problem.row_group).sum(
                axis=0
            )
        return total

    def _squares(self, apart: Vector, groups: NDArray[np.intp] | slice) -> Array:
        """r'V_g⁻¹r of vectors (J, R, W) or (J, R, 1), each of its group g: shape (R, W)."""
        cells, precisions = self._cells[:, groups], self._precisions[:, groups]
        if self._outer is None:
            return np.asarray(
                sum(np.einsum("jrw,jrw->rw", part, part) for part in cells.whiten(apart))
            )
        mean = weighted_mean(precisions, self._known[groups], apart, axis=0)
        inside = tuple(r - m for r, m in zip(apart, mean, strict=True))
        whitened = (
            *cells.whiten(inside),
            *(part[None] for part in self._outer[groups].whiten(mean)),
        )
        return np.asarray(sum(np.einsum("jrw,jrw->rw", part, part) for part in whitened))

    @functools.cached_property
    def _inverse(self) -> Array:
        """Inverse of the factor, (W, Q, Q): its columns' products are the latents' covariance."""
        return np.asarray(np.linalg.inv(self._factor))

    @functools.cached_property
    def covariance(self) -> Block:
        """Conditional covariance of beta within each environment, entries (J, W)."""
        return gram(tuple(self.columns().transpose(1, 0, 2, 3)))

    def columns(self) -> Array:
        """Columns (Q, P, J, W) whose outer products sum to the covariance of beta."""
        count = self._tau.shape[1]
        trend = self._problem.prior_columns.reshape(-1, count)
        columns = (
            self._inverse[:, :, :count] * self._tau[:, None] + self._inverse[:, :, count:] @ trend
        )
        return columns.transpose(1, 2, 0).reshape(-1, self._size, self._environments, len(columns))

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales: (P, J, W)."""
        normal = rng.standard_normal(self._latents.shape)
        return self._of_latents(self._latents + upper_solve(self._factor, normal))

    def trend(self, rows: Array) -> tuple[Array, Array]:
        """Mean (R, W) and columns (Q, R, W) of rows (R, 2 P) of alpha and gamma over prior SDs."""
        count = self._tau.shape[1]
        return rows @ self._latents[:, count:].T, np.moveaxis(
            self._inverse[:, :, count:] @ rows.T, 0, -1
        )


def _padded(kinds: Block) -> Block:
    """Covariances of kinds of cells, and last an infinite one: an absent cell says nothing."""
    end = np.full((1, kinds.variances[0].shape[1]), np.inf)
    slope = None if kinds.slope is None else np.concatenate([kinds.slope, np.zeros_like(end)])
    return Block(tuple(np.concatenate([part, end]) for part in kinds.variances), slope)


def precision_entries(precision: Block) -> Array:
    """Entries (P, P, K, W) of precisions."""
    v, g = precision.variances[0], precision.slope
    if g is None:
        return v[None, None]
    cross = v * g
    return np.stack([[precision.variances[1] + cross * g, cross], [cross, v]])


def lower_solve(factor: Array, right: Array) -> Array:
    """Solve L x = right for lower factors (W, Q, Q) and vectors (W, Q)."""
    x = right.copy()
    for i in range(x.shape[1]):
        x[:, i] = (x[:, i] - np.einsum("wk,wk->w", factor[:, i, :i], x[:, :i])) / factor[:, i, i]
    return x


def upper_solve(factor: Array, right: Array) -> Array:
    """Solve L'x = right."""
    x = right.copy()
    for i in reversed(range(x.shape[1])):
        x[:, i] = (x[:, i] - np.einsum("wk,wk->w", factor[:, i + 1 :, i], x[:, i + 1 :])) / factor[
            :, i, i
        ]
    return x
