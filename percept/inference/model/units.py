"""Units of a study of several patterns, and the joint precision of their unknowns at any scales.

A unit is the mean over n subjects of their means in a cell, times √n, or a row of trials about the
mean of their cell. Given the scales, the units of a pattern of subjects are

    y = X latents + Z b + noise

with Z the columns of a subject's effects b, standard normal, and the noise a small block D for each
unit. Units of a kind have the same cell, group of trials and number of trials, and so the same D.

Arrays have a own deviations in each of J environments, r other latents, q effects of each of G
patterns, P quantities, U units, V vectors and W sets of scales. Effects or own deviations are
eliminated first and come first among the unknowns. The data are one more column, the last.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from percept.inference.model.blocks import Block
from percept.inference.model.design import Basis, Design
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]


class Units:
    """Units of a study: what each multiplies a few vectors of its kind by.

    The vectors are a unit vector for each quantity, and the columns of effects.

    Attributes
    ----------
    pattern, kind : ndarray of int
        Of each unit, (U,).
    before_effects : int
        Number of unknowns before the effects: none, or own deviations that are eliminated first.
    block_shape : tuple of int
        Size and number of the blocks of unknowns that are eliminated first.
    x_and_data : ndarray
        Columns X, and the data last, (a J + r + 1, P, U).
    multipliers : ndarray
        What a unit multiplies the column of each effect by, (q, U): one for a mean and zero for
        trials; for subjects' own slopes the value of the covariate.
    effects : ndarray of int
        Numbers of the effects among the unknowns, (q, G).
    others : ndarray of int
        Numbers of the other unknowns, and of the data, (a J + r + 1,).
    own : ndarray of int
        The first of these, own deviations, (a, J).
    columns : csr_array
        What each unknown and the data multiply the vectors of each unit by, (V U, unknowns + 1).
    means_of_kind : ndarray
        How many units of each kind are means: determinants of trials are counted elsewhere.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        basis: Basis,
    ) -> None:
        patterns = statistics.patterns
        cell_counts = [pattern.environments.size for pattern in patterns]
        self.pattern = np.repeat(np.arange(len(patterns)), cell_counts)
        cell = np.concatenate([pattern.environments for pattern in patterns])
        trials = np.concatenate([pattern.trials for pattern in patterns])
        subjects = np.array([pattern.subjects for pattern in patterns])
        root_subjects = np.sqrt(subjects[self.pattern])
        means = np.concatenate([pattern.mean for pattern in patterns], axis=1)
        data = root_subjects * means
        values = np.zeros((0, len(cell)))
        within: list[int] = []
        covariates = statistics.covariates
        if covariates is not None:
            # Each subject is the pattern of its number. Rows of trials follow the means.
            within = [covariates.names.index(name) for name in covariates.within]
            values_of_means = covariates.mean[:, self.pattern, cell]
            values = np.hstack([values_of_means, covariates.row_values])
            data = np.hstack([data, covariates.row_responses])
            rows = len(covariates.row_cell)
            self.pattern = np.append(self.pattern, covariates.row_subject)
            cell = np.append(cell, covariates.row_cell)
            trials = np.append(trials, np.ones(rows))
            root_subjects = np.append(root_subjects, np.zeros(rows))
        is_mean = np.sign(root_subjects)
        quantities, cells = design.cells.x.shape
        _, latents = basis.matrix.shape
        # Locations are cells by quantity, then slopes by covariate, and others.
        ends = quantities * np.array([cells, cells + len(values)])
        in_cells, of_slopes, _ = np.split(basis.matrix, ends)
        by_quantity = in_cells.reshape(quantities, cells, latents)
        in_cell = by_quantity[:, cell]
        slopes = of_slopes.reshape(len(values), quantities, latents)
        by_unit = np.einsum("puk,u->kpu", in_cell, root_subjects)
        by_unit += np.einsum("mpk,mu->kpu", slopes, values)
        self.x_and_data = np.concatenate([by_unit, data[None]])
        of_means = np.tile(is_mean, (design.effects, 1))
        of_own_slopes = np.repeat(values[within], quantities, axis=0)
        self.multipliers = np.concatenate([of_means, of_own_slopes])
        environments = len(design.cells.environments)
        self._number_unknowns(len(patterns), len(basis.own), environments)
        self.columns = self._columns()
        #: The first subject of each pattern stands for all.
        member = np.array([pattern.members[0] for pattern in patterns])
        group = statistics.group[member[self.pattern], cell]
        labels = np.stack([is_mean, cell, group, trials])
        _, example, kind = np.unique(labels, axis=1, return_index=True, return_inverse=True)
        self.kind = kind.ravel()
        self._is_mean = is_mean[example]
        self._cell = cell[example]
        self._group = group[example]
        self._trials = trials[example]
        self.means_of_kind = np.bincount(self.kind) * self._is_mean

    def _number_unknowns(
        self,
        patterns: int,
        own: int,
        environments: int,
    ) -> None:
        """Order the unknowns as they are eliminated."""
        shape = (len(self.multipliers), patterns)
        effects = math.prod(shape)
        self.before_effects = 0
        self.block_shape = shape
        if effects < own * environments:
            self.before_effects = own * environments
            self.block_shape = (own, environments)
        self.effects = self.before_effects + np.arange(effects).reshape(shape)
        unknowns = np.arange(effects + len(self.x_and_data))
        self.others = np.setdiff1d(unknowns, self.effects)
        own_unknowns = self.others[: own * environments]
        self.own = own_unknowns.reshape(own, environments)

    def _columns(self) -> sparse.csr_array:
        """Numbers by vector and unit, for every unknown."""
        # The vectors of quantities come first, then the vectors of effects.
        by_unit = self.x_and_data.reshape(len(self.x_and_data), -1).T
        of_others = sparse.csr_array(by_unit)
        effect = self.effects[:, self.pattern] - self.before_effects
        row = np.arange(effect.size)
        shape = (effect.size, self.effects.size)
        numbers = self.multipliers.ravel()
        of_effects = sparse.csr_array((numbers, (row, effect.ravel())), shape)
        of_effects.eliminate_zeros()
        before = of_others[:, : self.before_effects]
        after = of_others[:, self.before_effects :]
        columns = sparse.block_array(
            [
                [before, None, after],
                [None, of_effects, None],
            ]
        )
        return columns.tocsr()

    def noise(self, scales: CellScales) -> Block:
        """D of every kind, entries (kinds, W)."""
        between = scales.between[self._cell]
        if scales.trial is None:
            return between
        trial = scales.trial[self._group]
        of_mean = 1.0 / self._trials[:, None]
        is_mean = self._is_mean[:, None]
        return between.scaled(is_mean) + trial.scaled(of_mean)

    def vectors(self, scales: CellScales) -> list[Array]:
        """Vectors of the kinds: of each quantity (P, kinds, 1), then of effects (P, kinds, W)."""
        effects = list(scales.effects[:, :, self._cell])
        _, quantities, _ = self.x_and_data.shape
        every_kind = np.ones((1, len(self._cell), 1))
        for covariance in scales.slopes:
            for root in covariance.factor_columns():
                column = np.stack(root)[:, None]
                effects.append(column * every_kind)
        of_quantities = np.eye(quantities)[..., None, None] * every_kind
        return [*of_quantities, *effects]


class JointPrecision:
    """Joint precision of all unknowns and the data, without the prior, from a noise.

    It is made of blocks (k, k, B, W), their cross terms (k, K + 1, B, W) with the K others and the
    data, and the joint entries (K + 1, K + 1, W) of these, of which the upper ones stay zero.

    Every entry is a fixed combination of the products v'D⁻¹w of two vectors of one kind. Sparse
    matrices hold these combinations, and no draw loops over units. A unit that multiplies v by a
    for one unknown, and w by b for another, adds a b v'D⁻¹w to their common entry.
    """

    def __init__(self, units: Units) -> None:
        size, blocks = units.block_shape
        in_blocks = size * blocks
        columns = units.columns.tocoo()
        unknowns = columns.shape[1]
        unit_count = len(units.kind)
        kinds = len(units.means_of_kind)
        vectors = columns.shape[0] // unit_count
        vector, unit = np.divmod(columns.row, unit_count)
        with_vector = columns.col * vectors + vector
        by_vector = sparse.csr_array((columns.data, (with_vector, unit)))
        with_kind = with_vector * kinds + units.kind[unit]
        by_kind = sparse.csr_array((columns.data, (unit, with_kind)))
        # Summed over units: how often a pair of unknowns has a pair of vectors of a kind.
        pairs = (by_vector @ by_kind).tocoo()
        first, first_vector = np.divmod(pairs.row, vectors)
        second, vector_and_kind = np.divmod(pairs.col, vectors * kinds)
        second_vector, kind = np.divmod(vector_and_kind, kinds)
        later = np.maximum(first_vector, second_vector)
        earlier = np.minimum(first_vector, second_vector)
        product = later * (later + 1) // 2 + earlier
        # Joint entries above the diagonal stay zero. Mirrors of cross terms are not read below.
        is_taken = (first < in_blocks) | (second <= first)
        place = (first * unknowns + second, product * kinds + kind)
        products = vectors * (vectors + 1) // 2
        every_entry = sparse.csr_array(
            (pairs.data * is_taken, place),
            (unknowns**2, products * kinds),
        )
        every_entry.eliminate_zeros()
        number = np.arange(unknowns**2).reshape(unknowns, unknowns)
        of_blocks = number[:in_blocks, :in_blocks].reshape(size, blocks, size, blocks)
        crossing = number[:in_blocks, in_blocks:].reshape(size, blocks, unknowns - in_blocks)
        #: Of blocks, cross terms and joint entries: numbers by entry, and by product of two vectors
        #: and kind; and their shape.
        self._combinations = [
            (every_entry[entries.ravel()], entries.shape)
            for entries in (
                np.einsum("abcb->acb", of_blocks),
                crossing.swapaxes(1, 2),
                number[in_blocks:, in_blocks:],
            )
        ]

    def __call__(
        self,
        noise: Block,
        vectors: list[Array],
    ) -> list[Array]:
        """Blocks, cross terms and joint entries."""
        products = []
        for number, vector in enumerate(vectors):
            weighted = np.stack(noise.solve(tuple(vector)))
            for other in vectors[: number + 1]:
                products.append(np.einsum("pnw,pnw->nw", weighted, other))
        by_kind = np.concatenate(products)
        width = by_kind.shape[1]
        return [
            (combinations @ by_kind).reshape(*shape, width)
            for combinations, shape in self._combinations
        ]
