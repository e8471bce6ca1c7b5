"""Units of a study of several patterns, and the joint precision of their unknowns at any scales.

A unit is the mean over n subjects of their means in a cell, times √n, or a row of trials about the
mean of their cell. Given the scales, the units of a pattern of subjects are

    y = X latents + Z b + noise

with Z the columns of a subject's effects b, standard normal, and the noise a small block D for each
unit. Units of a kind have the same cell, group of trials and number of trials, and so the same D.

The columns of a unit are numbers of its own times a few vectors of its kind: a unit vector for each
quantity, and the columns of effects. Every entry of the joint precision of all unknowns is then a
fixed combination of the products v'D⁻¹w of vectors of one kind. One sparse matrix holds these
combinations, and no draw walks over units.

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
from percept.inference.model.design import Basis, Design, environments_apart
from percept.inference.model.scales import CellScales
from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]


class Units:
    """Units of a study, with the vectors of their kinds and their numbers times these.

    Attributes
    ----------
    pattern, kind : ndarray of int
        Of each unit, (U,).
    patterns, environments, deviations : int
        Numbers G, J and a J.
    own_first : bool
        Whether own deviations are eliminated first, and not effects.
    latents : ndarray
        Columns X, and the data last, (a J + r + 1, P, U).
    multipliers : ndarray
        What a unit multiplies the column of each effect by, (q, U): one for a mean and zero for
        trials; for subjects' own slopes the value of the covariate.
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
        covariate_sd: float,
    ) -> None:
        patterns = statistics.patterns
        self.patterns = len(patterns)
        self.environments = len(design.cells.environments)
        cell_counts = [pattern.environments.size for pattern in patterns]
        subjects = np.array([pattern.subjects for pattern in patterns])
        self.pattern = np.repeat(np.arange(self.patterns), cell_counts)
        cell = np.concatenate([pattern.environments for pattern in patterns])
        trials = np.concatenate([pattern.trials for pattern in patterns])
        root_subjects = np.sqrt(subjects[self.pattern])
        means = np.concatenate([pattern.mean for pattern in patterns], axis=1)
        data = root_subjects * means
        #: The first subject of each pattern stands for all.
        member = np.array([pattern.members[0] for pattern in patterns])
        is_mean = np.ones(len(cell))
        values = np.zeros((0, len(cell)))
        within: list[int] = []
        covariates = statistics.covariates
        if covariates is not None:
            # Each pattern is a subject. Rows of trials follow the means.
            within = [covariates.names.index(name) for name in covariates.within]
            subject = member[self.pattern]
            values_of_means = covariates.mean[:, subject, cell]
            values = np.hstack([values_of_means, covariates.row_values])
            pattern_of_subject = np.argsort(member)
            of_rows = pattern_of_subject[covariates.row_subject]
            no_mean = np.zeros(len(of_rows))
            self.pattern = np.append(self.pattern, of_rows)
            cell = np.append(cell, covariates.row_cell)
            trials = np.append(trials, np.ones(len(of_rows)))
            root_subjects = np.append(root_subjects, no_mean)
            is_mean = np.append(is_mean, no_mean)
            data = np.hstack([data, covariates.row_responses])
        quantities = design.parameters
        environment = design.cells.environment[cell]
        own = basis.own[:, :, cell]
        fixed = basis.fixed[:, :, cell]
        own_apart = environments_apart(own, environment, self.environments)
        of_cells = np.concatenate([own_apart, fixed]) * root_subjects
        unit_slopes = covariate_sd * np.eye(quantities)
        slopes = np.einsum("mu,pq->mpqu", values, unit_slopes)
        slopes = slopes.reshape(-1, *data.shape)
        self.latents = np.concatenate([of_cells, slopes, data[None]])
        of_means = np.tile(is_mean, (design.effects, 1))
        of_slopes = np.repeat(values[within], quantities, axis=0)
        self.multipliers = np.concatenate([of_means, of_slopes])
        self.deviations = basis.deviations
        self.own_first = len(self.multipliers) * self.patterns < self.deviations
        self.columns = self._columns()
        group = statistics.scatter.group_of(member[self.pattern], cell)
        labels = np.stack([is_mean, cell, group, trials])
        self._set_kinds(labels)

    def _set_kinds(self, labels: Array) -> None:
        """Give every kind a number: each has labels (4, U) of its own."""
        labels_of_kind, kind = np.unique(labels, axis=1, return_inverse=True)
        self.kind = kind.ravel()
        self._is_mean = labels_of_kind[0]
        self._cell = labels_of_kind[1].astype(np.intp)
        self._group = labels_of_kind[2].astype(np.intp)
        self._trials = labels_of_kind[3]
        self.means_of_kind = np.bincount(self.kind) * self._is_mean

    def _columns(self) -> sparse.csr_array:
        """Numbers by vector and unit, for every unknown."""
        _, quantities, units = self.latents.shape
        effects = len(self.multipliers)
        effect_unknowns = effects * self.patterns
        latent, quantity, unit = np.nonzero(self.latents)
        effect, unit_of_effect = np.nonzero(self.multipliers)
        of_latents = self.latents[latent, quantity, unit]
        of_effects = self.multipliers[effect, unit_of_effect]
        column_of_latent = effect_unknowns + latent
        column_of_effect = effect * self.patterns + self.pattern[unit_of_effect]
        if self.own_first:
            column_of_latent[latent < self.deviations] -= effect_unknowns
            column_of_effect += self.deviations
        values = np.concatenate([of_latents, of_effects])
        vector = np.concatenate([quantity, quantities + effect])
        unit = np.concatenate([unit, unit_of_effect])
        row = vector * units + unit
        column = np.concatenate([column_of_latent, column_of_effect])
        rows = (quantities + effects) * units
        columns = effect_unknowns + len(self.latents)
        return sparse.csr_array((values, (row, column)), (rows, columns))

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
        kinds = len(self._cell)
        at_kinds = scales.effects[:, :, self._cell]
        effects = list(at_kinds)
        for covariance in scales.slopes:
            for root in covariance.factor_columns():
                column = np.stack(root)[:, None]
                effects.append(np.repeat(column, kinds, axis=1))
        _, quantities, _ = self.latents.shape
        of_quantities = np.eye(quantities)[..., None]
        unit_vectors = np.repeat(of_quantities, kinds, axis=2)
        return [*unit_vectors[..., None], *effects]


class JointPrecision:
    """Joint precision of all unknowns and the data, without the prior, from a noise.

    It is made of blocks (k, k, B, W), their cross terms (k, K + 1, B, W) with the K others and the
    data, and the joint entries (K + 1, K + 1, W) of these, of which the upper ones stay zero.
    """

    def __init__(
        self,
        units: Units,
        block_size: int,
        blocks: int,
    ) -> None:
        columns = units.columns.tocoo()
        in_blocks = block_size * blocks
        others = columns.shape[1] - in_blocks
        self._shapes: list[tuple[int, ...]] = [
            (block_size, block_size, blocks),
            (block_size, others, blocks),
            (others, others),
        ]
        #: Where blocks, cross terms and joint entries end among all entries.
        self._ends = np.cumsum([math.prod(shape) for shape in self._shapes])
        unit_count = len(units.kind)
        kinds = len(units.means_of_kind)
        vectors = columns.shape[0] // unit_count
        vector, unit = np.divmod(columns.row, unit_count)
        column = columns.col * vectors + vector
        by_column = sparse.csr_array((columns.data, (column, unit)))
        kind = units.kind[unit]
        column_and_kind = column * kinds + kind
        by_kind = sparse.csr_array((columns.data, (unit, column_and_kind)))
        # Summed over units: how often a pair of unknowns has a pair of vectors of a kind.
        pairs = (by_column @ by_kind).tocoo()
        first, first_vector = np.divmod(pairs.row, vectors)
        second_column, kind = np.divmod(pairs.col, kinds)
        second, second_vector = np.divmod(second_column, vectors)
        later = np.maximum(first_vector, second_vector)
        earlier = np.minimum(first_vector, second_vector)
        product = later * (later + 1) // 2 + earlier
        row, block = np.divmod(first, blocks)
        column = second // blocks
        other_row = first - in_blocks
        other_column = second - in_blocks
        within = (row * block_size + column) * blocks + block
        cross = (row * others + other_column) * blocks + block
        joint = other_row * others + other_column
        in_block = other_column < 0
        in_cross = (other_row < 0) & ~in_block
        entry = self._ends[1] + joint
        entry[in_cross] = self._ends[0] + cross[in_cross]
        entry[in_block] = within[in_block]
        # A cross term and its mirror, and joint entries below the diagonal, are taken once.
        is_lower = (other_column >= 0) & (first >= second)
        kept = (other_row < 0) | is_lower
        product_and_kind = product * kinds + kind
        at = (entry[kept], product_and_kind[kept])
        products = vectors * (vectors + 1) // 2
        shape = (self._ends[-1], products * kinds)
        #: Numbers by entry, and by product of two vectors and kind.
        self._combinations = sparse.csr_array((pairs.data[kept], at), shape)

    def __call__(self, noise: Block, vectors: list[Array]) -> list[Array]:
        """Blocks, cross terms and joint entries."""
        products = []
        for number, vector in enumerate(vectors):
            weighted = np.stack(noise.solve(tuple(vector)))
            for other in vectors[: number + 1]:
                products.append(np.einsum("pnw,pnw->nw", weighted, other))
        by_kind = np.concatenate(products)
        entries = self._combinations @ by_kind
        width = entries.shape[1]
        parts = np.split(entries, self._ends[:-1])
        shaped = zip(parts, self._shapes, strict=True)
        return [part.reshape(*shape, width) for part, shape in shaped]
