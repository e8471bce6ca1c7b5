"""What a study's subjects set, and what is asked of it: each part is worked out once."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import PurePath

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from percept import results
from percept.errors import PerceptError, RefusalError
from percept.inference.classical.moments import Moments, check_normality, subject_means
from percept.inference.record import Family
from percept.results import (
    CellValues,
    DesignCounts,
    NormalityTest,
    Note,
    SubjectRow,
    Words,
)
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.doubts import empty_cells
from percept.sessions.quantities import Quantities, Quantity, is_impedance
from percept.sessions.records import Notice
from percept.study.basics import FAMILIES, Array, References, analysed_parameters, known
from percept.study.conditions import Conditions, conditions_of
from percept.study.responses import Trials, trials

_Names = NDArray[np.object_]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One parameter in one environment, one value per subject."""

    quantity: Quantity
    environment: str
    #: Of the subjects' values, the mean of their trials on the family's scale.
    moments: Moments | None
    why: str = ""  # Why there are none

    @property
    def parameter(self) -> str:
        """Name of the quantity."""
        return self.quantity.name

    @property
    def where(self) -> str:
        """The cell in words."""
        return f"{self.quantity.label} in {self.environment}"


class Data:
    """Sessions under a scene, as every analysis takes them.

    Parameters
    ----------
    sessions : Sessions
        Whose environments are told apart by the levels of the scene's factors.
    scene : Scene
        What to analyse.
    """

    def __init__(self, sessions: Sessions, scene: Scene) -> None:
        self.sessions = sessions
        self.scene = scene
        self._trials: dict[tuple[object, ...], Trials] = {}

    @property
    def asked(self) -> InferenceTable:
        """What the scene asks of all intervals."""
        return self.scene.inference

    @property
    def quantities(self) -> Quantities:
        """All quantities of the sessions, by name."""
        return self.sessions.quantities

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Parameters analysed: those the scene names, or all that were adjusted."""
        return analysed_parameters(self.sessions, self.scene)

    @property
    def environments(self) -> tuple[str, ...]:
        """Environments as the scene lists them, then by their references."""
        return self.sessions.environments

    @property
    def is_impedance(self) -> bool:
        """Whether stiffness and damping are analysed, so that there are curves."""
        return is_impedance(self.parameters)

    @cached_property
    def reference(self) -> References:
        """Reference per (parameter, environment), in the parameter's unit; NaN where none is."""
        # Some of published limits have no reference at all.
        wide = self.sessions.references.reindex(self.environments).astype(float).to_dict()
        return {(p, name): wide[p][name] for p in self.parameters for name in self.environments}

    def by_difference(self, parameter: str) -> bool:
        """Whether a reference is zero or negative, so that settings are compared by differences."""
        return any(self.reference[parameter, name] <= 0.0 for name in self.environments)

    def differences(self, parameter: str, responses: ArrayLike) -> tuple[Array, str]:
        """Differences of responses, and their unit.

        They are ratios in the lognormal family; else parts of the references, or in the quantity's
        unit.
        """
        values = np.asarray(responses, dtype=float)
        if self.asked.family == "lognormal":
            with np.errstate(over="ignore"):
                return np.exp(values), ""
        if self.by_difference(parameter):
            unit = self.quantities[parameter].unit or "units"
            return values * self.scene.model.scale.get(parameter, 1.0), unit
        return values, "references"

    @cached_property
    def conditions(self) -> Conditions:
        """Factors and covariates of the scene's terms."""
        return conditions_of(self.sessions, self.scene)

    def trials(self, *parameters: str, partial: bool = False) -> Trials:
        """Trials of parameters as responses; arguments and errors as of `responses.trials`.

        RefusalError of published limits too.
        """
        if self.sessions.form == "summary":
            raise RefusalError("published limits hold no trials")
        key = (parameters, partial)
        if key not in self._trials:
            self._trials[key] = trials(
                self.sessions, self.scene, self.reference, parameters, partial=partial
            )
        return self._trials[key]

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """Rows of the sessions by environment."""
        return dict(self.sessions.by_environment())

    def means(self, environment: str, *parameters: str, family: Family) -> Array:
        """Mean of each subject's trials on a family's scale, (N, P), in the parameters' units.

        Of trials with all of P parameters; RefusalError where a value has no logarithm.
        """
        subjects, adjusted = self.adjusted(environment, *parameters)
        columns = [subject_means(values, subjects, family=family) for values in adjusted.T]
        return np.stack(columns, axis=1)

    def adjusted(self, environment: str, *parameters: str) -> tuple[_Names, Array]:
        """Subjects of the trials with all of P parameters, (M,), and their values, (M, P)."""
        table = self.tables[environment]
        values = table[[f"{parameter}_adj" for parameter in parameters]].to_numpy(dtype=float)
        complete = ~np.isnan(values).any(axis=1)
        return table["subject"].to_numpy(dtype=object)[complete], values[complete]

    @cached_property
    def cells(self) -> dict[Family, list[Cell]]:
        """Cells on the scale of each family, parameter by parameter."""
        cells = list(itertools.product(self.parameters, self.environments))
        return {family: [self._cell(*cell, family) for cell in cells] for family in FAMILIES}

    def _cell(self, parameter: str, environment: str, family: Family) -> Cell:
        """Make a cell of its moments, or of why there are none."""
        quantity = self.quantities[parameter]
        try:
            return Cell(quantity, environment, self._moments(parameter, environment, family))
        except RefusalError as refused:
            return Cell(quantity, environment, None, refused.message)

    def _moments(self, parameter: str, environment: str, family: Family) -> Moments:
        """Moments of published limits, or of the subjects' means; RefusalError without scatter."""
        log = family == "lognormal"
        if self.sessions.form == "summary":
            table = self.tables[environment]
            row = table[table["parameter"] == parameter]
            if row.empty:
                raise RefusalError("it was not published")
            (lower, upper, n, level) = row[["lower", "upper", "n", "level"]].iloc[0].tolist()
            moments = Moments.from_limits(lower, upper, int(n), level=level)
            if log and np.any(moments.mean <= 0):
                raise RefusalError("the published mean is zero or negative")
        else:
            subjects, adjusted = self.adjusted(environment, parameter)
            if len(set(subjects.tolist())) < 2:
                raise RefusalError("it has fewer than two subjects")
            if log and np.any(adjusted <= 0):
                raise RefusalError("a value is zero or negative")
            means = subject_means(adjusted[:, 0], subjects, family=family)
            repeats = len(subjects) > len(means)
            moments = Moments.from_values(means, log=log, repeats=repeats)
        if np.all(moments.sd == 0):
            raise RefusalError("all subjects made the same adjustments")
        return moments

    def moments(self, family: Family) -> dict[tuple[str, str], Moments]:
        """Moments on a family's scale, of the cells that have some, by (parameter, environment)."""
        return {
            (cell.parameter, cell.environment): cell.moments.on_scale(family)
            for cell in self.cells[family]
            if cell.moments is not None
        }

    @cached_property
    def normality(self) -> tuple[NormalityTest, ...]:
        """Tests of subjects' values and of their logarithms, of cells that these are for."""
        tests = []
        names = self.environments if self.sessions.form == "trials" else ()
        for environment, parameter, family in itertools.product(names, self.parameters, FAMILIES):
            with suppress(PerceptError):
                means = self.means(environment, parameter, family=family)
                test = check_normality(means[:, 0], family=family)
                tests.append(NormalityTest(environment, parameter, **vars(test)))
        return tuple(tests)


def what_was_read(data: Data) -> results.Data:
    """Say what was read: subjects, quantities, notices, and every cell's values."""
    sessions = data.sessions
    factors = sessions.factors
    exclusions = [dataclasses.replace(row, file=_name(row.file)) for row in sessions.exclusions]
    cells = itertools.product(data.environments, sessions.parameters)
    people = itertools.chain.from_iterable(_people(data, name) for name in sessions.parameters)
    has_trials = sessions.form == "trials"
    return results.Data(
        form=sessions.form,
        simulated=sessions.simulated,
        subjects=len(sessions.subjects),
        rows=len(sessions.table),
        environments=sessions.environments,
        references=len(factors.environments if factors else sessions.environments),
        parameters=sessions.parameters,
        quantities={name: sessions.quantities[name] for name in sessions.parameters},
        words=_words(data),
        counts=dict(sessions.counts),
        notices=_notes(sessions.notices),
        doubts=_notes(sessions.warnings),
        exclusions=tuple(exclusions),
        design=_design(sessions) if has_trials else None,
        cells=tuple(_values(data, *cell) for cell in cells) if has_trials else (),
        people=tuple(people) if has_trials else (),
    )


def _words(data: Data) -> Words:
    """Return the study's words; without a reference people give values unless the scene says."""
    scene = data.scene
    quantities = [data.sessions.quantities[name] for name in data.sessions.parameters]
    verb = scene.study.verb
    if verb == "set" and not any(quantity.is_matched for quantity in quantities):
        verb = "gave"
    return Words(*scene.environment_noun, *scene.study.subject, *scene.user_noun, verb)


def _notes(notices: Iterable[Notice]) -> tuple[Note, ...]:
    return tuple(Note(notice.text, _name(notice.file), notice.row) for notice in notices)


def _name(file: str | None) -> str | None:
    """Return a file's name without its folders, which are nobody else's business."""
    return PurePath(file).name if file else None


def _design(sessions: Sessions) -> DesignCounts:
    """Count trials, sessions and cells."""
    table = sessions.table
    trials_of_cell = table.groupby(["subject", "environment"], sort=False).size()
    visits = table.groupby("subject", sort=False)["session"].nunique()
    missing = len(empty_cells(table, sessions.factors))
    return DesignCounts(
        cells=len(trials_of_cell) + missing,
        missing=missing,
        trials=(int(trials_of_cell.min()), int(trials_of_cell.max())),
        sessions=(int(visits.min()), int(visits.max())),
    )


def _values(data: Data, environment: str, parameter: str) -> CellValues:
    """Say what was adjusted in one cell, on no scale: subjects' means, their mean and SD."""
    subjects, adjusted = data.adjusted(environment, parameter)
    values = subject_means(adjusted[:, 0], subjects).tolist() if len(subjects) else []
    moments = Moments.from_values(values) if len(values) > 1 else None
    return CellValues(
        environment=environment,
        parameter=parameter,
        reference=float(data.tables[environment][f"{parameter}_ref"].iloc[0]),
        n=len(values),
        mean=float(moments.mean) if moments else next(iter(values), None),
        sd=float(moments.sd) if moments else None,
        values=tuple(values),
        unit=data.quantities[parameter].unit,
    )


def _people(data: Data, parameter: str) -> Iterator[SubjectRow]:
    """Yield what every subject adjusted of one quantity.

    Deviations from references are logarithms of ratios (lognormal), relative (normal, and where a
    value has no logarithm), or differences where a reference is not positive.
    """
    columns = [f"{parameter}_ref", f"{parameter}_adj"]
    rows = data.sessions.table.dropna(subset=columns)
    reference, adjusted = rows[columns].to_numpy(dtype=float).T
    relative = bool((reference > 0).all())
    log = relative and data.asked.family == "lognormal" and bool((adjusted > 0).all())
    deviation = adjusted - reference
    if log:
        deviation = np.log(adjusted / reference)
    elif relative:
        deviation = adjusted / reference - 1.0
    by_cell = rows.assign(deviation=deviation).groupby(["subject", "environment"])["deviation"]
    cells = by_cell.mean().unstack()
    # Environments are centred, so that subjects with different environments compare.
    centred = (cells - cells.mean()).mean(axis=1)
    for subject in dict.fromkeys(rows["subject"]):
        own = cells.loc[subject]
        mean = own.mean()
        others = centred.drop(subject)
        # Without scatter there is no distance, nor with one other subject.
        distance = (centred[subject] - others.mean()) / (others.std() or math.nan)
        yield SubjectRow(
            subject=subject,
            parameter=parameter,
            n=int(own.count()),
            relative=relative,
            log=log,
            mean=float(np.expm1(mean) if log else mean),
            sd=known(own.std()),
            distance=known(distance),
            unit="" if relative else data.quantities[parameter].unit,
        )
