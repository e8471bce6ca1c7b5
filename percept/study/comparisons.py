"""What a study with factors compares, and each subject's numbers in the cells that it weighs.

Levels of a factor are compared two by two; interactions compare such differences, and every level
has a mean. A comparison weighs cells, and a cell is a reference at one level of every factor.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.classical.variability import log_sd
from percept.results import Skipped
from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.conditions import CellKey, Conditions
from percept.study.responses import Trials

#: Signs of a contrast, by the levels of its factors.
_Signs = dict[tuple[str, ...], float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """A contrast of cells: two levels of a factor, or how such a contrast differs; or a slope."""

    factor: str  # Its column; of an interaction all columns, joined by ":"
    first: str
    second: str
    #: Of locations "bias", "interaction", "slope" of a covariate, or "level" for its mean; of
    #: ratios of SDs "spread" and "precision".
    of: str
    within: bool  # Whether each subject has all levels; of a slope, whether each has one
    environment: str | None = None  # None over all references
    references: tuple[str, ...] = ()  # Environments it rests on
    weights: Mapping[CellKey, float] = dataclasses.field(default_factory=dict)  # None of a slope
    groups: tuple[str, str] = ("", "")  # Levels of a factor between subjects that it compares

    @property
    def versus(self) -> str:
        """Its levels in words."""
        return f"{self.second} against {self.first}"

    @property
    def where(self) -> str:
        """Its environment in words."""
        return self.environment or "overall"

    @property
    def is_ratio(self) -> bool:
        """Whether it is a ratio of SDs, and not a combination of locations."""
        return self.of in ("spread", "precision")

    @property
    def is_of_users(self) -> bool:
        """Whether each user has it too, so that it has intervals of all kinds."""
        return self.of == "level" or (self.within and self.of in ("bias", "interaction"))


def comparisons(
    conditions: Conditions,
    factors: Factors,
    cells: Sequence[CellKey],
    label: str,
    lacking: str = "data",
) -> Iterator[Comparison | Skipped]:
    """Yield every pair of levels and every interaction: by reference, then over several.

    Parameters
    ----------
    conditions : Conditions
        The model's columns.
    factors : Factors
        Levels of each column.
    cells : sequence of (str, tuple of str)
        Environment and levels of the cells that have data.
    label : str
        What is compared, in words.
    lacking : str
        What other cells lack.
    """
    interactions = [term for term in conditions.terms if len(term) > 1]
    for term in [*((factor,) for factor in conditions.factors), *interactions]:
        between = [factor for factor in term if factor in conditions.between]
        of_factors = [itertools.combinations(factors.levels[factor], 2) for factor in term]
        for pairs in itertools.product(*of_factors):
            outline = Comparison(
                factor=":".join(term),
                first=", ".join(first for first, _ in pairs),
                second=", ".join(second for _, second in pairs),
                of="interaction" if len(term) > 1 else "bias",
                within=not between,
                groups=pairs[term.index(between[0])] if between else ("", ""),
            )
            signs: _Signs = {}
            for corner in itertools.product(*pairs):
                firsts = [level == first for level, (first, _) in zip(corner, pairs, strict=True)]
                # Of a difference of differences that of both second levels is positive.
                signs[corner] = (-1.0) ** sum(firsts)
            made = _by_reference(outline, term, signs, factors, cells)
            found = {comparison.environment for comparison in made}
            missing = [name for name in factors.environments if name not in found]
            if missing:
                what = f"contrast of {label}, {outline.versus}, in {', '.join(missing)}"
                yield Skipped(what, f"there are no {lacking} at all its levels")
            yield from made


def level_means(
    conditions: Conditions, factors: Factors, cells: Sequence[CellKey]
) -> Iterator[list[Comparison]]:
    """Yield the means of every level against the references: of each reference, then over all."""
    for factor in conditions.factors:
        for level in factors.levels[factor]:
            outline = Comparison(
                factor=factor,
                first="the reference",
                second=level,
                of="level",
                within=factor not in conditions.between,
            )
            means = _by_reference(outline, (factor,), {(level,): 1.0}, factors, cells)
            if means:
                yield means


def _by_reference(
    outline: Comparison,
    term: Sequence[str],
    signs: _Signs,
    factors: Factors,
    cells: Sequence[CellKey],
) -> list[Comparison]:
    """Make a contrast at each reference that has all its levels, and the average of several."""
    columns = [list(factors.levels).index(factor) for factor in term]
    made = []
    for name in factors.environments:
        weights = _weights(name, columns, signs, cells)
        if weights:
            made.append(
                dataclasses.replace(outline, environment=name, references=(name,), weights=weights)
            )
    if len(made) < 2:
        return made
    average = {cell: weight / len(made) for one in made for cell, weight in one.weights.items()}
    references = tuple(name for one in made for name in one.references)
    overall = dataclasses.replace(outline, references=references, weights=average)
    return [*made, overall]


def _weights(
    environment: str,
    columns: Sequence[int],
    signs: _Signs,
    cells: Sequence[CellKey],
) -> dict[CellKey, float]:
    """Weights of a reference's cells: averages over the levels of all other factors."""
    by_others: dict[tuple[str, ...], dict[CellKey, float]] = {}
    for cell in cells:
        name, levels = cell
        corner = tuple(levels[column] for column in columns)
        if name != environment or corner not in signs:
            continue
        others = tuple(level for column, level in enumerate(levels) if column not in columns)
        by_others.setdefault(others, {})[cell] = signs[corner]
    whole = [weights for weights in by_others.values() if len(weights) == len(signs)]
    return {cell: sign / len(whole) for weights in whole for cell, sign in weights.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectCells:
    """One number of each of N subjects in a cell, such as the mean of the trials."""

    #: (N,) by environment and levels of the factors within subjects; NaN where there is none.
    values: dict[CellKey, Array]
    groups: dict[str, NDArray[np.object_]]  # (N,) Level of each factor between subjects
    within: tuple[int, ...]  # Indices of the factors within subjects among all factors

    @property
    def lacking(self) -> Array:
        """Values of a cell that the study lacks, (N,)."""
        return np.full_like(next(iter(self.values.values())), np.nan)

    def weighed(self, weights: Mapping[CellKey, float]) -> Array:
        """Sum each subject's weighted cells, (N,); NaN for subjects who lack a cell.

        Cells that differ in their groups alone are one cell of a subject.
        """
        total = np.zeros_like(self.lacking)
        for (environment, levels), weight in weights.items():
            cell = (environment, tuple(levels[place] for place in self.within))
            total = total + weight * self.values.get(cell, self.lacking)
        return total

    def at_level(self, level: Comparison) -> Array:
        """Each subject's mean at one level; NaN in other groups, and where a cell is lacking."""
        means = self.weighed(level.weights)
        if level.factor in self.groups:
            means[self.groups[level.factor] != level.second] = np.nan
        return means


def subject_cells(
    numbers: Array, trials: Trials, factors: Factors, between: Collection[str]
) -> SubjectCells:
    """Lay out a number of each subject in each cell (N, C), of trials of one quantity.

    Every subject has one level only of the factors `between`.
    """
    within = tuple(place for place, name in enumerate(factors.levels) if name not in between)
    values: dict[CellKey, Array] = {}
    groups = {name: np.full(len(numbers), "", dtype=object) for name in between}
    for column, name in zip(numbers.T, trials.environments, strict=True):
        environment, levels = factors.cells[name]
        cell = (environment, tuple(levels[place] for place in within))
        present = np.isfinite(column)
        # Each subject is in one group, so that the parts of a cell have no subject twice.
        values.setdefault(cell, np.full(len(numbers), np.nan))[present] = column[present]
        for group, level in groups.items():
            level[present] = factors.level(name, group)
    return SubjectCells(values, groups, within)


def log_trial_sds(trials: Trials) -> Array:
    """Log SDs between trials of one quantity, by subject and cell (N, C).

    −∞ where trials are all equal, NaN without repeats.
    """
    found = np.full(trials.counts.shape, np.nan)
    for i, c in np.argwhere(trials.counts > 1.0).tolist():
        in_cell = (trials.subject == i) & (trials.environment == c)
        responses = trials.response[in_cell, 0]
        # Rounding of the mean is no scatter.
        sd = responses.std(ddof=1) if np.ptp(responses) > 0.0 else 0.0
        found[i, c] = log_sd(sd, len(responses) - 1.0)
    return found
