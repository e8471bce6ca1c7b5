"""Studies of several patterns of subjects: the density of their units, and the law of latents.

Either own deviations or effects are eliminated first, whichever leaves the smaller matrix. With A
the joint precision, that of the prior in it,

    -2 log density = log det A - log det prior + log det D + |y - X latents - Z b|² by D
                     + |latents|² by their prior + |b|²

at the unknowns that fit best. It is a sum of squares, so that no digits are lost. Draws whose
elimination has lost too many go by `_Exact`, which is orthogonal and takes several times as long.

Arrays have a own deviations in each of J environments, r other latents, q effects of each of G
patterns, P quantities, U units and W sets of scales. `units` says what X, Z and D are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block, add_to_diagonal, draws_at_once
from percept.inference.model.design import Basis, Design
from percept.inference.model.gaussian import SubjectCovariance, eliminate
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Statistics
from percept.inference.model.units import JointPrecision, Units

Array = NDArray[np.float64]

#: Least part of a pivot that an elimination may leave. Log densities then err by some 1e-5, as
#: measured on 12 subjects in 5 environments: 1e-16 over that part.
_LEAST_KEPT = 1e-11


class SeveralPatterns:
    """Density and latents of a study.

    Parameters
    ----------
    statistics : Statistics
        Cell means by pattern.
    design : Design
        Its cells are the environments of the statistics.
    basis : Basis
        Columns of the locations.

    Attributes
    ----------
    draws_per_pass : int
        Draws worked on at once.
    matrix : ndarray
        Weights of the unknowns that `solve` gives in the R locations.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        basis: Basis,
    ) -> None:
        units = Units(statistics, design, basis)
        self._units = units
        self._precision = JointPrecision(units)
        _, latents = basis.matrix.shape
        effects, patterns = units.effects.shape
        self.matrix = basis.with_effects(units.effects.size, units.before_effects)
        numbers = latents * patterns * max(effects, 1)
        self.draws_per_pass = draws_at_once(numbers)
        #: Patterns of several subjects, with the kinds of their units.
        self._of_several = []
        for g, pattern in enumerate(statistics.patterns):
            if pattern.subjects > 1:
                kinds = units.kind[units.pattern == g]
                self._of_several.append((pattern, kinds))

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means and of rows of trials, (W,).

        It is without powers of 2 pi, `Statistics.constant`, and determinants of trials.
        """
        solution = self.solve(scales)
        value = solution.log_density
        for pattern, kinds in self._of_several:
            effects = scales.effects[:, :, pattern.environments]
            covariance = SubjectCovariance(solution.noise[kinds], effects)
            value -= 0.5 * covariance.scatter_distance(pattern)
            contrast_count = pattern.subjects - 1.0
            value -= 0.5 * contrast_count * covariance.log_determinant
        return np.asarray(value)

    def solve(self, scales: CellScales) -> _Solution:
        """Unknowns that fit best, and their law."""
        # Draws that lose all digits may become NaN here.
        with np.errstate(all="ignore"):
            return _Solution(self._units, self._precision, scales)


class _Solution:
    """Unknowns by normal equations; by orthogonal factors where these lose digits.

    Attributes
    ----------
    log_density : ndarray
        Of the units, (W,).
    best : ndarray
        Unknowns that fit best, (unknowns, W).
    noise : Block
        D of every kind, entries (kinds, W).
    """

    def __init__(
        self,
        units: Units,
        precision: JointPrecision,
        scales: CellScales,
    ) -> None:
        self.noise = units.noise(scales)
        vectors = units.vectors(scales)
        unknowns = units.columns.shape[1] - 1
        width = scales.tau.shape[1]
        prior = np.ones((unknowns, width))
        prior[units.own] = scales.tau[:, None] ** -2.0
        blocks, cross, joint = precision(self.noise, vectors)
        in_blocks = math.prod(units.block_shape)
        of_blocks, of_others = np.split(prior, [in_blocks])
        add_to_diagonal(blocks, of_blocks.reshape(blocks.shape[1:]))
        add_to_diagonal(joint[:-1, :-1], of_others)
        self._solved, least_kept = eliminate(blocks, cross, joint)
        self.best = self._solved.best
        squares = np.einsum("kw,kw,kw->w", prior, self.best, self.best)
        squares += _misfit(units, self.noise, vectors, self.best)
        of_noise = units.means_of_kind @ self.noise.log_determinant()
        _, environments = units.own.shape
        of_noise += 2.0 * environments * np.log(scales.tau).sum(axis=0)
        self.log_density = -0.5 * (squares + of_noise + self._solved.log_determinant)
        #: Draws that have lost too many digits. NaN is lost too.
        self._lost = np.flatnonzero(~(least_kept >= _LEAST_KEPT))
        self._latents = units.others[:-1]
        self._exact: _Exact | None = None
        if self._lost.size:
            lost = self._lost
            effects = vectors[len(self.noise.variances) :]
            of_lost = np.ix_(self._latents, lost)
            self._exact = _Exact(
                units,
                self.noise[:, lost],
                [vector[..., lost] for vector in effects],
                prior[of_lost],
            )
            # No location has effects, which may be NaN.
            self.best[:, lost] = 0.0
            self.best[of_lost] = self._exact.best
            self.log_density[lost] = self._exact.log_density - 0.5 * of_noise[lost]

    def columns(self, weights: Array) -> Array:
        """Columns (n, L, W) whose products are the covariance of combinations (unknowns, L, 1)."""
        with np.errstate(all="ignore"):
            columns = self._solved.columns(weights)
        if self._exact is not None:
            exact = self._exact.columns(weights[self._latents])
            columns[..., self._lost] = 0.0
            columns[: len(exact), :, self._lost] = exact
        return columns


def _misfit(
    units: Units,
    noise: Block,
    vectors: list[Array],
    unknowns: Array,
) -> Array:
    """Squares of the units about what the unknowns fit, by D: (W,)."""
    data = np.full((1, unknowns.shape[1]), -1.0)
    times = units.columns @ np.concatenate([unknowns, data])
    _, quantities, unit_count = units.x_and_data.shape
    by_vector = times.reshape(-1, unit_count, unknowns.shape[1])
    misfit = by_vector[:quantities]
    effects = zip(vectors[quantities:], by_vector[quantities:], strict=True)
    for vector, of_units in effects:
        misfit += vector[:, units.kind] * of_units
    by_unit = noise[units.kind].distance(tuple(misfit[:, None]))
    return np.asarray(by_unit.sum(axis=0))


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
        units: Units,
        noise: Block,
        effects: list[Array],
        prior: Array,
    ) -> None:
        latents, width = prior.shape
        effect_count = len(effects)
        # [Z, X, y], (…, P, U, W)
        columns, quantities, unit_count = units.x_and_data.shape
        shape = (effect_count + columns, quantities, unit_count, width)
        whole = np.empty(shape)
        for a, effect in enumerate(effects):
            multiplier = units.multipliers[a, :, None]
            np.multiply(effect[:, units.kind], multiplier, out=whole[a])
        whole[effect_count:] = units.x_and_data[..., None]
        by_quantity = tuple(whole.swapaxes(0, 1))
        whitened = np.stack(noise[units.kind].whiten(by_quantity))
        by_draw = whitened.transpose(3, 2, 0, 1)  # (W, U, P, q + K + 1)
        diagonal = np.arange(latents)
        of_prior = np.zeros((width, latents, latents + 1))
        of_prior[:, diagonal, diagonal] = np.sqrt(prior).T
        remaining = [of_prior]
        unit_rows = np.eye(effect_count, len(whole))
        of_effects = np.broadcast_to(unit_rows, (width, *unit_rows.shape))
        self.log_density = np.zeros(width)
        for g in range(units.effects.shape[1]):
            rows = by_draw[:, units.pattern == g]
            flat = rows.reshape(width, -1, len(whole))
            of_pattern = _triangle([flat, of_effects])
            self.log_density -= _log_pivots(of_pattern[:, :effect_count, :effect_count])
            remaining.append(of_pattern[:, effect_count:, effect_count:])
        triangle = _triangle(remaining)
        self.log_density -= _log_pivots(triangle[:, :latents, :latents])
        self.log_density -= 0.5 * triangle[:, latents, latents] ** 2
        #: R⁻¹, (W, K, K)
        self._inverse = np.linalg.inv(triangle[:, :latents, :latents])
        right = triangle[:, :latents, latents]
        self.best = np.einsum("wkl,wl->kw", self._inverse, right)

    def columns(self, weights: Array) -> Array:
        """Columns (K, L, W) of combinations with weights (K, L, 1)."""
        columns = np.einsum("wkl,kn->lnw", self._inverse, weights[..., 0])
        return np.asarray(columns)


def _triangle(rows: list[Array]) -> Array:
    """Triangles of rows (W, n, K), all below one another."""
    below = np.concatenate(rows, axis=1)
    return np.asarray(np.linalg.qr(below, mode="r"))


def _log_pivots(triangles: Array) -> Array:
    """Log determinants of triangles (W, K, K), (W,)."""
    pivots = np.diagonal(triangles, axis1=1, axis2=2)
    logs = np.log(np.abs(pivots))
    return np.asarray(logs.sum(axis=1))
