"""Locations by whitened rows and orthogonal factors: for draws whose normal equations lose digits.

The rows are the mean of each pattern of N subjects, times √N, its contrasts of subjects, and, with
slopes of covariates, the trials about their cell's mean. A row of a pattern has its cells' noise D
and effects Z of its own. Whitened by D it is, with a row for the prior of each effect,

    [D^(-1/2) [Z, columns, data]]
    [I         0        0       ]

whose triangle holds log det(I + Z'D⁻¹Z) and the columns as V = D + ZZ' weighs them. Below these and
a row for the prior of each latent, one more triangle R holds the log determinant and the distance,
and R⁻¹ the law of the latents. Nothing is subtracted from a precision. LAPACK works on one draw
after another, which takes several times as long as `elimination`.

Arrays have G patterns, O rows of patterns, P quantities, C cells, q effects of a subject, K latents
(own deviations, fixed terms, slopes) and W sets of scales.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block
from percept.inference.model.cell_problem import CellProblem
from percept.inference.model.cell_scales import CellScales
from percept.inference.model.subject_equations import noise_of

__all__ = ["WhitenedRows"]

Array = NDArray[np.float64]


class WhitenedRows:
    """Latents by orthogonal factors, at W sets of scales.

    Attributes
    ----------
    log_density : ndarray
        As in `CellLaw`, (W,).
    latents : ndarray
        As in `SubjectsFirst`, (K, W).
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._latent_sd = _latent_sds(problem, scales)  # (K, W)
        size, width = self._latent_sd.shape
        triangles = _triangles_of_patterns(problem, scales, self._latent_sd)
        effects = len(scales.effects)
        diagonal = np.diagonal(triangles[..., :effects, :effects], axis1=2, axis2=3)
        of_effects = 2.0 * np.log(np.abs(diagonal[:, : len(problem.subjects)])).sum(axis=2)
        of_cells = noise_of(problem, scales).log_determinant()
        of_noise = np.einsum("cg,g,cgw->w", problem.present, problem.subjects, of_cells)
        rows = triangles[..., effects:, effects:].reshape(width, -1, size + 1)
        prior = np.broadcast_to(np.eye(size, size + 1), (width, size, size + 1))
        parts = [prior, rows]
        if problem.slopes and scales.trial is not None:
            parts.append(_rows_of_trials(problem, scales.trial, size))
        triangle = np.asarray(np.linalg.qr(np.concatenate(parts, axis=1), mode="r"))
        factor = triangle[:, :size, :size]
        #: R⁻¹, (W, K, K)
        self._inverse = np.linalg.inv(factor)
        self.latents = np.einsum("wkl,wl->kw", self._inverse, triangle[:, :size, size])
        pivots = np.abs(np.diagonal(factor, axis1=1, axis2=2))
        determinants = of_noise + of_effects @ problem.subjects + 2.0 * np.log(pivots).sum(axis=1)
        distance = triangle[:, size, size] ** 2 if triangle.shape[1] > size else 0.0
        self.log_density = problem.constant - 0.5 * (determinants + distance)

    def columns_of(self, own: Array, rest: Array) -> Array:
        """Columns (K, n, W), as in `SubjectsFirst`."""
        deviations = own[0].size
        weights = np.concatenate([own.reshape(len(own), deviations), rest], axis=1)
        sd = self._latent_sd.copy()
        # Weights of the rest are of latents, and those of own deviations in response units.
        sd[deviations:] = 1.0
        return np.einsum("nk,kw,wkl->lnw", weights, sd, self._inverse, optimize=True)

    def variances_of(self, own: Array, rest: Array) -> Array:
        """Variances (W, n), as in `SubjectsFirst`."""
        columns = self.columns_of(own, rest)
        return np.einsum("knw,knw->wn", columns, columns)


def _latent_sds(problem: CellProblem, scales: CellScales) -> Array:
    """Return what the columns of latents are multiplied by, (K, W)."""
    own = np.repeat(problem.own_sd(scales.tau), problem.environments, axis=0)
    width = own.shape[1]
    fixed = np.ones((problem.fixed_columns, width))
    slopes = np.full((problem.slopes, width), problem.covariate_sd)
    return np.concatenate([own, fixed, slopes])


def _triangles_of_patterns(problem: CellProblem, scales: CellScales, latent_sd: Array) -> Array:
    """Triangles of all rows of patterns, the G means first: (W, O, M, q + K + 1)."""
    size = problem.size
    cells = problem.cells
    pattern, data, columns = _rows_of_patterns(problem)
    noise = noise_of(problem, scales)[:, pattern]  # (C, O, W)
    width = latent_sd.shape[1]
    present = problem.present[:, pattern, None]
    effects = scales.effects[:, :, :, None] * present
    latents = columns[..., None] * latent_sd[:, None, None, None]
    every_draw = np.broadcast_to(data[None, ..., None], (1, *data.shape, width))
    whole = np.concatenate([effects, latents, every_draw])  # (q + K + 1, P, C, O, W)
    whitened = np.stack(noise.whiten(tuple(whole.swapaxes(0, 1))))  # (P, q + K + 1, C, O, W)
    rows = whitened.transpose(4, 3, 0, 2, 1).reshape(width, len(pattern), size * cells, len(whole))
    count = len(effects)
    prior = np.broadcast_to(np.eye(count, len(whole)), (*rows.shape[:2], count, len(whole)))
    return np.asarray(np.linalg.qr(np.concatenate([rows, prior], axis=2), mode="r"))


def _rows_of_patterns(problem: CellProblem) -> tuple[Array, Array, Array]:
    """Pattern (O,), data (P, C, O) and columns of latents without SDs (K, P, C, O) of all rows."""
    roots = np.sqrt(problem.subjects) * problem.present  # (C, G)
    means = problem.mean * roots
    of_cells = problem.basis.T.reshape(-1, problem.size, problem.cells, 1) * roots
    of_slopes = np.zeros((problem.slopes, *means.shape))
    quantities = np.eye(problem.size)
    of_covariates = np.einsum("mcg,pq->mpqcg", problem.covariate_mean * roots, quantities)
    of_slopes = of_covariates.reshape(of_slopes.shape)
    pattern = [np.arange(len(problem.subjects))]
    data = [means]
    columns = [np.concatenate([of_cells, of_slopes])]
    for scatter in problem.scatter:
        count = len(scatter.rows)
        pattern.append(np.full(count, scatter.pattern))
        of_rows = np.zeros((problem.size, problem.cells, count))
        of_rows[:, scatter.cells] = scatter.rows.transpose(1, 2, 0)
        data.append(of_rows)
        slopes = np.zeros((len(columns[0]), *of_rows.shape))
        first = len(slopes) - problem.slopes
        slopes[first:, :, scatter.cells] = scatter.slopes.transpose(0, 2, 3, 1)
        columns.append(slopes)
    return (
        np.concatenate(pattern),
        np.concatenate(data, axis=-1),
        np.concatenate(columns, axis=-1),
    )


def _rows_of_trials(problem: CellProblem, trial: Block, size: int) -> Array:
    """Rows (W, M P T, K + 1) of trials about their cell's mean, as slopes explain them."""
    scatter = problem.trial_scatter
    quantities = np.eye(problem.size)
    slopes = np.einsum("lmt,pq->mpqlt", scatter.covariate_rows, quantities)
    slopes = problem.covariate_sd * slopes.reshape(problem.slopes, *slopes.shape[2:])
    whole = np.concatenate([slopes, scatter.response_rows.swapaxes(0, 1)[None]])
    whitened = np.stack(trial.whiten(tuple(whole.swapaxes(0, 1)[..., None])))  # (P, n, M, T, W)
    count, width = whitened.shape[1], whitened.shape[-1]
    rows = whitened.transpose(4, 0, 2, 3, 1).reshape(width, -1, count)
    return np.concatenate([np.zeros((width, rows.shape[1], size + 1 - count)), rows], axis=2)
