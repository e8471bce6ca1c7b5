"""Laws of cells, users and pairs of quantities under the posterior of a linear design.

`linear` has the density; intervals, curves and verdicts rest on the laws here. Given the scales at
one set of coordinates, all laws are normal:

    location of a combination with weights w    mean w'm, variance |w'K|²
    a user about it                             variance |w'Z|² + |w'F|²

with m the mean of the locations and K columns whose products are their covariance, both from
`CellLaw`. Z are the columns of the subjects' effects, and F is a factor of the covariance between
subjects within cells. Shapes are in the symbols of `linear`; a pattern's subjects have E of the
C cells.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.design import Cells, Factors, Options, design_of
from percept.inference.model.laws import (
    NewEnvironment,
    PairLaws,
    PriorDraws,
    SubjectLaws,
    TrendLaw,
    joined,
)
from percept.inference.model.linear import LinearModel
from percept.inference.model.linear_new_environment import (
    linear_new_environment,
    linear_trends,
)
from percept.inference.model.linear_prior import draw_linear_prior
from percept.inference.model.model import Resolution
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import Statistics
from percept.inference.model.subject_covariance import SubjectCovariance
from percept.inference.model.subject_effects import draw_effects_of

__all__ = ["LinearPosterior", "plain_model"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def plain_model(
    statistics: Statistics,
    priors: Priors | None = None,
    options: Options | None = None,
    resolution: Resolution | None = None,
) -> LinearPosterior:
    """Build the model of environments without factors, which are its cells.

    Parameters
    ----------
    statistics : Statistics
        Of the responses, or of published limits: these show no effects of subjects.
    priors : Priors, optional
        Prior scales.
    options : Options, optional
        Simpler models.
    resolution : Resolution, optional
        Variance that the adjustment's resolution adds.

    Returns
    -------
    LinearPosterior
    """
    priors = priors or Priors()
    options = options or Options()
    if statistics.summary:
        options = dataclasses.replace(options, subject_effect=False)
    names = statistics.environments
    cells = Cells(names, np.arange(len(names)), names, statistics.x)
    factors = Factors(levels={}, level={}, terms=())
    design = design_of(cells, factors, priors, options)
    return LinearPosterior(statistics, design, priors, resolution=resolution)


class LinearPosterior(LinearModel):
    """Posterior of a linear design, with the laws of its cells and of their users.

    It takes the parameters of `LinearModel`.
    """

    def pairs(self, points: Array) -> PairLaws:
        """Joint law of the quantities in each cell, at coordinates (W, d)."""
        return joined([self._pairs(part) for part in self.passes(points)])

    def _pairs(self, points: Array) -> PairLaws:
        """Joint laws of one pass."""
        scales = self.linear_scales(points).cells
        law = self.locations(scales)
        by_cell = (len(points), *self.design.cells.x.shape)  # (W, P, C)
        mean = law.mean[:, : len(self.cells)].reshape(by_cell)
        columns = law.columns_of(self.cell_rows).reshape(*by_cell, -1)
        users = np.einsum("qpcw,qrcw->wcpr", scales.effects, scales.effects)
        for parts in scales.between.factor_columns():
            factor_column = np.stack(parts)
            users += np.einsum("pcw,rcw->wcpr", factor_column, factor_column)
        return PairLaws(
            mean=mean.swapaxes(1, 2),
            location=np.einsum("wpcq,wrcq->wcpr", columns, columns),
            users=users,
        )

    @property
    def trial_group(self) -> Indices:
        """Group of trials of every subject in every cell, (N, C)."""
        subjects = len(self.statistics.subjects)
        groups = np.zeros((subjects, self.problem.cells), dtype=np.intp)
        for g, pattern in enumerate(self.statistics.patterns):
            groups[pattern.members] = self._groups_of_pattern(g)
        return groups

    def _groups_of_pattern(self, number: int) -> Indices:
        """Group of trials of every cell of a pattern, (C,)."""
        groups = self.problem.trial_group
        # One column serves all patterns where subjects share their trial SDs.
        column = min(number, groups.shape[1] - 1)
        return np.asarray(groups[:, column])

    @property
    def cells_of_subjects(self) -> NDArray[np.bool_]:
        """Whether a cell is of a subject's own levels between subjects, (N, C)."""
        factors = self.design.factors
        own = np.ones((len(self.statistics.subjects), self.problem.cells), dtype=bool)
        for name in factors.between_subjects:
            level = factors.level[name]
            for pattern in self.statistics.patterns:
                own[pattern.members] &= np.isin(level, level[pattern.environments])
        return own

    def subject_laws(self, points: Array) -> SubjectLaws:
        """Laws of every subject's cell means at coordinates (W, d)."""
        scales = self.linear_scales(points).cells
        observed = self.with_resolution(scales)
        law = self.locations(scales)
        noise = []
        covariances = []
        for g, pattern in enumerate(self.statistics.patterns):
            present = pattern.environments
            pattern_noise = observed.between[present]  # (E, W)
            if observed.trial is not None:
                per_trial = observed.trial[self._groups_of_pattern(g)[present]]
                trials = pattern.trials[:, None]
                pattern_noise = pattern_noise + per_trial.scaled(1.0 / trials)
            noise.append(pattern_noise)
            effects = scales.effects[:, :, present]
            covariances.append(SubjectCovariance(pattern_noise, effects))
        by_cell = (*self.design.cells.x.shape, len(points))  # (P, C, W)
        mean = law.mean[:, : len(self.cells)].T
        columns = law.columns_of(self.cell_rows).transpose(2, 1, 0)
        return SubjectLaws(
            mean=mean.reshape(by_cell),
            columns=columns.reshape(-1, *by_cell),
            effects=scales.effects,
            noise=tuple(noise),
            covariances=tuple(covariances),
            trial=observed.trial,
        )

    def draw_subject_effects(
        self, points: Array, locations: Array, rng: np.random.Generator
    ) -> Array | None:
        """Draw what every subject adds, averaged over the cells of its own groups, (W, N, P).

        None without such effects, and with covariates: `locations` hold no slopes.
        """
        if self.covariates is not None or not self.design.subject:
            return None
        effects = []
        first = 0
        for part in self.passes(points):
            last = first + len(part)
            laws = self.subject_laws(part)
            effects.append(
                draw_effects_of(
                    laws, self.statistics, self.cells_of_subjects, locations[first:last], rng
                )
            )
            first = last
        return np.concatenate(effects)

    def draw_prior(self, draws: int, rng: np.random.Generator) -> PriorDraws:
        """Draw scales, population means and new users before any data."""
        return draw_linear_prior(self, draws, rng)

    def trends(self, points: Array) -> dict[str, TrendLaw]:
        """Law of bias over decades of the reference at coordinates (W, d), by condition."""
        return linear_trends(self, points)

    def new_environment(
        self,
        points: Array,
        x: Array,
        repeats: int,
        rng: np.random.Generator,
    ) -> dict[str, NewEnvironment]:
        """Laws of an untested environment, by condition."""
        return linear_new_environment(self, points, x, repeats, rng)

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the locations of all cells jointly and one new user of all cells, each (W, P C)."""
        return self.draw_of(self.cell_rows, points, rng)

    def draw_of(
        self, rows: Array, points: Array, rng: np.random.Generator, *, repeats: int = 1
    ) -> tuple[Array, Array]:
        """Draw combinations (L, R) of the locations jointly, and the same of new users.

        Parameters
        ----------
        rows : ndarray
            Weights, as `laws_of` takes them.
        points : ndarray
            Coordinates (W, d).
        rng : Generator
            Where draws come from.
        repeats : int
            Draws for each set of coordinates.

        Returns
        -------
        locations, users : ndarray
            Shape (W repeats, L) each. Coordinates are worked on in passes. A pass gives one draw
            for each of its coordinates, then another for each, before the next pass begins.
        """
        locations = []
        users = []
        for part in self.passes(points):
            location, user = self._draw_of(rows, part, rng, repeats)
            locations.append(location)
            users.append(user)
        return np.concatenate(locations), np.concatenate(users)

    def _draw_of(
        self, rows: Array, points: Array, rng: np.random.Generator, repeats: int
    ) -> tuple[Array, Array]:
        """Draws of one pass."""
        scales = self.linear_scales(points).cells
        law = self.locations(scales)
        draws = (repeats, len(points))
        columns = law.columns_of(rows)
        latents = rng.standard_normal((*draws, columns.shape[2]))
        locations = law.mean @ rows.T + np.einsum("wlq,rwq->rwl", columns, latents)
        weights = self.cell_weights(rows)
        effect_columns = np.einsum("lpc,qpcw->wlq", weights, scales.effects)
        effects = rng.standard_normal((*draws, effect_columns.shape[2]))
        users = locations + np.einsum("wlq,rwq->rwl", effect_columns, effects)
        for parts in scales.between.factor_columns():
            factor_column = np.einsum("lpc,pcw->wlc", weights, np.stack(parts))
            normals = rng.standard_normal((*draws, self.problem.cells))
            users += np.einsum("wlc,rwc->rwl", factor_column, normals)
        combinations = len(rows)
        return locations.reshape(-1, combinations), users.reshape(-1, combinations)
