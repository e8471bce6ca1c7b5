"""What the data and the design of a study say of its locations, before any scale is known.

Locations and subjects' effects follow from latents, all standard normal:

    own deviations    a columns in each of J environments, times their SDs tau
    rest              f fixed terms, then the slopes of M covariates; their columns hold prior SDs

A unit is the mean over n subjects of their means in a cell, times √n, or a row of trials about the
mean of their cell. Given the scales, the units of a pattern of subjects are

    y = X latents + Z b + noise

with X the columns of the latents, Z those of a subject's effects b, standard normal, and the noise
a small block D for each unit. Units of a kind have the same cell, group of trials and number of
trials, and so the same block. All sums over units that no scale enters are taken here, by kind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.blocks import Block
from percept.inference.model.design import Design, columns_by_quantity
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Covariates, Statistics, TrialScatter

__all__ = ["Rows"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Rows:
    """Units and columns of a study: P quantities, C cells, G patterns, J environments.

    Parameters
    ----------
    statistics : Statistics
        Cell means by pattern; its environments are the C cells.
    design : Design
        The columns.
    covariate_sd : float
        Prior SD of the slopes of covariates.

    Attributes
    ----------
    size, cells, environments, patterns : int
        Numbers P, C, J and G.
    locations, deviations : int
        Numbers R of locations, and a J of own deviations.
    own, fixed : ndarray
        Columns of own deviations, (a, P, C), and of fixed terms, (f, P, C).
    environment : ndarray of int
        Environment of each cell, (C,).
    basis : ndarray
        Locations by latents but for tau, (R, a J + r): cells, slopes, then fixed coefficients.
    pattern_of_subject : ndarray of int
        Pattern of each subject.
    trial_groups : ndarray of int
        Group of trials of each cell of each pattern, (C, G).
    pattern, cell, kind : ndarray of int
        Of each of the U units.
    data : ndarray
        Responses of the units, (P, U).
    columns : csr_array
        X without tau, (P U, a J + r).
    multipliers : ndarray
        What each unit multiplies effects by, (1 + m, U): one for a mean and zero for trials, and
        the values of each covariate of which subjects have slopes of their own.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        covariate_sd: float,
    ) -> None:
        self.size, self.cells = statistics.x.shape
        self.environments = len(design.cells.environments)
        self.environment = design.cells.environment
        self.patterns = len(statistics.patterns)
        self.own = columns_by_quantity(design.deviation, self.size, self.cells)
        self.fixed = columns_by_quantity(design.fixed, self.size, self.cells)
        self.deviations = len(self.own) * self.environments
        slopes = 0
        if statistics.covariates is not None:
            slopes = self.size * len(statistics.covariates.names)
        self.locations = self.size * self.cells + slopes + len(self.fixed)
        # Each step reads what those before it have set.
        self._set_units(statistics)
        self._set_kinds(statistics.scatter)
        self._set_basis(slopes, covariate_sd)
        self._set_columns(covariate_sd)
        self._set_products_of_latents()
        self._set_products_of_effects()

    def latent_sd(self, tau: Array) -> Array:
        """SDs of own deviations, and ones for the rest, whose columns hold them: (a J + r, W)."""
        own_sd = np.repeat(tau, self.environments, axis=0)
        _, latents = self.basis.shape
        rest_sd = np.ones((latents - self.deviations, tau.shape[-1]))
        return np.concatenate([own_sd, rest_sd])

    def noise(self, scales: CellScales) -> Block:
        """D of every kind, entries (kinds, W)."""
        between = scales.between[self._cell_of_kind]
        if scales.trial is None:
            return between
        if not self._kind_is_mean.all():
            between = between.scaled(self._kind_is_mean[:, None])
        trial = scales.trial[self._group_of_kind]
        of_a_mean = 1.0 / self._trials_of_kind[:, None]
        return between + trial.scaled(of_a_mean)

    def effects(self, scales: CellScales) -> list[tuple[int, Array]]:
        """Columns of effects by kind, (P, kinds, W) each, with the number of their multiplier."""
        at_kinds = scales.effects[:, :, self._cell_of_kind]
        columns = [(0, column) for column in at_kinds]
        for number, covariance in enumerate(scales.slopes):
            for root in covariance.factor_columns():
                of_quantities = np.stack(root)
                column = np.broadcast_to(of_quantities[:, None], at_kinds.shape[1:])
                columns.append((1 + number, column))
        return columns

    def _set_units(self, statistics: Statistics) -> None:
        """Line up the cell means of all patterns, then rows of trials."""
        pattern_of_unit = []
        cells = []
        trials = []
        root_subjects = []
        means = []
        self.pattern_of_subject = np.zeros(len(statistics.subjects), dtype=np.intp)
        for g, pattern in enumerate(statistics.patterns):
            units = len(pattern.environments)
            pattern_of_unit.append(np.full(units, g))
            cells.append(pattern.environments)
            trials.append(pattern.trials)
            root_subjects.append(np.full(units, np.sqrt(pattern.subjects)))
            means.append(pattern.mean)
            if statistics.subjects:
                self.pattern_of_subject[pattern.members] = g
        self.pattern = np.concatenate(pattern_of_unit)
        self.cell = np.concatenate(cells)
        self._trials = np.concatenate(trials)
        self._root_subjects = np.concatenate(root_subjects)
        self.data = self._root_subjects * np.concatenate(means, axis=1)
        self._unit_is_mean = np.ones(len(self.cell), dtype=bool)
        #: Of covariates, (M, U).
        self._covariate_values = np.zeros((0, len(self.cell)))
        within: list[int] = []
        covariates = statistics.covariates
        if covariates is not None:
            within = [covariates.names.index(name) for name in covariates.within]
            self._append_trials(statistics, covariates)
        of_means = self._unit_is_mean.astype(float)
        self.multipliers = np.concatenate([of_means[None], self._covariate_values[within]])

    def _append_trials(self, statistics: Statistics, covariates: Covariates) -> None:
        """Append rows of trials, and take the covariates: each pattern is a subject."""
        row_count = len(covariates.row_cell)
        members = [pattern.members for pattern in statistics.patterns]
        member_of_unit = np.concatenate(members)[self.pattern]
        values_of_means = covariates.mean[:, member_of_unit, self.cell]
        pattern_of_row = self.pattern_of_subject[covariates.row_subject]
        self.pattern = np.append(self.pattern, pattern_of_row)
        self.cell = np.append(self.cell, covariates.row_cell)
        self._trials = np.append(self._trials, np.ones(row_count))
        self._root_subjects = np.append(self._root_subjects, np.zeros(row_count))
        self._unit_is_mean = np.append(self._unit_is_mean, np.zeros(row_count, dtype=bool))
        self.data = np.hstack([self.data, covariates.row_responses])
        self._covariate_values = np.hstack([values_of_means, covariates.row_values])

    def _set_kinds(self, scatter: TrialScatter) -> None:
        """Give every kind of units a number."""
        groups = np.zeros((self.cells, self.patterns), dtype=np.intp)
        group_number = np.arange(len(scatter.cell))
        if scatter.subject is None:
            groups[scatter.cell] = group_number[:, None]
        else:
            patterns = self.pattern_of_subject[scatter.subject]
            groups[scatter.cell, patterns] = group_number
        self.trial_groups = groups
        of_units = groups[self.cell, self.pattern]
        labels = np.stack([self._unit_is_mean, self.cell, of_units, self._trials])
        labels_of_kind, kind = np.unique(labels, axis=1, return_inverse=True)
        self.kind = kind.ravel()
        self._kind_is_mean = labels_of_kind[0]
        self._cell_of_kind = labels_of_kind[1].astype(np.intp)
        self._group_of_kind = labels_of_kind[2].astype(np.intp)
        self._trials_of_kind = labels_of_kind[3]
        #: Means of each kind: degrees of freedom of trials are counted elsewhere.
        self.means_of_kind = np.bincount(self.kind) * self._kind_is_mean

    def _set_basis(self, slopes: int, covariate_sd: float) -> None:
        """Store the locations that latents make."""
        own_apart = self._apart(self.own, self.environment)
        of_cells = np.concatenate([own_apart, self.fixed])
        of_cells = of_cells.reshape(len(of_cells), -1).T
        cells, latents = of_cells.shape
        self.basis = np.zeros((self.locations, latents + slopes))
        self.basis[:cells, :latents] = of_cells
        end = cells + slopes
        self.basis[cells:end, latents:] = covariate_sd * np.eye(slopes)
        self.basis[end:, self.deviations : latents] = np.eye(len(self.fixed))

    def _set_columns(self, covariate_sd: float) -> None:
        """Store the columns of units."""
        quantities = covariate_sd * np.eye(self.size)
        of_slopes = np.einsum("mu,pq->mpqu", self._covariate_values, quantities)
        of_fixed = self.fixed[:, :, self.cell] * self._root_subjects
        #: Columns of the rest, (r, P, U), and of own deviations in any environment, (a, P, U).
        self._rest_of_units = np.concatenate([of_fixed, of_slopes.reshape(-1, *self.data.shape)])
        self._own_of_units = self.own[:, :, self.cell] * self._root_subjects
        own_apart = self._apart(self._own_of_units, self.environment[self.cell])
        columns = np.concatenate([own_apart, self._rest_of_units])
        self.columns = sparse.csr_array(columns.reshape(len(columns), -1).T)

    def _apart(self, columns: Array, environment: Indices) -> Array:
        """Columns (a, P, n) of own deviations, environment by environment: (a J, P, n)."""
        numbers = np.arange(self.environments)
        inside = np.equal.outer(numbers, environment)
        apart = columns[:, None] * inside[:, None]
        return apart.reshape(-1, *columns.shape[1:])

    def _set_products_of_latents(self) -> None:
        """Sum products of the latents' columns over the units of each kind, the data last."""
        kinds = len(self.means_of_kind)
        environment_of_kind = self.environment[self._cell_of_kind]
        rest = np.concatenate([self._rest_of_units, self.data[None]])
        one_group = np.zeros(kinds, dtype=np.intp)
        #: Times the parts of precisions of all kinds, these give the information of the latents.
        self.own_by_own = self._products(
            self._own_of_units, self._own_of_units, environment_of_kind
        )
        self.own_by_rest = self._products(self._own_of_units, rest, environment_of_kind)
        self.rest_by_rest = self._products(self._rest_of_units, rest, one_group)

    def _set_products_of_effects(self) -> None:
        """Sum products of multipliers, and of these with columns, by pattern and kind."""
        kinds = len(self.means_of_kind)
        #: By pairs of multipliers, sums over the units of a pattern and kind, (G, kinds).
        self.effects_by_effects = {}
        pattern_and_kind = self.pattern * kinds + self.kind
        for a, first in enumerate(self.multipliers):
            for b, second in enumerate(self.multipliers[: a + 1]):
                sums = np.bincount(pattern_and_kind, first * second, self.patterns * kinds)
                self.effects_by_effects[a, b] = sums.reshape(self.patterns, kinds)
        #: By multiplier, columns and data summed over units: (G (a J + r + 1), P kinds).
        columns = self.columns.toarray()
        data = self.data.reshape(-1, 1)
        with_data = sparse.coo_array(np.hstack([columns, data]))
        quantity, unit = np.divmod(with_data.row, len(self.kind))
        row = with_data.col * self.patterns + self.pattern[unit]
        column = quantity * kinds + self.kind[unit]
        shape = (with_data.shape[1] * self.patterns, self.size * kinds)
        self.effects_by_columns = []
        for multiplier in self.multipliers:
            multiplied = with_data.data * multiplier[unit]
            summed = sparse.csr_array((multiplied, (row, column)), shape)
            self.effects_by_columns.append(summed)

    def _products(
        self,
        first: Array,
        second: Array,
        group: Indices,
    ) -> sparse.csr_array:
        """Products (first, second, groups) of columns (k, P, U), by parts of precisions of kinds.

        A kind belongs to a group.
        """
        kinds = len(group)
        groups = group.max() + 1
        is_of_kind = np.equal.outer(self.kind, np.arange(kinds))
        to_kind = sparse.csr_array(is_of_kind.astype(float))
        # Entries of a precision: of the first quantity, of both, and of the second.
        products = np.einsum("apu,bqu->pqabu", first, second)
        parts = [products[0, 0]]
        if self.size == 2:
            parts += [products[0, 1] + products[1, 0], products[1, 1]]
        sums = [part.reshape(-1, len(self.kind)) @ to_kind for part in parts]
        by_kind = np.stack(sums)
        part, pair, kind = np.nonzero(by_kind)
        values = by_kind[part, pair, kind]
        row = pair * groups + group[kind]
        column = part * kinds + kind
        _, pairs, _ = by_kind.shape
        shape = (pairs * groups, len(parts) * kinds)
        return sparse.csr_array((values, (row, column)), shape=shape)
