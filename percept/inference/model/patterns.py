"""Studies of several patterns of subjects: the density of their units, and the law of latents.

Either own deviations or effects are eliminated first, whichever leaves the smaller matrix. With A
the joint precision of the unknowns, D the noise of the units and b the effects,

    -2 log density = log det A + log det D + |y - X latents - Z b|² by D + |latents|² + |b|²

at the unknowns that fit best. It is a sum of squares, so that no digits are lost. Draws whose
elimination has lost too many go by `_Exact`, which is orthogonal and takes several times as long.

Arrays have a own deviations in each of J environments, r other latents, q effects of each of G
patterns, P quantities, U units and W sets of scales.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, with_prior
from percept.inference.model.gaussian import (
    Eliminated,
    Latents,
    SubjectCovariance,
    eliminate,
)
from percept.inference.model.rows import Rows
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Statistics

__all__ = ["SeveralPatterns"]

Array = NDArray[np.float64]
#: A column of effects: the number of its multiplier, and its values by kind, (P, kinds, W).
EffectColumn = tuple[int, Array]

#: Least part of a pivot that an elimination may leave. Log densities then err by some 1e-5, as
#: measured on 12 subjects in 5 environments: 1e-16 over that part.
_LEAST_KEPT = 1e-11
#: Numbers in the largest temporary of a pass, 1 MB of doubles: more leave the processor's cache.
_NUMBERS = 1 << 17
#: Draws of a pass at the least: fewer cost more in calls of numpy than in arithmetic.
_FEWEST_DRAWS = 32
#: Draws of a pass at the most: calls cost little by then, and small designs need no more memory.
_MOST_DRAWS = 1024


class SeveralPatterns:
    """Density and latents of a study.

    Parameters
    ----------
    statistics : Statistics
        Cell means by pattern.
    rows : Rows
        Units and columns of the study.
    effects : int
        Number q of a subject's effects.
    """

    def __init__(
        self,
        statistics: Statistics,
        rows: Rows,
        effects: int,
    ) -> None:
        self._rows = rows
        latents = rows.columns.shape[1]
        numbers = latents * rows.patterns * max(effects, 1)
        self.draws_per_pass = min(max(_NUMBERS // numbers, _FEWEST_DRAWS), _MOST_DRAWS)
        #: Patterns of several subjects, with the kinds of their units.
        self._of_several = []
        self._constant = 0.0
        for g, pattern in enumerate(statistics.patterns):
            if pattern.subjects > 1:
                kinds = rows.kind[rows.pattern == g]
                self._of_several.append((pattern, kinds))
                # Units are means times the root of the number of subjects.
                log_root = 0.5 * math.log(pattern.subjects)
                self._constant += rows.size * len(kinds) * log_root

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means and of rows of trials, (W,).

        It is without powers of 2 pi, `Statistics.constant`, and determinants of trials.
        """
        noise = self._rows.noise(scales)
        value = self._constant + _Solution(self._rows, scales, noise).log_density
        for pattern, kinds in self._of_several:
            effects = scales.effects[:, :, pattern.environments]
            covariance = SubjectCovariance(noise[kinds], effects)
            value -= 0.5 * covariance.scatter_distance(pattern.rows.swapaxes(0, 1))
            contrast_count = pattern.subjects - 1.0
            value -= 0.5 * contrast_count * covariance.log_determinant
        return np.asarray(value)

    def solve(self, scales: CellScales) -> _Solution:
        """Latents that fit best, and their law."""
        return _Solution(self._rows, scales, self._rows.noise(scales))


class _Solution:
    """Latents by normal equations; by orthogonal factors where these lose digits.

    Attributes
    ----------
    log_density : ndarray
        Of the units, (W,).
    best : ndarray
        Own deviations and the rest that fit best, (a J + r, W).
    """

    def __init__(
        self,
        rows: Rows,
        scales: CellScales,
        noise: Block,
    ) -> None:
        self._rows = rows
        self._noise = noise
        self._effects = rows.effects(scales)
        #: SDs of own deviations by column, (a, W), and of all of them, (a J, W).
        self._tau = scales.tau
        self._deviation_sd = np.repeat(scales.tau, rows.environments, axis=0)
        self._width = scales.tau.shape[-1]
        self._own_first = len(self._effects) * rows.patterns < rows.deviations
        # Draws that lose all digits may become NaN here.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            solved, least_kept = self._solve()
            rest = rows.columns.shape[1] - rows.deviations
            self._latents = Latents(solved, own_first=self._own_first, rest=rest)
            self.best = self._latents.best
            shape = (len(self._effects), rows.patterns, self._width)
            effects = self._latents.effects.reshape(shape)
            squares = self._distance(effects)
            squares += np.einsum("kw,kw->w", self.best, self.best)
            squares += np.einsum("qgw,qgw->w", effects, effects)
            of_noise = rows.means_of_kind @ noise.log_determinant()
            determinants = of_noise + solved.log_determinant
            self.log_density = -0.5 * (squares + determinants)
        #: Draws that have lost too many digits. NaN is lost too.
        self._lost = np.flatnonzero(~(least_kept >= _LEAST_KEPT))
        self._exact: _Exact | None = None
        if self._lost.size:
            self._exact = self._by_orthogonal_factors()
            self.best[:, self._lost] = self._exact.best
            of_lost = 0.5 * of_noise[self._lost]
            self.log_density[self._lost] = self._exact.log_density - of_lost

    def _solve(self) -> tuple[Eliminated, Array]:
        """Eliminate the larger group of unknowns, the data last everywhere."""
        rows = self._rows
        own_columns = len(rows.own)
        deviations = rows.deviations
        effects, by_columns = self._products_of_effects()
        own_by_own, own_by_rest, rest_by_rest = self._products_of_latents()
        of_rest = by_columns[:, deviations:]
        if not self._own_first:
            joint = _joint_precision(with_prior(own_by_own), own_by_rest, rest_by_rest)
            return eliminate(with_prior(effects), by_columns, joint)
        count, _, patterns, width = by_columns.shape
        joint = _joint_precision(with_prior(effects), of_rest, rest_by_rest)
        by_own = by_columns[:, :deviations]
        by_environment = by_own.reshape(count, own_columns, rows.environments, patterns, width)
        own_by_effects = by_environment.transpose(1, 0, 3, 2, 4)
        shape = (own_columns, count * patterns, rows.environments, width)
        cross = np.concatenate([own_by_effects.reshape(shape), own_by_rest], axis=1)
        return eliminate(with_prior(own_by_own), cross, joint)

    def _products_of_effects(self) -> tuple[Array, Array]:
        """Z'D⁻¹Z of each pattern, (q, q, G, W), and Z'D⁻¹[X, y], (q, a J + r + 1, G, W)."""
        rows = self._rows
        count = len(self._effects)
        columns = rows.columns.shape[1] + 1
        products = np.empty((count, count, rows.patterns, self._width))
        by_columns = np.empty((count, columns, rows.patterns, self._width))
        for a, (number, column) in enumerate(self._effects):
            weighted = np.stack(self._noise.solve(tuple(column)))  # H = D⁻¹Z, (P, kinds, W)
            flat = weighted.reshape(-1, self._width)
            by_column = rows.effects_by_columns[number] @ flat
            by_columns[a] = by_column.reshape(by_columns.shape[1:])
            for b, (other_number, other_column) in enumerate(self._effects[: a + 1]):
                by_kind = np.einsum("pnw,pnw->nw", weighted, other_column)
                products[a, b] = rows.effects_by_effects[number, other_number] @ by_kind
                products[b, a] = products[a, b]
        by_columns[:, : rows.deviations] *= self._deviation_sd[:, None]
        return products, by_columns

    def _products_of_latents(self) -> tuple[Array, Array, Array]:
        """X'D⁻¹[X, y]: own deviations by themselves (a, a, J, W), by the rest, and the rest.

        The latter two are (a, r + 1, J, W) and (r, r + 1, W).
        """
        rows = self._rows
        own_columns = len(rows.own)
        rest = rows.columns.shape[1] - rows.deviations
        precision = np.concatenate(self._noise.precision_entries())
        flat = np.asarray(rows.own_by_own @ precision)
        by_own = flat.reshape(own_columns, own_columns, rows.environments, self._width)
        flat = np.asarray(rows.own_by_rest @ precision)
        by_rest = flat.reshape(own_columns, rest + 1, rows.environments, self._width)
        of_rest = rows.rest_by_rest @ precision
        # Columns of the rest carry their SDs already.
        sd = self._tau[:, None, None]
        by_own *= sd
        by_own *= self._tau[:, None]
        by_rest *= sd
        return by_own, by_rest, of_rest.reshape(rest, rest + 1, self._width)

    def _distance(self, effects: Array) -> Array:
        """Squares of the units about what latents and effects (q, G, W) fit, by D: (W,)."""
        rows = self._rows
        coefficients = self.best.copy()
        coefficients[: rows.deviations] *= self._deviation_sd
        fitted = rows.columns @ coefficients
        fitted = fitted.reshape(*rows.data.shape, self._width)
        residuals = rows.data[..., None] - fitted
        for (number, column), fit in zip(self._effects, effects, strict=True):
            times = rows.multipliers[number][:, None] * fit[rows.pattern]
            residuals -= column[:, rows.kind] * times
        by_unit = self._noise[rows.kind].distance(tuple(residuals[:, None]))
        return np.asarray(by_unit.sum(axis=0))

    def columns(self, weights: Array) -> Array:
        """Columns (n, L, W) whose products are the covariance of combinations (a J + r, L, W)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            columns = self._latents.columns(weights)
        if self._exact is not None:
            exact = self._exact.columns(weights[..., self._lost])
            columns[..., self._lost] = 0.0
            columns[: len(exact), :, self._lost] = exact
        return columns

    def _by_orthogonal_factors(self) -> _Exact:
        """Solve the draws that have lost digits once more."""
        lost = self._lost
        effects = [(number, column[..., lost]) for number, column in self._effects]
        return _Exact(self._rows, self._noise[:, lost], effects, self._deviation_sd[:, lost])


def _joint_precision(
    blocks: Array,
    by_rest: Array,
    rest: Array,
) -> Array:
    """Lower triangle of a joint precision, the data last, (B k + r + 1, B k + r + 1, W).

    The first unknowns are B independent blocks, (k, k, B, W), and (k, r + 1, B, W) by the rest; the
    rest is (r, r + 1, W) without its prior.
    """
    count, others, block_count, width = by_rest.shape
    first = count * block_count
    joint = np.zeros((first + others, first + others, width))
    block = np.arange(block_count)
    for a in range(count):
        for b in range(count):
            joint[a * block_count + block, b * block_count + block] = blocks[a, b]
    joint[first:, :first] = by_rest.swapaxes(0, 1).reshape(others, first, width)
    joint[first:, first:-1] = rest.swapaxes(0, 1)
    diagonal = np.arange(first, len(joint))
    joint[diagonal, diagonal] += 1.0
    return joint


class _Exact:
    """Latents by orthogonal factors: of each pattern's units, and of all that these leave.

    Whitened by D, the units of a pattern, with rows for the prior of its effects, are

        [D^(-1/2) [Z, X, y]]
        [I         0      0]

    Below the prior of the latents, what is left of X and y by the triangle of this matrix makes one
    more triangle R. Nothing is subtracted from a precision. LAPACK takes one draw after another.
    """

    def __init__(
        self,
        rows: Rows,
        noise: Block,
        effects: list[EffectColumn],
        deviation_sd: Array,
    ) -> None:
        latents = rows.columns.shape[1]
        width = deviation_sd.shape[1]
        effect_count = len(effects)
        # [Z, X, y], (…, P, U, W)
        whole = np.empty((effect_count + latents + 1, *rows.data.shape, width))
        for a, (number, column) in enumerate(effects):
            multiplier = rows.multipliers[number]
            np.multiply(column[:, rows.kind], multiplier[:, None], out=whole[a])
        columns = rows.columns.toarray().T.reshape(latents, *rows.data.shape)
        whole[effect_count:-1] = columns[..., None]
        deviations = slice(effect_count, effect_count + rows.deviations)
        whole[deviations] *= deviation_sd[:, None, None]
        whole[-1] = rows.data[..., None]
        by_quantity = tuple(whole.swapaxes(0, 1))
        whitened = np.stack(noise[rows.kind].whiten(by_quantity))
        by_draw = whitened.transpose(3, 2, 0, 1)  # (W, U, P, q + K + 1)
        log_determinant = np.zeros(width)
        remaining = [_unit_rows(latents, latents + 1, width)]
        for g in range(rows.patterns):
            of_pattern = by_draw[:, rows.pattern == g]
            flat = of_pattern.reshape(width, -1, len(whole))
            triangle = _triangle([flat, _unit_rows(effect_count, len(whole), width)])
            log_determinant += _log_pivots(triangle[:, :effect_count, :effect_count])
            remaining.append(triangle[:, effect_count:, effect_count:])
        triangle = _triangle(remaining)
        log_determinant += _log_pivots(triangle[:, :latents, :latents])
        distance = np.zeros(width)
        if triangle.shape[1] > latents:
            distance = triangle[:, latents, latents] ** 2
        #: R⁻¹, (W, K, K)
        self._inverse = np.linalg.inv(triangle[:, :latents, :latents])
        self.best = np.einsum("wkl,wl->kw", self._inverse, triangle[:, :latents, latents])
        self.log_density = -log_determinant - 0.5 * distance

    def columns(self, weights: Array) -> Array:
        """Columns (K, L, W) of combinations with weights (K, L, W)."""
        return np.asarray(np.einsum("wkl,knw->lnw", self._inverse, weights))


def _unit_rows(
    count: int,
    size: int,
    width: int,
) -> Array:
    """Rows (W, count, size) of the prior of the first unknowns."""
    return np.broadcast_to(np.eye(count, size), (width, count, size))


def _triangle(rows: list[Array]) -> Array:
    """Triangles of rows (W, n, K), all below one another."""
    below = np.concatenate(rows, axis=1)
    return np.asarray(np.linalg.qr(below, mode="r"))


def _log_pivots(triangles: Array) -> Array:
    """Log determinants of triangles (W, K, K), (W,)."""
    pivots = np.diagonal(triangles, axis1=1, axis2=2)
    return np.asarray(np.log(np.abs(pivots)).sum(axis=1))
