"""Density of one subject's data: given the locations, and given everybody else's data.

Subjects are what a study samples, so a subject is what is left out. Given locations and scales the
subjects are independent; with the locations integrated out, a subject's predictive law given the others
follows from the conditional law N(m, C) of the locations given everybody. With V the covariance of the
subject's cell means y about the locations,

    y | others ~ N(y - V S⁻¹(y - m), V S⁻¹ V),    S = V - C,

so nothing is fitted anew: S has one factor per pattern of trial counts, whoever is left out.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.inference.hierarchy.blocks import Block, Pair
from percept.inference.hierarchy.conditional import Conditional
from percept.inference.hierarchy.covariance import SharedCovariance
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.statistics import Pattern

__all__ = ["LeftOut", "SubjectDensity", "batches"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
_LOG_2PI = math.log(2.0 * math.pi)
#: Numbers in the largest temporary of a batch of draws.
_BATCH = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False)
class LeftOut:
    """What W sets of scales and the other subjects' data say of the I subjects asked for.

    Attributes
    ----------
    log_density : ndarray, shape (W, I)
        Of the subject's trials, on the response scale.
    distance : ndarray, shape (W, I)
        Squared Mahalanobis distance of the subject's cell means; chi-squared under the model, with as many
        degrees of freedom as the subject has cells and parameters.
    standard : ndarray, shape (W, I, P, J)
        Each cell mean less its predictive mean, in predictive SDs; NaN where there is none.
    """

    log_density: Array
    distance: Array
    standard: Array


class SubjectDensity:
    """Densities of subjects' data under a hierarchical model.

    Parameters
    ----------
    density : CollapsedDensity
        The model, with the statistics of all subjects.
    response : ndarray, shape (M, P)
        Unit-free responses the statistics were made from.
    subject, environment : ndarray of int, shape (M,)
        Their subjects and environments, as codes.
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
        self._trials = _trial_scatter(response - self._means[subject, :, environment], cell, cells)
        self._trials = [part.reshape(subjects, self.environments) for part in self._trials]

    @property
    def subjects(self) -> int:
        """Number of subjects."""
        return len(self._means)

    @property
    def degrees(self) -> Array:
        """Numbers a subject contributes: cells times parameters, shape (N,)."""
        return (self._counts > 0).sum(axis=1) * float(self.parameters)

    def given_locations(self, scales: Scales, beta: Array) -> Array:
        """Log density of each subject's trials given locations and scales, its own effects integrated out.

        Parameters
        ----------
        scales : Scales
            W sets of scales.
        beta : ndarray, shape (P, J, W)
            Locations on the response scale.

        Returns
        -------
        ndarray, shape (W, N)
        """
        value = np.empty((beta.shape[-1], self.subjects))
        for pattern, cell in zip(
            self.density.statistics.patterns, self.density.cell_blocks(scales), strict=True
        ):
            covariance = SharedCovariance(cell, scales.shared)
            apart = [
                self._means[pattern.members, p][:, pattern.environments, None] - beta[p, pattern.environments]
                for p in range(self.parameters)
            ]
            squares = sum(
                np.square(component).reshape(pattern.subjects, -1, component.shape[-1]).sum(axis=1)
                for piece in covariance.whiten(tuple(apart))
                for component in piece
            )
            value[:, pattern.members] = -0.5 * (squares + covariance.log_determinant()).T
        return value + self._between_trials(scales, slice(None)) - 0.5 * _LOG_2PI * self.degrees

    def left_out(self, scales: Scales, members: Indices | None = None) -> LeftOut:
        """Predictive law of each subject's data given scales and the other subjects' data.

        Parameters
        ----------
        scales : Scales
            W sets of scales.
        members : ndarray of int, shape (I,), optional
            Subjects wanted, in ascending order; all by default.

        Returns
        -------
        LeftOut

        Raises
        ------
        RefusalError
            Where double precision cannot tell the subject's share of what is known of a location.
        """
        wanted = np.arange(self.subjects) if members is None else members
        law = Conditional(self.density, scales)
        mean, joint = np.stack(law.mean), law.joint_covariance()
        width = scales.log_prior.size
        found = LeftOut(
            np.empty((width, wanted.size)),
            np.empty((width, wanted.size)),
            np.full((width, wanted.size, self.parameters, self.environments), np.nan),
        )
        for pattern, cell in zip(
            self.density.statistics.patterns, self.density.cell_blocks(scales), strict=True
        ):
            at = np.flatnonzero(np.isin(wanted, pattern.members))
            if at.size:
                apart = (
                    self._means[wanted[at]][..., pattern.environments, None] - mean[:, pattern.environments]
                )
                self._leave_out(found, at, pattern, cell, scales.shared, apart, joint)
        found.log_density[...] += self._between_trials(scales, wanted) - 0.5 * _LOG_2PI * self.degrees[wanted]
        return found

    def _leave_out(
        self,
        found: LeftOut,
        at: Indices,
        pattern: Pattern,
        cell: Block,
        shared: Block | None,
        apart: Array,
        joint: Array,
    ) -> None:
        covariance = dense(cell, shared)
        cells = (np.arange(self.parameters)[:, None] * self.environments + pattern.environments).ravel()
        try:
            factor = np.linalg.cholesky(covariance - joint[:, cells[:, None], cells])
        except np.linalg.LinAlgError:
            raise RefusalError(
                "what the others say of a subject cannot be told in double precision: what is known of some "
                "environment rests on one subject alone, whose scatter is below 1e-7 of the prior's.",
                hint="Leave that environment out, or ask for no model checks.",
            ) from None
        residual = apart.reshape(at.size, cells.size, -1).transpose(2, 1, 0)
        solved = np.linalg.solve(factor, np.concatenate([residual, covariance], axis=2))
        whitened, root = solved[..., : at.size], solved[..., at.size :]
        distance = np.square(whitened).sum(axis=1)
        log_factor = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        log_determinant = 2.0 * SharedCovariance(cell, shared).log_determinant() - 2.0 * log_factor
        found.log_density[:, at] = -0.5 * (log_determinant[:, None] + distance)
        found.distance[:, at] = distance
        sd = np.sqrt(np.square(root).sum(axis=1))
        standard = np.matmul(root.transpose(0, 2, 1), whitened) / sd[..., None]
        shape = (len(factor), self.parameters, pattern.environments.size, at.size)
        found.standard[:, at[:, None], :, pattern.environments] = standard.reshape(shape).transpose(
            3, 2, 0, 1
        )

    def _between_trials(self, scales: Scales, members: Indices | slice) -> Array | float:
        """Log density of trials about their cell means, and of turning means into trials: (W, I) or zero."""
        trial = self.density.trial_block(scales)
        if trial is None:
            return 0.0
        counts = self._counts[members]
        first, slope, left = (part[members][..., None] for part in self._trials)
        if isinstance(trial, Pair):
            tilt = slope - trial.g
            squares = (first / trial.v + (left + first * tilt * tilt) / trial.w).sum(axis=1)
        else:
            squares = (first / trial.v).sum(axis=1)
        extra = np.maximum(counts - 1.0, 0.0)
        constant = self.parameters * (
            extra.sum(axis=1) * _LOG_2PI + np.log(np.maximum(counts, 1)).sum(axis=1)
        )
        return -0.5 * (squares + extra @ trial.log_determinant() + constant[:, None]).T


def dense(cell: Block, shared: Block | None) -> Array:
    """Covariance of a subject's cell means, parameter-major: (W, P E, P E) from entries (E, W) and (W,)."""
    environments, width = cell.diagonal()[0].shape
    size = len(cell.diagonal())
    full = np.zeros((width, size, environments, size, environments))
    at = np.arange(environments)
    for column in cell.factor_columns():
        for p, first in enumerate(column):
            for q, second in enumerate(column):
                full[:, p, at, q, at] += (first * second).T
    for column in shared.factor_columns() if shared is not None else ():
        for p, first in enumerate(column):
            for q, second in enumerate(column):
                full[:, p, :, q, :] += (first * second)[:, None, None]
    return full.reshape(width, size * environments, size * environments)


def batches(draws: int, density: SubjectDensity) -> Iterator[slice]:
    """Cut draws so that temporaries stay small, however many subjects and environments there are."""
    cells = density.parameters * density.environments
    step = max(1, _BATCH // (cells * (density.subjects + 4 * cells)))
    for start in range(0, draws, step):
        yield slice(start, min(start + step, draws))


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
