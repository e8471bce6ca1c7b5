"""What a study with factors compares, and each subject's numbers in the cells that it weighs.

Levels of a factor are compared two by two; interactions compare such differences, and every level
has a mean. A contrast weighs cells: a cell is a reference at one level of every factor.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.results import Skipped
from percept.sessions import Sessions
from percept.study.basics import Array
from percept.study.data import Data
from percept.study.responses import Trials

#: What the references are called as a factor: the column of the sessions.
ENVIRONMENT = "environment"


def _none() -> Array:
    """No weights."""
    return np.zeros(0)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Contrast:
    """Two levels of a factor, or how such a difference differs; a level's mean; or a slope."""

    parameter: str
    factor: str  # Its column; of an interaction all columns, joined by ":"
    first: str
    second: str
    #: Of locations "bias", "interaction", "slope" of a covariate, or "level" for its mean; of
    #: ratios of SDs "spread" and "precision".
    of: str
    within: bool  # Whether each subject has all levels; of a slope, whether each has one
    environment: str | None = None  # None over all references
    references: tuple[str, ...] = ()  # Environments it rests on
    #: (C,) Of the cells; none of a slope
    weights: Array = dataclasses.field(default_factory=_none)
    groups: tuple[str, str] = ("", "")  # Levels of a factor between subjects that it compares
    #: (R,) Of a model's locations, or of its cells' SDs
    row: Array = dataclasses.field(default_factory=_none)
    subjects: int = 0  # That it rests on in the model

    @property
    def versus(self) -> str:
        """Its levels in words."""
        return f"{self.second} against {self.first}"

    @property
    def name(self) -> tuple[str, str]:
        """Its name among those of limits."""
        where = self.environment or "overall"
        return ("contrast", f"{self.parameter}, {self.factor}: {self.versus}, {where}")

    @property
    def is_ratio(self) -> bool:
        """Whether it is a ratio of SDs, and not a combination of locations."""
        return self.of in ("spread", "precision")

    @property
    def is_of_users(self) -> bool:
        """Whether each user has it too, so that it has intervals of all kinds."""
        return self.of == "level" or (self.within and self.of in ("bias", "interaction"))


def cells_of(sessions: Sessions, names: Sequence[str]) -> pd.DataFrame:
    """Environment of the cells of these names, and their level in each factor: a row each."""
    if sessions.factors is None:
        return pd.DataFrame({ENVIRONMENT: names})
    found = [sessions.factors.cells[name] for name in names]
    rows = [(environment, *levels) for environment, levels in found]
    return pd.DataFrame(rows, columns=[ENVIRONMENT, *sessions.factors.levels])


def compared(data: Data, trials: Trials, parameter: str) -> Iterator[Contrast | Skipped]:
    """Yield what is compared of a quantity in the cells of its trials."""
    if data.sessions.factors is None:
        return
    conditions = data.conditions
    cells = cells_of(data.sessions, trials.environments)
    terms: list[tuple[str, ...]] = [(factor,) for factor in conditions.factors]
    terms += [term for term in conditions.terms if len(term) > 1]
    for term in terms:
        yield from _pairs(data, parameter, term, cells)
    for *_, overall in level_means(data, trials, parameter):
        yield overall
    for factor in conditions.precision:
        yield from _pairs(data, parameter, (factor,), cells, trials.statistics.trial_df > 0.0)


def level_means(data: Data, trials: Trials, parameter: str) -> Iterator[list[Contrast]]:
    """Yield the means of every level against the references: of each reference, then over all."""
    cells = cells_of(data.sessions, trials.environments)
    for factor in data.conditions.factors:
        levels = cells[factor].to_numpy()
        for level in pd.unique(levels).tolist():
            outline = Contrast(
                parameter=parameter,
                factor=factor,
                first="the reference",
                second=level,
                of="level",
                within=factor not in data.conditions.between,
            )
            yield _by_reference(outline, (levels == level) * 1.0, (factor,), cells, corners=1)


def _pairs(
    data: Data,
    parameter: str,
    term: Sequence[str],
    cells: pd.DataFrame,
    repeated: NDArray[np.bool_] | None = None,
) -> Iterator[Contrast | Skipped]:
    """Yield every pair of levels of a term, by reference, then over several.

    Cells that are `repeated` are compared in precision; others in bias and in spread.
    """
    factors = data.sessions.factors
    assert factors is not None
    label = data.quantities[parameter].label
    of = "interaction" if len(term) > 1 else "bias"
    lacking = "data"
    if repeated is not None:
        label = f"precision of {label}"
        of = "precision"
        lacking = "repeated trials"
    between = [factor for factor in term if factor in data.conditions.between]
    of_factors = [itertools.combinations(factors.levels[factor], 2) for factor in term]
    for pairs in itertools.product(*of_factors):
        outline = Contrast(
            parameter=parameter,
            factor=":".join(term),
            first=", ".join(first for first, _ in pairs),
            second=", ".join(second for _, second in pairs),
            of=of,
            within=not between,
            groups=pairs[term.index(between[0])] if between else ("", ""),
        )
        # Of a difference of differences that of both second levels is positive.
        signs = np.ones(len(cells))
        if repeated is not None:
            signs = signs * repeated
        for factor, (first, second) in zip(term, pairs, strict=True):
            levels = cells[factor].to_numpy()
            signs = signs * ((levels == second) * 1.0 - (levels == first))
        made = _by_reference(outline, signs, term, cells, corners=2 ** len(term))
        found = {contrast.environment for contrast in made}
        missing = [name for name in factors.environments if name not in found]
        if missing:
            what = f"contrast of {label}, {outline.versus}, in {', '.join(missing)}"
            yield Skipped(what, f"there are no {lacking} at all its levels")
        for contrast in made:
            yield contrast
            if of == "bias":
                yield dataclasses.replace(contrast, of="spread")


def _by_reference(
    outline: Contrast, signs: Array, term: Sequence[str], cells: pd.DataFrame, *, corners: int
) -> list[Contrast]:
    """Make a contrast at each reference that has all its corners, and the average of several.

    It averages over the levels of all other factors at which all corners have data.
    """
    # Cells that differ in the term's levels alone are its corners.
    others = [cells[name] for name in cells if name not in term]
    is_whole = pd.Series(signs != 0.0).groupby(others).transform("sum").to_numpy() == corners
    made = []
    for environment in cells[ENVIRONMENT].unique().tolist():
        weights = signs * is_whole * (cells[ENVIRONMENT].to_numpy() == environment)
        if weights.any():
            weights *= corners / np.count_nonzero(weights)
            at_one = {"environment": environment, "references": (environment,)}
            made.append(dataclasses.replace(outline, weights=weights, **at_one))
    if len(made) < 2:
        return made
    references = tuple(name for one in made for name in one.references)
    average = np.mean([one.weights for one in made], axis=0)
    return [*made, dataclasses.replace(outline, references=references, weights=average)]


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectCells:
    """One number of each of N subjects in each of C cells, such as the mean of the trials."""

    #: (N, C) In a cell of another group stands the one of the subject's own; NaN without any.
    values: Array
    cells: pd.DataFrame  # (C rows) Environment and levels
    groups: dict[str, NDArray[np.object_]]  # (N,) Level of each factor between subjects

    def weighed(self, weights: Array) -> Array:
        """Sum each subject's weighted cells, (N,); NaN for subjects who lack a cell."""
        is_weighed = weights != 0.0
        return self.values[:, is_weighed] @ weights[is_weighed]

    def at_level(self, level: Contrast) -> Array:
        """Each subject's mean at one level; NaN in other groups, and where a cell is lacking."""
        means = self.weighed(level.weights)
        if level.factor in self.groups:
            means[self.groups[level.factor] != level.second] = np.nan
        return means


def subject_cells(data: Data, trials: Trials, numbers: Array) -> SubjectCells:
    """Lay out a number of each subject in each cell (N, C), of trials of one quantity."""
    between = data.conditions.between
    cells = cells_of(data.sessions, trials.environments)
    within = [cells[name] for name in cells if name not in between]
    # Each subject is in one group: of cells that differ in groups alone one has a number.
    values = pd.DataFrame(numbers.T).groupby(within).transform("first")
    first_cell = (trials.statistics.counts > 0.0).argmax(axis=1)
    groups = {name: cells[name].to_numpy(dtype=object)[first_cell] for name in between}
    return SubjectCells(values.to_numpy().T, cells, groups)
