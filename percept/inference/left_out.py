"""Density of one subject's data given the data of all others.

A study samples subjects, so it is subjects that are left out. Given locations and scales they are
independent. With the locations integrated out, a subject's predictive law given the others follows
from N(m, BB'), the law of the locations given all data. Let V be the covariance of the subject's
cell means y about the locations, G = V^(-1/2) B and r = y - m. Then

    y | others ~ N(m - B K⁻¹ B'V⁻¹ r, V + B K⁻¹ B'),    K = I - G'G,

so no fit is repeated. Where all subjects have the same cells, the eigenvalues of K lie between
1 - 1/N and 1 whatever the scales; they fall towards zero where a location rests on one subject. The
other form, V - BB', would lose all digits where the subject effect is far larger than the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import Block
from percept.inference.model.model import LinearModel
from percept.inference.model.predictions import SubjectLaws, subject_laws
from percept.inference.model.statistics import trial_scatter

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LOG_2PI = math.log(2.0 * math.pi)
#: Draws times cells of subjects that leaving out rests on, at most; and draws that weights need.
_MOST_NUMBERS = 1 << 20
_FEWEST_DRAWS = 500


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Predictions of N subjects, each from the others' data, at W sets of scales.

    Those of subjects with the same cells are NaN at all draws of a pass if a location rests on one
    of them alone and, at one draw, scatter is below some 1e-7 of the locations' prior: what this
    subject tells then rounds to all there is.
    """

    log_density: Array  # (W, N) Of the subject's trials, on the response scale
    distance: Array  # (W, N) Squared Mahalanobis distance of the subject's cell means
    standard: Array  # (W, N, P, J) Each cell mean less its predictive mean, in predictive SDs
    location: Array  # (W, N, P, J) Mean of every location
    location_sd: Array  # (W, N, P, J) Its SD
    covariance: Array  # (W, N, J) Between the locations of the first and the last quantity


class SubjectDensity:
    """Densities of subjects' data under a hierarchical model.

    Parameters
    ----------
    density : LinearModel
        The model.
    response : ndarray
        One row per trial, on the response scale, shape (trials, P).
    subject, environment : ndarray of int
        Number of the subject and of the environment of each trial, shape (trials,).
    """

    def __init__(
        self,
        density: LinearModel,
        response: Array,
        subject: Indices,
        environment: Indices,
    ) -> None:
        self.density = density
        self._means = density.statistics.cell_means
        _, self.parameters, self.environments = self._means.shape
        self._scatter = None
        if density.statistics.repeats:
            self._scatter = trial_scatter(response, subject, environment)

    @property
    def subjects(self) -> int:
        """Number of subjects."""
        return len(self._means)

    @property
    def degrees(self) -> Array:
        """Numbers a subject contributes: cells times parameters, shape (N,)."""
        return np.isfinite(self._means).sum(axis=(1, 2), dtype=float)

    def laws(self, points: Array) -> Iterator[SubjectLaws]:
        """Yield the laws at draws (S, d), pass by pass."""
        for part in self.density.passes(points):
            yield subject_laws(self.density, part)

    @property
    def most_draws(self) -> int:
        """Draws that leaving subjects out is to rest on: fewer of large studies."""
        return max(_MOST_NUMBERS // self._means.size, _FEWEST_DRAWS)

    def left_out(self, points: Array) -> LeftOut:
        """Predict each subject's data from draws of the scales, (W, d), and the others' data."""
        passes = [vars(self._predicted(laws)).values() for laws in self.laws(points)]
        return LeftOut(*(np.concatenate(parts) for parts in zip(*passes, strict=True)))

    def _predicted(self, laws: SubjectLaws) -> LeftOut:
        """Predict at the draws of some laws."""
        *by_cell, width = laws.mean.shape
        by_subject = (width, self.subjects)
        predicted = LeftOut(
            log_density=np.empty(by_subject),
            distance=np.empty(by_subject),
            standard=np.full((*by_subject, *by_cell), np.nan),
            location=np.empty((*by_subject, *by_cell)),
            location_sd=np.empty((*by_subject, *by_cell)),
            covariance=np.empty((*by_subject, self.environments)),
        )
        flat = laws.columns.reshape(len(laws.columns), -1, width).transpose(2, 0, 1)
        for g, pattern in enumerate(self.density.statistics.patterns):
            members = pattern.members
            present = pattern.environments
            covariance = laws.covariances[g]
            means = self._means[members]
            residual = means[..., present, None] - laws.mean[:, present]
            whitened = covariance.whiten(residual).T
            columns = covariance.whiten(laws.columns[:, :, present]).T
            transposed = columns.transpose(0, 2, 1)
            factor = _factor(np.eye(len(laws.columns)) - transposed @ columns)
            right = np.concatenate([transposed @ whitened, flat], axis=2)
            solved = np.linalg.solve(factor, right)
            shift = solved[..., : len(members)]
            root = solved[..., len(members) :]
            distance = _squares(whitened) + _squares(shift)
            diagonal = np.diagonal(factor, axis1=1, axis2=2)
            log_determinant = covariance.log_determinant - 2.0 * np.log(diagonal).sum(axis=1)
            predicted.log_density[:, members] = -0.5 * (log_determinant[:, None] + distance)
            predicted.distance[:, members] = distance
            learned = (shift.transpose(0, 2, 1) @ root).reshape(width, len(members), *by_cell)
            location = laws.mean.transpose(2, 0, 1)[:, None] - learned
            predicted.location[:, members] = location
            given = _squares(root).reshape(-1, *by_cell)
            predicted.location_sd[:, members] = np.sqrt(given)[:, None]
            first = root[..., : self.environments]
            last = root[..., -self.environments :]
            predicted.covariance[:, members] = (first * last).sum(axis=1)[:, None]
            noise = np.square(covariance.noise.factor_columns()).sum(axis=0)
            shared = np.square(laws.scales.effects[:, :, present]).sum(axis=0)
            variance = (noise + shared).transpose(2, 0, 1) + given[..., present]
            difference = means[:, :, present] - location[..., present]
            standard = difference / np.sqrt(variance)[:, None]
            # numpy puts the axes of two lists of indices first.
            rows = members[:, None]
            predicted.standard[:, rows, :, present] = standard.transpose(1, 3, 0, 2)
        trials = self._between_trials(laws.scales.trial) - 0.5 * _LOG_2PI * self.degrees
        predicted.log_density[...] += trials
        return predicted

    def _between_trials(self, groups: Block | None) -> Array | float:
        """Log density of trials about their cell means, (W, N); zero without repeats."""
        scatter = self._scatter
        if groups is None or scatter is None:
            return 0.0
        of_model = self.density.statistics.group
        subject = np.asarray(scatter.subject)
        trial = groups[of_model[subject, scatter.cell]]  # (T, W)
        minus_twice = scatter.minus_twice_log_density(trial)
        constant = scatter.df * _LOG_2PI + np.log(scatter.df + 1.0)
        minus_twice += self.parameters * constant[:, None]
        return -0.5 * (minus_twice.T @ np.equal.outer(subject, np.arange(self.subjects)))


def _squares(columns: Array) -> Array:
    """Sum squares over the second axis."""
    return np.einsum("wrc,wrc->wc", columns, columns)


def _factor(matrices: Array) -> Array:
    """Lower factors of matrices (W, R, R); NaN where rounding leaves one of them singular."""
    try:
        return np.asarray(np.linalg.cholesky(matrices))
    except np.linalg.LinAlgError:
        return np.full_like(matrices, np.nan)
