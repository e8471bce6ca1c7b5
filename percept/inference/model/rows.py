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
from percept.inference.model.statistics import Statistics, TrialScatter

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
        self.covariates = statistics.covariates
        self.own = columns_by_quantity(design.deviation, self.size, self.cells)
        self.fixed = columns_by_quantity(design.fixed, self.size, self.cells)
        self._covariate_sd = covariate_sd
        self._set_units(statistics)
        self._set_kinds(statistics.scatter)
        self._set_columns()
        self._set_products()

    @property
    def deviations(self) -> int:
        """Number a J of own deviations."""
        return len(self.own) * self.environments

    @property
    def slopes(self) -> int:
        """Number of slopes of covariates, one for each quantity."""
        return 0 if self.covariates is None else self.size * len(self.covariates.names)

    @property
    def locations(self) -> int:
        """Number R of locations: cells by quantity, slopes of covariates, fixed coefficients."""
        return self.size * self.cells + self.slopes + len(self.fixed)

    def own_sd(self, tau: Array) -> Array:
        """SDs (a, W) of own deviations, in the order of their columns, from (o, P, W)."""
        return tau.reshape(len(self.own), tau.shape[-1])

    def latent_sd(self, tau: Array) -> Array:
        """SDs of own deviations, and ones for the rest, whose columns hold them: (a J + r, W)."""
        own = np.repeat(self.own_sd(tau), self.environments, axis=0)
        rest = np.ones((self.basis.shape[1] - self.deviations, tau.shape[-1]))
        return np.concatenate([own, rest])

    def noise(self, scales: CellScales) -> Block:
        """D of every kind, entries (kinds, W)."""
        between = scales.between[self._cell_of_kind]
        if scales.trial is None:
            return between
        if not self._is_mean.all():
            between = between.scaled(self._is_mean[:, None])
        trial = scales.trial[self._group_of_kind]
        return between + trial.scaled(1.0 / self._trials_of_kind[:, None])

    def effects(self, scales: CellScales) -> list[tuple[int, Array]]:
        """Columns of effects by kind, (P, kinds, W) each, with the number of their multiplier."""
        at_kinds = scales.effects[:, :, self._cell_of_kind]
        columns = [(0, column) for column in at_kinds]
        shape = (self.size, len(self._cell_of_kind), at_kinds.shape[-1])
        for number, covariance in enumerate(scales.slopes):
            for root in covariance.factor_columns():
                column = np.broadcast_to(np.stack(root)[:, None], shape)
                columns.append((1 + number, column))
        return columns

    def _set_units(self, statistics: Statistics) -> None:
        """Line up the cell means of all patterns, then rows of trials."""
        count = 0 if self.covariates is None else len(self.covariates.names)
        pattern = []
        cell = []
        trials = []
        data = [np.zeros((self.size, 0))]
        values = [np.zeros((count, 0))]
        pattern_of = np.zeros(len(statistics.subjects), dtype=np.intp)
        for g, of_pattern in enumerate(statistics.patterns):
            root = np.sqrt(of_pattern.subjects)
            present = of_pattern.environments
            pattern.append(np.full(len(present), g))
            cell.append(present)
            trials.append(of_pattern.trials)
            data.append(root * of_pattern.mean)
            if statistics.subjects:
                pattern_of[of_pattern.members] = g
            if self.covariates is not None:
                (member,) = of_pattern.members
                values.append(self.covariates.mean[:, member][:, present])
        means = sum(len(part) for part in cell)
        if self.covariates is not None:
            rows = self.covariates.row_cell
            pattern.append(pattern_of[self.covariates.row_subject])
            cell.append(rows)
            trials.append(np.ones(len(rows)))
            data.append(self.covariates.row_responses)
            values.append(self.covariates.row_values)
        self.pattern = np.concatenate(pattern)
        self.cell = np.concatenate(cell)
        self.data = np.concatenate(data, axis=1)
        self._trials = np.concatenate(trials)
        self._values = np.concatenate(values, axis=1)
        self._mean_units = np.arange(len(self.cell)) < means
        self.pattern_of_subject = pattern_of
        roots = np.sqrt([of_pattern.subjects for of_pattern in statistics.patterns])
        self._root_subjects = np.where(self._mean_units, roots[self.pattern], 0.0)
        multipliers = [self._mean_units.astype(float)]
        if self.covariates is not None:
            for name in self.covariates.within:
                multipliers.append(self._values[self.covariates.names.index(name)])
        self.multipliers = np.stack(multipliers)

    def _set_kinds(self, scatter: TrialScatter) -> None:
        """Give every kind of units a number."""
        groups = np.zeros((self.cells, self.patterns), dtype=np.intp)
        number = np.arange(len(scatter.cell))
        if scatter.subject is None:
            groups[scatter.cell] = number[:, None]
        else:
            groups[scatter.cell, self.pattern_of_subject[scatter.subject]] = number
        self.trial_groups = groups
        of_units = groups[self.cell, self.pattern]
        labels = np.stack([self._mean_units, self.cell, of_units, self._trials])
        kinds, kind = np.unique(labels, axis=1, return_inverse=True)
        self.kind = kind.ravel()
        self._is_mean = kinds[0]
        self._cell_of_kind = kinds[1].astype(np.intp)
        self._group_of_kind = kinds[2].astype(np.intp)
        self._trials_of_kind = kinds[3]
        #: Means of each kind: degrees of freedom of trials are counted elsewhere.
        self.means_of_kind = np.bincount(self.kind) * self._is_mean

    def _set_columns(self) -> None:
        """Store the columns of units, and the locations that latents make."""
        of_cells = np.concatenate([self._apart(self.own, self.environment), self.fixed])
        of_cells = of_cells.reshape(len(of_cells), -1).T
        slopes = self._covariate_sd * np.eye(self.slopes)
        self.basis = np.zeros((self.locations, of_cells.shape[1] + self.slopes))
        cells, latents = of_cells.shape
        self.basis[:cells, :latents] = of_cells
        self.basis[cells : cells + self.slopes, latents:] = slopes
        fixed = np.arange(len(self.fixed))
        self.basis[cells + self.slopes + fixed, self.deviations + fixed] = 1.0
        quantities = self._covariate_sd * np.eye(self.size)
        of_slopes = np.einsum("mu,pq->mpqu", self._values, quantities)
        of_fixed = self.fixed[:, :, self.cell] * self._root_subjects
        #: Columns of the rest, (r, P, U), and of own deviations in any environment, (a, P, U).
        self._rest = np.concatenate([of_fixed, of_slopes.reshape(-1, *self.data.shape)])
        self._own_units = self.own[:, :, self.cell] * self._root_subjects
        own = self._apart(self._own_units, self.environment[self.cell])
        columns = np.concatenate([own, self._rest])
        self.columns = sparse.csr_array(columns.reshape(len(columns), -1).T)

    def _apart(self, columns: Array, environment: Indices) -> Array:
        """Columns (a, P, n) of own deviations, environment by environment: (a J, P, n)."""
        number = np.arange(self.environments)
        inside = number[:, None] == environment
        apart = columns[:, None] * inside[:, None]
        return apart.reshape(-1, *columns.shape[1:])

    def _set_products(self) -> None:
        """Sum products of columns over the units of each kind, the data last."""
        kinds = len(self.means_of_kind)
        environment_of_kind = self.environment[self._cell_of_kind]
        to_kinds = sparse.csr_array(
            (np.ones(len(self.kind)), (np.arange(len(self.kind)), self.kind))
        )
        rest = np.concatenate([self._rest, self.data[None]])

        def products(
            first: Array,
            second: Array,
            groups: Indices,
            count: int,
        ) -> sparse.csr_array:
            """Products (first, second, groups) of columns (k, P, U), by parts of precisions."""
            parts = [np.einsum("apu,bqu->abpqu", first, second)]
            (every,) = parts
            distinct = [every[:, :, 0, 0]]
            if self.size == 2:
                distinct += [every[:, :, 0, 1] + every[:, :, 1, 0], every[:, :, 1, 1]]
            stacked = np.stack(distinct, axis=2)  # (first, second, parts, U)
            by_kind = (stacked.reshape(-1, len(self.kind)) @ to_kinds).reshape(
                *stacked.shape[:3], kinds
            )
            a, b, part, kind = np.nonzero(by_kind)
            row = (a * len(second) + b) * count + groups[kind]
            column = part * kinds + kind
            shape = (len(first) * len(second) * count, len(distinct) * kinds)
            return sparse.csr_array((by_kind[a, b, part, kind], (row, column)), shape=shape)

        everywhere = np.zeros(kinds, dtype=np.intp)
        #: Times the parts of precisions of all kinds, these give the information of the latents.
        self.own_by_own = products(
            self._own_units, self._own_units, environment_of_kind, self.environments
        )
        self.own_by_rest = products(self._own_units, rest, environment_of_kind, self.environments)
        self.rest_by_rest = products(self._rest, rest, everywhere, 1)
        #: By pairs of multipliers, sums over the units of a pattern and kind, (G, kinds).
        shape = (self.patterns, kinds)
        place = np.ravel_multi_index((self.pattern, self.kind), shape)
        self.effects_by_effects = {}
        for a, first in enumerate(self.multipliers):
            for b, second in enumerate(self.multipliers[: a + 1]):
                sums = np.bincount(place, first * second, self.patterns * kinds)
                self.effects_by_effects[a, b] = sums.reshape(shape)
        #: By multiplier, columns and data summed over units: (G (a J + r + 1), P kinds).
        with_data = sparse.csr_array(
            np.concatenate([self.columns.toarray(), self.data.reshape(-1, 1)], axis=1)
        ).tocoo()
        quantity, unit = np.divmod(with_data.row, len(self.kind))
        count = with_data.shape[1]
        row = with_data.col * self.patterns + self.pattern[unit]
        column = quantity * kinds + self.kind[unit]
        self.effects_by_columns = [
            sparse.csr_array(
                (with_data.data * multiplier[unit], (row, column)),
                shape=(count * self.patterns, self.size * kinds),
            )
            for multiplier in self.multipliers
        ]
