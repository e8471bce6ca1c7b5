"""Density of one subject's data given everybody else's.

Subjects are what a study samples, so a subject is what is left out. Given locations and scales the
subjects are independent; with the locations integrated out, a subject's predictive law given the
others follows from the conditional law N(m, BB') of the locations given everybody. With V the
covariance of the subject's cell means y about the locations, G = V^(-1/2) B and r = y - m,

    y | others ~ N(m - B K⁻¹ B'V⁻¹ r, V + B K⁻¹ B'),    K = I - G'G,

so no fit is repeated. K is near (1 - 1/N) I whatever the scales; V - BB', its other form, would
lose all digits where the subject effect dwarfs the rest.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, SharedCovariance
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.scales import Scales

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
_LOG_2PI = math.log(2.0 * math.pi)
#: Numbers in the largest temporary of a batch of draws.
_BATCH = 1 << 20
#: Smallest eigenvalue of K, which is 1 - 1/N or so, that is not rounding.
_LEAST = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class LeftOut:
    """What W sets of scales and the other subjects' data say of each of N subjects.

    All NaN at scales for which doubles cannot tell a subject's share of what is known of a
    location: a scatter below some 1e-7 of the locations' prior.
    """

    log_density: Array  # (W, N) Of the subject's trials, on the response scale
    distance: Array  # (W, N) Squared Mahalanobis distance of the subject's cell means
    standard: Array  # (W, N, P, J) Each cell mean less its predictive mean, in predictive SDs


class SubjectDensity:
    """Densities of subjects' data under a hierarchical model.

    Responses are (trials, P), subject and environment of each trial are indices (trials,).
    """

    def __init__(
        self, density: CollapsedDensity, response: Array, subject: Indices, environment: Indices
    ) -> None:
        self.density = density
        statistics = density.statistics
        self._means = statistics.cell_means
        subjects, self.parameters, self.environments = self._means.shape
        cell = subject * self.environments + environment
        cells = subjects * self.environments
        self._counts = np.bincount(cell, minlength=cells).reshape(subjects, self.environments)
        scatter = _trial_scatter(response - self._means[subject, :, environment], cell, cells)
        self._trials = [part.reshape(subjects, self.environments) for part in scatter]

    @property
    def subjects(self) -> int:
        """Number of subjects."""
        return len(self._means)

    @property
    def degrees(self) -> Array:
        """Numbers a subject contributes: cells times parameters, shape (N,)."""
        return (self._counts > 0).sum(axis=1) * float(self.parameters)

    def batches(self, points: Array) -> Iterator[tuple[slice, Scales]]:
        """Cut draws (S, d), with the scales of each cut: temporaries stay small in studies of any size."""
        cells = self.parameters * self.environments
        step = max(1, _BATCH // (cells * (self.subjects + 4 * cells)))
        for start in range(0, len(points), step):
            cut = slice(start, min(start + step, len(points)))
            yield cut, self.density.layout.scales(np.ascontiguousarray(points[cut].T))

    def left_out(self, scales: Scales) -> LeftOut:
        """Predictive law of each subject's data given scales and the other subjects' data."""
        law = self.density.locations(scales)
        mean, columns = np.stack(law.mean), law.columns()
        width = scales.log_prior.size
        predicted = LeftOut(
            np.empty((width, self.subjects)),
            np.empty((width, self.subjects)),
            np.full((width, *self._means.shape), np.nan),
        )
        cells = self.density.cell_blocks(scales)
        for pattern, cell in zip(self.density.statistics.patterns, cells, strict=True):
            at, present = pattern.members, pattern.environments
            apart = self._means[at][..., present, None] - mean[:, present]
            _leave_out(predicted, at, present, apart, columns[:, :, present], cell, scales.shared)
        predicted.log_density[...] += self._between_trials(scales) - 0.5 * _LOG_2PI * self.degrees
        return predicted

    def _between_trials(self, scales: Scales) -> Array | float:
        """Log density of trials about their cell means, and of turning means into trials: (W, N) or zero."""
        trial = self.density.trial_block(scales)
        if trial is None:
            return 0.0
        counts = self._counts
        first, slope, left = (part[..., None] for part in self._trials)
        squares = first / trial.variances[0]
        if trial.slope is not None:
            tilt = slope - trial.slope
            squares = squares + (left + first * tilt * tilt) / trial.variances[1]
        extra = np.maximum(counts - 1.0, 0.0)
        constant = self.parameters * (
            extra.sum(axis=1) * _LOG_2PI + np.log(np.maximum(counts, 1)).sum(axis=1)
        )
        return -0.5 * (squares.sum(axis=1) + extra @ trial.log_determinant() + constant[:, None]).T


def _leave_out(
    predicted: LeftOut,
    at: Indices,
    present: Indices,
    apart: Array,
    columns: Array,
    cell: Block,
    shared: Block | None,
) -> None:
    """Fill in the subjects of one pattern: `apart` (I, P, E, W) and `columns` (R, P, E, W) are r and B."""
    covariance = SharedCovariance(cell, shared)
    whitened, g = _whitened(covariance, apart), _whitened(covariance, columns)
    factor, lost = _factor(np.eye(len(columns)) - np.matmul(g.transpose(0, 2, 1), g))
    flat = columns.reshape(len(columns), -1, columns.shape[-1]).transpose(2, 0, 1)
    right = np.concatenate([np.matmul(g.transpose(0, 2, 1), whitened), flat], axis=2)
    solved = np.linalg.solve(factor, right)
    shift, root = solved[..., : at.size], solved[..., at.size :]
    distance = np.square(whitened).sum(axis=1) + np.square(shift).sum(axis=1)
    log_diagonal = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    log_determinant = covariance.log_determinant() - 2.0 * log_diagonal
    predicted.log_density[:, at] = -0.5 * (log_determinant[:, None] + distance)
    predicted.distance[:, at] = distance
    variances = [cell.diagonal()] if shared is None else [cell.diagonal(), shared.diagonal()]
    own = np.stack(
        [np.broadcast_to(sum(parts), apart.shape[2:]) for parts in zip(*variances, strict=True)]
    )
    shape = (len(factor), *apart.shape[1:3], -1)
    off = apart.transpose(3, 1, 2, 0) + np.matmul(root.transpose(0, 2, 1), shift).reshape(shape)
    variance = own.transpose(2, 0, 1) + np.square(root).sum(axis=1).reshape(shape[:3])
    standard = off / np.sqrt(variance)[..., None]
    predicted.standard[:, at[:, None], :, present] = standard.transpose(3, 2, 0, 1)
    for values in (predicted.log_density, predicted.distance, predicted.standard):
        values[np.ix_(lost, at)] = np.nan


def _factor(matrices: Array) -> tuple[Array, Indices]:
    """Lower factors of (W, R, R) matrices, and the indices of those that rounding left without one."""
    lost: Indices = np.empty(0, dtype=np.intp)
    try:
        factor = np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        lost = np.flatnonzero(~(np.linalg.eigvalsh(matrices)[:, 0] > _LEAST))
        matrices[lost] = np.eye(matrices.shape[-1])
        factor = np.linalg.cholesky(matrices)
    return np.asarray(factor, dtype=float), lost


def _whitened(covariance: SharedCovariance, vectors: Array) -> Array:
    """Rows of V^(-1/2) times vectors (n, P, E, W): (W, rows, n)."""
    count, width = len(vectors), vectors.shape[-1]
    pieces = covariance.whiten(tuple(vectors.transpose(1, 0, 2, 3)))
    rows = [part.reshape(count, -1, width) for piece in pieces for part in piece]
    return np.concatenate(rows, axis=1).transpose(2, 1, 0)


def _trial_scatter(deviation: Array, cell: Indices, cells: int) -> list[Array]:
    """Scatter between trials per cell: of the first parameter, slope of the second on it, what is left."""

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(cell, weights=values, minlength=cells), dtype=float)

    first = total(deviation[:, 0] ** 2)
    if deviation.shape[1] == 1:
        return [first, np.zeros(cells), np.zeros(cells)]
    cross = total(deviation[:, 0] * deviation[:, 1])
    slope = np.divide(cross, first, out=np.zeros(cells), where=first > 0)
    return [first, slope, total((deviation[:, 1] - slope[cell] * deviation[:, 0]) ** 2)]
