"""Locations of a linear design by their information, all subject effects integrated out.

Given the scales, subject i has cell means m_i = A_i beta + Z b_i + noise, where noise has the
covariance D_i, a small block per cell, and b_i is standard normal. So V_i = D_i + ZZ', and

    V_i⁻¹ = D_i⁻¹ - H_i S_i⁻¹ H_i',   H_i = D_i⁻¹ Z,   S_i = I + Z'D_i⁻¹Z

The information on beta is the sum of A_i'V_i⁻¹A_i. D and H depend only on the kind of a cell, which
is the cell and its number of trials. Subjects with the same kinds share S: cost follows kinds and
patterns, and never trials. beta = B xi with xi standard normal, where B holds the design's columns
times their SDs; `CellLaw` gives the law of xi.

The difference loses digits where subject effects dwarf the rest. The pivots of the Cholesky factors
tell how many, and `sound` marks the draws that keep enough. Distances are sums of squares about the
fitted values in either case.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, cholesky
from percept.inference.hierarchy.covariates import Covariates
from percept.inference.hierarchy.design import Design
from percept.inference.hierarchy.information import (
    LEAST_PIVOT,
    lower_solve,
    precision_entries,
    upper_solve,
)
from percept.inference.hierarchy.log_linear import (
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)
from percept.inference.hierarchy.one_pattern import CellScales, SubjectCovariance
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["CellLaw", "CellProblem"]

Array = NDArray[np.float64]

#: Numbers in a temporary of a pass: more cost memory, and fewer cost calls.
_NUMBERS = 1 << 20
#: Draws of a pass, whatever the design.
_FEWEST_DRAWS = 8
_MOST_DRAWS = 512


@dataclasses.dataclass(frozen=True, eq=False)
class _Scatter:
    """Scatter between the subjects of one pattern, as rows without a mean."""

    cells: NDArray[np.intp]  # (E,)
    kinds: NDArray[np.intp]  # (E,) Of these cells
    rows: Array  # (n, P, E) Of responses
    slopes: Array  # (M P, n, P, E) Of what a slope of each covariate and quantity adds to them


class CellProblem:
    """What the data say of the locations before any scale is known.

    Parameters
    ----------
    statistics : Statistics
        Cell means by pattern; its environments are the C cells.
    design : Design
        The columns.
    covariate_sd : float
        Prior SD of the slopes of covariates.
    covariates : Covariates, optional
        Covariates of trials or subjects.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        covariate_sd: float,
        covariates: Covariates | None = None,
    ) -> None:
        patterns = statistics.patterns
        size, cells = statistics.x.shape
        self.size = size
        self.cells = cells
        kinds = set[tuple[int, float]]()
        for pattern in patterns:
            kinds.update(zip(pattern.environments.tolist(), pattern.trials.tolist(), strict=True))
        ordered = sorted(kinds)
        number = {kind: k for k, kind in enumerate(ordered)}
        self.cell_of_kind = np.array([cell for cell, _ in ordered])  # (K,)
        self.trials_of_kind = np.array([trials for _, trials in ordered])  # (K,)
        self.subjects = np.array([pattern.subjects for pattern in patterns], dtype=float)  # (G,)
        #: (C, G) Kind of each cell of a pattern; K where it has none.
        self.kind = np.full((cells, len(patterns)), len(ordered))
        mean = np.zeros((size, cells, len(patterns)))
        for g, pattern in enumerate(patterns):
            own = zip(pattern.environments.tolist(), pattern.trials.tolist(), strict=True)
            self.kind[pattern.environments, g] = [number[kind] for kind in own]
            mean[:, pattern.environments, g] = pattern.mean
        present = self.kind < len(ordered)
        #: (K, G) Whether a pattern has a cell of this kind.
        self.member = (self.kind == np.arange(len(ordered))[:, None, None]).any(axis=1) * 1.0
        weight = np.where(present, self.subjects, 0.0)
        # About the cells' means, so that a common offset does not enter the products.
        self.centre = (weight * mean).sum(axis=2) / weight.sum(axis=1)  # (P, C)
        self.mean = np.where(present, mean - self.centre[..., None], 0.0)  # (P, C, G)
        self._set_covariates(covariates, present)
        self._set_latents(design, covariate_sd)
        self._set_rows(statistics, covariates)
        # As if the patterns' means were what is observed, with covariances V/N.
        self.constant = 0.5 * size * float(np.log(self.subjects) @ present.sum(axis=0))

    def _set_covariates(self, covariates: Covariates | None, present: NDArray[np.bool_]) -> None:
        """Store the covariates' cell means (M, C, G), and their scatter within cells."""
        count = 0 if covariates is None else len(covariates.names)
        self.covariate_mean = np.zeros((count, *present.shape))
        #: (L, M, C) Rows of covariates whose products with themselves sum to their scatter.
        self.covariate_rows = np.zeros((0, count, self.cells))
        self.response_rows = np.zeros((0, self.size, self.cells))  # (L, P, C) Responses to them
        if covariates is not None:
            self.covariate_mean = np.where(present, covariates.mean, 0.0)
            self.covariate_rows = covariates.rows
            self.response_rows = covariates.responses

    def _set_latents(self, design: Design, covariate_sd: float) -> None:
        """Store the constant part of B, (R, Q), over cells and then over slopes of covariates."""
        of_cells: list[Array] = []
        tau: list[tuple[int, int]] = []
        for term in design.fixed:
            for column in term.columns:
                of_cells += [_of_quantity(column, p) for p in range(self.size)]
        self._fixed = len(of_cells)
        own = [column for term in design.own for column in term.columns]
        for number, column in enumerate(own):
            for p in range(self.size):
                for j in range(len(design.cells.environments)):
                    there = np.where(design.cells.environment == j, column, 0.0)
                    of_cells.append(_of_quantity(there, p))
                    tau.append((number, p))
        #: (2, latents with an estimated SD) Column of own terms and quantity of each.
        self._tau = np.array(tau, dtype=np.intp).reshape(-1, 2).T
        slopes = len(self.covariate_mean) * self.size
        locations = self.size * self.cells
        self.basis = np.zeros((locations + slopes, len(of_cells) + slopes))
        self.basis[:locations, : len(of_cells)] = np.stack(of_cells).reshape(-1, locations).T
        self.basis[locations:, len(of_cells) :] = covariate_sd * np.eye(slopes)

    def latent_sd(self, tau: Array) -> Array:
        """SDs (Q, W) of the latents' columns, from those of own deviations (o, P, W)."""
        sd = np.ones((self.basis.shape[1], tau.shape[-1]))
        number, quantity = self._tau
        if number.size:
            sd[self._fixed : self._fixed + number.size] = tau[number, quantity]
        return sd

    def _set_rows(self, statistics: Statistics, covariates: Covariates | None) -> None:
        """Store the scatter within patterns of several subjects."""
        self.scatter: list[_Scatter] = []
        for g, pattern in enumerate(statistics.patterns):
            if pattern.subjects == 1:
                continue
            rows = np.ascontiguousarray(pattern.rows.transpose(1, 0, 2))
            slopes = np.zeros((0, *rows.shape))
            if covariates is not None:
                of_covariates = covariates.between[g]
                slopes = np.zeros((of_covariates.shape[1], self.size, *rows.shape))
                for p in range(self.size):
                    slopes[:, p, :, p] = of_covariates.swapaxes(0, 1)
                slopes = slopes.reshape(-1, *rows.shape)
            kinds = self.kind[pattern.environments, g]
            self.scatter.append(_Scatter(pattern.environments, kinds, rows, slopes))

    def draws_per_pass(self, effects: int) -> int:
        """Draws worked on at once, for so many columns of subjects' effects."""
        numbers = self.size * self.cells * len(self.subjects) * effects
        return min(max(_NUMBERS // numbers, _FEWEST_DRAWS), _MOST_DRAWS)


class CellLaw:
    """Law of the locations at W sets of scales, and the density of all responses.

    Cells and slopes of covariates stand in one vector of R = P C + M P locations, cells first and
    quantity by quantity.
    """

    def __init__(self, problem: CellProblem, scales: CellScales) -> None:
        self._problem = problem
        self._trial = scales.trial
        kinds = scales.between[problem.cell_of_kind]
        if scales.trial is not None:
            share = 1.0 / problem.trials_of_kind[:, None]
            kinds = kinds + scales.trial[problem.cell_of_kind].scaled(share)
        self._kinds = kinds
        self._effects = scales.effects
        effects = scales.effects[:, :, problem.cell_of_kind]  # (q, P, K, W)
        precision = kinds.inverse()
        #: (q, P, K, W) H of the module's text.
        self._pulled = np.stack(precision.apply(tuple(np.moveaxis(effects, 1, 0))), axis=1)
        products = np.einsum("apkw,bpkw->abkw", effects, self._pulled)
        together = problem.member.T @ products
        count = len(together)
        together[np.arange(count), np.arange(count)] += 1.0
        self._factor = lower_factor(together)  # (q, q, G, W) of S
        self._solve(precision, problem.latent_sd(scales.tau))

    def _solve(self, precision: Block, latent_sd: Array) -> None:
        """Find the law of the latents, and the log density."""
        problem = self._problem
        information, target, before = self._information(precision)
        # B = basis times latent_sd, so the sums over cells need one product with a constant.
        basis = problem.basis
        width, count, _ = information.shape
        half = (information.reshape(-1, count) @ basis).reshape(width, count, -1)
        matrix = half.swapaxes(1, 2).reshape(-1, count) @ basis
        matrix = matrix.reshape(width, basis.shape[1], -1)
        sd = latent_sd.T
        matrix *= sd[:, :, None] * sd[:, None, :]
        diagonal = np.arange(matrix.shape[1])
        matrix[:, diagonal, diagonal] += 1.0
        right = (target @ basis) * sd
        self._sd = sd
        self._lower = cholesky(matrix)
        pivots = np.einsum("wii->wi", self._lower)
        most = 1.0 + sd**2 * (before @ basis**2)
        #: (W,) Whether enough digits are left.
        self.sound = (pivots * pivots >= LEAST_PIVOT * most).all(axis=1)
        self._whitened = lower_solve(self._lower, right)  # (W, Q)
        latents = upper_solve(self._lower, self._whitened)
        #: (W, R) Mean of the locations.
        self.mean = (latents * sd) @ basis.T
        self.log_density = problem.constant - 0.5 * (
            self._determinant() + self._distance() + np.einsum("wq,wq->w", latents, latents)
        )
        self.log_density -= np.log(pivots).sum(axis=1)

    def _information(self, precision: Block) -> tuple[Array, Array, Array]:
        """Information (W, R, R), its product with the data (W, R), and its diagonal by cells."""
        problem = self._problem
        size, cells = problem.size, problem.cells
        per_kind = precision_entries(precision)  # (P, P, K, W)
        width = per_kind.shape[-1]
        slopes = len(problem.covariate_mean) * size
        count = size * cells + slopes
        # Cells, slopes and the data's means are columns of one matrix, whose products are wanted.
        information = np.zeros((width, count + 1, count + 1))
        self._add_diagonal(information, per_kind)
        before = np.einsum("wii->wi", information)[:, :-1].copy()
        root = np.sqrt(problem.subjects)[:, None]
        taken = self._taken() * root  # (q, count + 1, G, W)
        flat = taken.transpose(3, 1, 0, 2).reshape(width, count + 1, -1)
        information -= flat @ flat.swapaxes(1, 2)
        if slopes:
            for scatter, covariance in zip(problem.scatter, self._scatters, strict=True):
                self._add_between(information, scatter, covariance, per_kind)
        centre = np.concatenate([problem.centre.ravel(), np.zeros(slopes)])
        target = information[:, :-1, -1] + information[:, :-1, :-1] @ centre
        return information[:, :-1, :-1], target, before

    @cached_property
    def _pulled_by_pattern(self) -> Array:
        """H of every pattern's cells, zero where it has none, (q, P, C, G, W)."""
        nothing = np.zeros_like(self._pulled[:, :, :1])
        padded = np.concatenate([self._pulled, nothing], axis=2)
        return padded[:, :, self._problem.kind]

    def _taken(self) -> Array:
        """L⁻¹H' of cells, slopes and the data's means, (q, R + 1, G, W), S = LL'."""
        problem = self._problem
        of_cells = self._pulled_by_pattern
        count, size, cells, patterns, width = of_cells.shape
        data = np.einsum("qpcgw,pcg->qgw", of_cells, problem.mean)
        slopes = np.einsum("qpcgw,mcg->qmpgw", of_cells, problem.covariate_mean)
        right = np.concatenate(
            [
                of_cells.reshape(count, size * cells, patterns, width),
                slopes.reshape(count, -1, patterns, width),
                data[:, None],
            ],
            axis=1,
        )
        return solve_lower(self._factor[:, :, None], right)

    def _add_diagonal(self, information: Array, per_kind: Array) -> None:
        """Add what cells say by themselves: sums of D⁻¹ over subjects, and scatter within cells."""
        problem = self._problem
        size, cells = problem.size, problem.cells
        in_cell = (problem.cell_of_kind == np.arange(cells)[:, None]) * 1.0  # (C, K)
        by_subjects = problem.member * problem.subjects  # (K, G)
        index = np.arange(problem.cells)
        means = problem.mean[:, problem.cell_of_kind] * by_subjects  # (P, K, G)
        covariates = problem.covariate_mean[:, problem.cell_of_kind] * problem.member
        last = information.shape[1] - 1
        for p in range(size):
            for q in range(size):
                own = in_cell @ (by_subjects.sum(axis=1)[:, None] * per_kind[p, q])  # (C, W)
                information[:, p * cells + index, q * cells + index] += own.T
                pulled = in_cell @ (means[q].sum(axis=1)[:, None] * per_kind[p, q])
                information[:, p * cells + index, last] += pulled.T
                for m, covariate in enumerate(covariates):
                    slope = size * cells + m * size + q
                    weighted = (covariate * by_subjects).sum(axis=1)
                    joint = (in_cell @ (weighted[:, None] * per_kind[p, q])).T
                    information[:, p * cells + index, slope] += joint
                    information[:, slope, p * cells + index] += joint
                    row = size * cells + m * size + p
                    data = (covariate * means[q]).sum(axis=1)
                    information[:, row, last] += data @ per_kind[p, q]
                    for n, other in enumerate(covariates):
                        column = size * cells + n * size + q
                        both = (covariate * other * by_subjects).sum(axis=1)
                        information[:, row, column] += both @ per_kind[p, q]
        if self._trial is not None and len(problem.covariate_rows):
            self._add_scatter(information, precision_entries(self._trial.inverse()))

    def _add_scatter(self, information: Array, per_cell: Array) -> None:
        """Add what trials of one cell say of the slopes."""
        problem = self._problem
        size = problem.size
        first = size * problem.cells
        products = np.einsum("lmc,lnc->mnc", problem.covariate_rows, problem.covariate_rows)
        responses = np.einsum("lmc,lpc->mpc", problem.covariate_rows, problem.response_rows)
        for m, n in np.ndindex(products.shape[:2]):
            for p, q in np.ndindex(size, size):
                added = products[m, n] @ per_cell[p, q]
                information[:, first + m * size + p, first + n * size + q] += added
        for m in range(len(products)):
            for p, q in np.ndindex(size, size):
                added = responses[m, q] @ per_cell[p, q]
                information[:, first + m * size + p, -1] += added

    def _add_between(
        self, information: Array, scatter: _Scatter, covariance: SubjectCovariance, per_kind: Array
    ) -> None:
        """Add what the scatter between subjects of one pattern says of the slopes."""
        columns = np.concatenate([scatter.slopes, scatter.rows[None]])  # (M P + 1, n, P, E)
        count = len(columns)
        # Products by D⁻¹, less those that the subjects' effects explain.
        products = np.einsum("anpe,bnqe->abpqe", columns, columns).reshape(count * count, -1)
        precision = per_kind[:, :, scatter.kinds].reshape(products.shape[1], -1)
        added = (products @ precision).reshape(count, count, -1)
        towards = covariance.towards(columns.reshape(-1, *columns.shape[2:]))
        explained = towards.reshape(len(towards), count, -1, towards.shape[-1])
        added -= np.einsum("qanw,qbnw->abw", explained, explained)
        information[:, -count:, -count:] += np.moveaxis(added, -1, 0)

    @cached_property
    def _scatters(self) -> list[SubjectCovariance]:
        """Covariance of the subjects of each pattern with scatter."""
        return [
            SubjectCovariance(self._kinds[scatter.kinds], self._effects[:, :, scatter.cells])
            for scatter in self._problem.scatter
        ]

    def _determinant(self) -> Array:
        """Log determinants of all subjects' covariances, summed."""
        problem = self._problem
        subjects_of_kind = problem.member @ problem.subjects
        value = subjects_of_kind @ self._kinds.log_determinant()
        return np.asarray(value + 2.0 * problem.subjects @ log_diagonal(self._factor))

    def _distance(self) -> Array:
        """Squares of responses about their fitted values, whitened and summed."""
        problem = self._problem
        size, cells = problem.size, problem.cells
        width = len(self.mean)
        beta = self.mean[:, : size * cells].T.reshape(size, cells, 1, width)
        slopes = self.mean[:, size * cells :].T.reshape(-1, size, width)
        apart = problem.mean[..., None] - (beta - problem.centre[..., None, None])
        apart = apart - np.einsum("mcg,mpw->pcgw", problem.covariate_mean, slopes)
        total = problem.subjects @ self._mean_squares(apart)
        flat_slopes = slopes.reshape(-1, width)
        for scatter, covariance in zip(problem.scatter, self._scatters, strict=True):
            rows = scatter.rows[..., None]
            if len(flat_slopes):
                rows = rows - np.einsum("snpe,sw->npew", scatter.slopes, flat_slopes)
            total = total + covariance.scatter_distance(rows)
        if self._trial is not None and len(problem.covariate_rows):
            fitted = np.einsum("lmc,mpw->lpcw", problem.covariate_rows, slopes)
            left = problem.response_rows[..., None] - fitted
            total = total + self._trial.distance(tuple(left.swapaxes(0, 1))).sum(axis=0)
        return np.asarray(total)

    def _mean_squares(self, apart: Array) -> Array:
        """r'V⁻¹r of one vector of each pattern, (P, C, G, W), as sums of squares: (G, W)."""
        kind = self._problem.kind
        towards = np.einsum("qpcgw,pcgw->qgw", self._pulled_by_pattern, apart)
        effect = solve_upper(self._factor, solve_lower(self._factor, towards))
        left = apart
        for column, size in zip(self._effects, effect, strict=True):
            left = left - column[:, :, None] * size
        present = kind < len(self._problem.cell_of_kind)
        left = left * present[..., None]
        noise = self._kinds[np.where(present, kind, 0)]
        squares = noise.distance(tuple(part[None] for part in left)).sum(axis=0)
        return np.asarray(squares + np.einsum("qgw,qgw->gw", effect, effect))

    @cached_property
    def columns(self) -> Array:
        """Columns (W, R, Q) whose products sum to the covariance of the locations."""
        inverse = np.linalg.inv(self._lower)  # (W, Q, Q)
        scaled = inverse * self._sd[:, None, :]
        return np.asarray(self._problem.basis @ scaled.swapaxes(1, 2))


def _of_quantity(column: Array, p: int) -> Array:
    """Column (P, C) that enters one quantity alone."""
    alone = np.zeros_like(column)
    alone[p] = column[p]
    return alone
