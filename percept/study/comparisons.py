"""What a study with factors compares: levels, interactions, and means of levels."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from percept.results import Skipped
from percept.sessions.records import Factors
from percept.study.basics import Array
from percept.study.conditions import CellKey, Conditions

#: Signs of a contrast, by the levels of its factors.
_Signs = dict[tuple[str, ...], float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """A contrast of cells: two levels of a factor, or how such a contrast differs; or a slope."""

    factor: str  # Its column; of an interaction all columns, joined by ":"
    first: str
    second: str
    of: str  # "bias", "interaction", "slope" of a covariate, or "level" for its mean
    within: bool  # Whether each subject has all levels; of a slope, whether each has one
    environment: str | None = None  # None over all references
    references: tuple[str, ...] = ()  # Environments it rests on
    #: Of the cells' locations; none of a slope.
    weights: Mapping[CellKey, float] = dataclasses.field(default_factory=dict)
    groups: tuple[str, str] = ("", "")  # Levels of a factor between subjects that it compares
    unit: float = 1.0  # SD of a covariate: its slope is told for one of its units

    @property
    def versus(self) -> str:
        """Its levels in words."""
        return f"{self.second} against {self.first}"

    @property
    def of_users(self) -> bool:
        """Whether each user has it too."""
        return self.of == "level" or (self.of != "slope" and self.within)

    def row(self, cells: Sequence[CellKey]) -> Array:
        """Weights of all cells (C,)."""
        return np.array([self.weights.get(cell, 0.0) for cell in cells])


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
    places = [list(factors.levels).index(factor) for factor in term]
    made = []
    for name in factors.environments:
        weights = _weights(name, places, signs, cells)
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
    places: Sequence[int],
    signs: _Signs,
    cells: Sequence[CellKey],
) -> dict[CellKey, float]:
    """Weights of a reference's cells: averages over the levels of all other factors."""
    by_others: dict[tuple[str, ...], dict[CellKey, float]] = {}
    for cell in cells:
        name, levels = cell
        own = tuple(levels[place] for place in places)
        if name != environment or own not in signs:
            continue
        others = tuple(level for place, level in enumerate(levels) if place not in places)
        by_others.setdefault(others, {})[cell] = signs[own]
    whole = [weights for weights in by_others.values() if len(weights) == len(signs)]
    return {cell: sign / len(whole) for weights in whole for cell, sign in weights.items()}
