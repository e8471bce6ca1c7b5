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
from percept.inference.model.gaussian import (
    Latents,
    SubjectCovariance,
    eliminate,
)
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
    covariate_sd : float
        Prior SD of the slopes of covariates.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        basis: Basis,
        covariate_sd: float,
    ) -> None:
        self._units = Units(statistics, design, basis, covariate_sd)
        effects = len(self._units.multipliers)
        blocks = (effects, self._units.patterns)
        if self._units.own_first:
            blocks = (len(basis.own), self._units.environments)
        self._precision = JointPrecision(self._units, *blocks)
        _, latents = basis.matrix.shape
        numbers = latents * len(statistics.patterns) * max(effects, 1)
        self.draws_per_pass = draws_at_once(numbers)
        #: Patterns of several subjects, with the kinds of their units.
        self._of_several = []
        self._constant = 0.0
        for g, pattern in enumerate(statistics.patterns):
            if pattern.subjects > 1:
                kinds = self._units.kind[self._units.pattern == g]
                self._of_several.append((pattern, kinds))
                # Units are means times the root of the number of subjects.
                log_root = 0.5 * math.log(pattern.subjects)
                self._constant += design.parameters * len(kinds) * log_root

    def log_density(self, scales: CellScales) -> Array:
        """Log density of all cell means and of rows of trials, (W,).

        It is without powers of 2 pi, `Statistics.constant`, and determinants of trials.
        """
        solution = self.solve(scales)
        value = self._constant + solution.log_density
        for pattern, kinds in self._of_several:
            effects = scales.effects[:, :, pattern.environments]
            covariance = SubjectCovariance(solution.noise[kinds], effects)
            value -= 0.5 * covariance.scatter_distance(pattern.rows.swapaxes(0, 1))
            contrast_count = pattern.subjects - 1.0
            value -= 0.5 * contrast_count * covariance.log_determinant
        return np.asarray(value)

    def solve(self, scales: CellScales) -> _Solution:
        """Latents that fit best, and their law."""
        # Draws that lose all digits may become NaN here.
        with np.errstate(all="ignore"):
            return _Solution(self._units, self._precision, scales)


class _Solution:
    """Latents by normal equations; by orthogonal factors where these lose digits.

    Attributes
    ----------
    log_density : ndarray
        Of the units, (W,).
    best : ndarray
        Own deviations and the rest that fit best, (a J + r, W).
    noise : Block
        D of every kind, entries (kinds, W).
    """

    def __init__(
        self,
        units: Units,
        precision: JointPrecision,
        scales: CellScales,
    ) -> None:
        _, quantities, _ = units.latents.shape
        noise = units.noise(scales)
        self.noise = noise
        vectors = units.vectors(scales)
        tau_precision = scales.tau**-2.0
        own_precision = np.repeat(tau_precision, units.environments, axis=0)
        deviations, width = own_precision.shape
        rest = len(units.latents) - 1 - deviations
        of_rest = np.ones((rest, width))
        # Of own deviations and the rest, (a J + r, W).
        prior = np.concatenate([own_precision, of_rest])
        blocks, cross, joint = precision(noise, vectors)
        if units.own_first:
            add_to_diagonal(blocks, tau_precision[:, None])
            add_to_diagonal(joint[:-1, :-1], 1.0)
        else:
            add_to_diagonal(blocks, 1.0)
            add_to_diagonal(joint[:-1, :-1], prior)
        solved, least_kept = eliminate(blocks, cross, joint)
        self._latents = Latents(solved, own_first=units.own_first, rest=rest)
        self.best = self._latents.best
        effects = self._latents.effects
        squares = np.einsum("kw,kw,kw->w", prior, self.best, self.best)
        squares += np.einsum("kw,kw->w", effects, effects)
        in_blocks = solved.blocks.reshape(-1, width)
        unknowns = np.concatenate([in_blocks, solved.others])
        squares += _misfit(units, noise, vectors, unknowns)
        of_noise = units.means_of_kind @ noise.log_determinant()
        of_noise -= np.log(own_precision).sum(axis=0)
        self.log_density = -0.5 * (squares + of_noise + solved.log_determinant)
        #: Draws that have lost too many digits. NaN is lost too.
        self._lost = np.flatnonzero(~(least_kept >= _LEAST_KEPT))
        self._exact: _Exact | None = None
        if self._lost.size:
            lost = self._lost
            effect_vectors = vectors[quantities:]
            self._exact = _Exact(
                units,
                noise[:, lost],
                [vector[..., lost] for vector in effect_vectors],
                prior[:, lost],
            )
            self.best[:, lost] = self._exact.best
            self.log_density[lost] = self._exact.log_density - 0.5 * of_noise[lost]

    def columns(self, weights: Array) -> Array:
        """Columns (n, L, W) whose products are the covariance of combinations (a J + r, L, 1)."""
        with np.errstate(all="ignore"):
            columns = self._latents.columns(weights)
        if self._exact is not None:
            exact = self._exact.columns(weights)
            columns[..., self._lost] = 0.0
            columns[: len(exact), :, self._lost] = exact
        return columns


def _misfit(
    units: Units,
    noise: Block,
    vectors: list[Array],
    unknowns: Array,
) -> Array:
    """Squares of the units about what the unknowns, blocks first, fit, by D: (W,)."""
    data = np.full((1, unknowns.shape[1]), -1.0)
    times = units.columns @ np.concatenate([unknowns, data])
    _, quantities, unit_count = units.latents.shape
    by_vector = times.reshape(-1, unit_count, unknowns.shape[1])
    misfit = by_vector[:quantities]
    for vector, of_units in zip(vectors[quantities:], by_vector[quantities:], strict=True):
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
        whole = np.empty((effect_count + latents + 1, *units.latents.shape[1:], width))
        for a, effect in enumerate(effects):
            multiplier = units.multipliers[a, :, None]
            np.multiply(effect[:, units.kind], multiplier, out=whole[a])
        whole[effect_count:] = units.latents[..., None]
        by_quantity = tuple(whole.swapaxes(0, 1))
        whitened = np.stack(noise[units.kind].whiten(by_quantity))
        by_draw = whitened.transpose(3, 2, 0, 1)  # (W, U, P, q + K + 1)
        log_determinant = np.zeros(width)
        of_prior = np.zeros((width, latents, latents + 1))
        diagonal = np.arange(latents)
        of_prior[:, diagonal, diagonal] = np.sqrt(prior).T
        remaining = [of_prior]
        unit_rows = np.eye(effect_count, len(whole))
        of_effects = np.broadcast_to(unit_rows, (width, *unit_rows.shape))
        for g in range(units.patterns):
            of_pattern = by_draw[:, units.pattern == g]
            flat = of_pattern.reshape(width, -1, len(whole))
            triangle = _triangle([flat, of_effects])
            log_determinant += _log_pivots(triangle[:, :effect_count, :effect_count])
            remaining.append(triangle[:, effect_count:, effect_count:])
        triangle = _triangle(remaining)
        log_determinant += _log_pivots(triangle[:, :latents, :latents])
        #: R⁻¹, (W, K, K)
        self._inverse = np.linalg.inv(triangle[:, :latents, :latents])
        right = triangle[:, :latents, latents]
        self.best = np.einsum("wkl,wl->kw", self._inverse, right)
        distance = triangle[:, latents, latents] ** 2
        self.log_density = -log_determinant - 0.5 * distance

    def columns(self, weights: Array) -> Array:
        """Columns (K, L, W) of combinations with weights (K, L, 1)."""
        return np.asarray(np.einsum("wkl,kn->lnw", self._inverse, weights[..., 0]))


def _triangle(rows: list[Array]) -> Array:
    """Triangles of rows (W, n, K), all below one another."""
    below = np.concatenate(rows, axis=1)
    return np.asarray(np.linalg.qr(below, mode="r"))


def _log_pivots(triangles: Array) -> Array:
    """Log determinants of triangles (W, K, K), (W,)."""
    pivots = np.diagonal(triangles, axis1=1, axis2=2)
    return np.asarray(np.log(np.abs(pivots)).sum(axis=1))
