"""Factors, groups and covariates of a study, told from its data; and references by trial.

The model needs one reference per environment. Where every trial has its own reference r, that is
their geometric mean g. What subjects adjusted, a, becomes a·g/r: the ratio to the reference stays.
How far r lies above g, in decades, becomes a column, whose effect is that of a covariate.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.options import TRIAL_REFERENCE, Term, terms_of
from percept.sessions.quantities import quantity_of
from percept.sessions.records import Factors, Notice
from percept.study.basics import Array, analysed_parameters

#: Environments made of a study that has one only. A line over references takes two; five show
#: whether the means depart from it, and leave each a fifth of the trials.
_RANGES = 5


@dataclasses.dataclass(frozen=True)
class Conditions:
    """What the columns of a model are."""

    factors: tuple[str, ...]
    between: frozenset[str]  # Factors of which every subject has one level only
    covariates: tuple[str, ...]
    terms: tuple[Term, ...]  # Of factors
    spread: tuple[str, ...]  # Factors whose levels differ in spread
    precision: tuple[str, ...]  # Factors whose levels are compared in the SD between trials


def told_apart(sessions: Sessions, scene: Scene) -> Sessions:
    """Tell environments apart by the levels of the scene's factors.

    Raises
    ------
    UsageError
        A column that is not there, has gaps or a single value, or a term that the data cannot
        carry.
    """
    by_trial = (TRIAL_REFERENCE,) in scene.terms
    if sessions.options.trial_references and not by_trial:
        message = 'the sessions were read with [model] bias = "reference", which the scene lacks.'
        raise UsageError(message, hint="Read them with it: read_sessions(files, scene=scene).")
    if sessions.factors is not None or not scene.terms:
        return sessions
    if by_trial:
        sessions = at_typical_references(sessions, scene)
    conditions = conditions_of(sessions, scene)
    _refuse_aliases(sessions, conditions)
    return _by_level(sessions, conditions.factors)


def _refuse_gaps(sessions: Sessions, column: str) -> None:
    """Refuse a column that does not put every row of trials into a group."""
    if sessions.form == "summary":
        message = "published limits have no subjects to divide."
        raise UsageError(message, column=column, hint="Give sessions, or two studies.")
    table = sessions.table
    if column not in table:
        message = f"the sessions have no such column; they have {', '.join(map(str, table))}."
        hint = (
            "Read the files with the scene that names it: read_sessions(files, scene=scene)."
            f' A column of groups is kept by [sessions] groups = ["{column}"].'
        )
        raise UsageError(message, column=column, hint=hint)
    blank = table[column].astype(str).str.strip() == ""
    if blank.any():
        file, row = sessions.locate(int(table.index[blank][0]))
        message = f"{counted(int(blank.sum()), 'row')} without a value."
        hint = "Fill them in, or leave such rows out with [sessions] exclude."
        raise UsageError(message, file=file, row=row, column=column, hint=hint)
    if table[column].nunique() < 2:
        raise UsageError("all rows have one value: there is nothing to compare.", column=column)


def _by_level(sessions: Sessions, columns: Sequence[str]) -> Sessions:
    """Tell environments apart by the levels of columns, such as "VE1 (left)"."""
    if not columns:
        return sessions
    table = sessions.table
    levels = {name: tuple(table[name].astype(str).unique()) for name in columns}
    present = set(table[["environment", *columns]].astype(str).itertuples(index=False, name=None))
    cells: dict[str, tuple[str, tuple[str, ...]]] = {}
    for environment, *combined in itertools.product(sessions.environments, *levels.values()):
        if (environment, *combined) not in present:
            continue
        cell = Factors.cell(environment, combined)
        if cell in cells:
            message = f"two cells would have the name {cell!r}."
            hint = "Name environments or levels without brackets."
            raise UsageError(message, column=columns[0], hint=hint)
        cells[cell] = (environment, tuple(combined))

    def in_cells(rows: pd.DataFrame) -> pd.DataFrame:
        """Name the cell of each row as its environment."""
        texts = rows[["environment", *columns]].astype(str).itertuples(index=False, name=None)
        return rows.assign(environment=[Factors.cell(name, levels) for name, *levels in texts])

    at_limits = sessions.at_limits
    return dataclasses.replace(
        sessions,
        table=in_cells(table),
        factors=Factors(levels, cells),
        at_limits=in_cells(at_limits) if len(at_limits) else at_limits,
    )


def conditions_of(sessions: Sessions, scene: Scene) -> Conditions:
    """Tell factors from covariates, and those within subjects from those between them.

    A column of numbers is a covariate, unless `[study] factor` names it.
    """
    columns = list(dict.fromkeys(name for term in scene.terms for name in term))
    factors = []
    covariates = []
    between = set()
    for column in columns:
        _refuse_gaps(sessions, column)
        values = pd.to_numeric(sessions.table[column], errors="coerce")
        if column != scene.study.factor and values.notna().all():
            covariates.append(column)
            continue
        factors.append(column)
        levels = sessions.table.groupby("subject", sort=False)[column].nunique()
        if (levels == 1).all():
            between.add(column)
    for term in scene.terms:
        mixed = sorted(set(term) & set(covariates))
        if len(term) > 1 and mixed:
            message = f"{' : '.join(term)} holds a column of numbers, which takes no interactions."
            hint = "If it names conditions, write them as words, or set [study] factor = "
            hint += f'"{mixed[0]}".'
            raise UsageError(message, key="model.bias", value=mixed[0], hint=hint)
    return Conditions(
        factors=tuple(factors),
        between=frozenset(between),
        covariates=tuple(covariates),
        terms=tuple(term for term in scene.terms if not set(term) & set(covariates)),
        spread=_named(scene.model.spread, "spread", factors, by_default=factors),
        precision=_named(scene.model.precision, "precision", factors),
    )


def _named(
    formula: str | None, setting: str, factors: Sequence[str], *, by_default: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the factors that a setting of the model names."""
    if formula is None:
        return tuple(by_default)
    key = f"model.{setting}"
    names = [" : ".join(term) for term in terms_of(formula, key=key)]
    for name in names:
        if name not in factors:
            hint = f"Factors of [model] bias are {', '.join(factors) or 'none'}."
            raise UsageError("is no factor of the model.", key=key, value=name, hint=hint)
    return tuple(names)


def _refuse_aliases(sessions: Sessions, conditions: Conditions) -> None:
    """Refuse the first term that the terms before it, and the environments, already determine."""
    table = sessions.table
    columns = pd.get_dummies(table["environment"], dtype=float).to_numpy()
    terms: list[Term] = [*conditions.terms, *((name,) for name in conditions.covariates)]
    for term in terms:
        added = table[list(term)]
        if term[0] in conditions.covariates:
            of_term = in_sds(added.astype(float))
        else:
            joint = added.astype(str).groupby(list(term)).ngroup()
            of_term = pd.get_dummies(joint, dtype=float).to_numpy()
        rank = np.linalg.matrix_rank(columns)
        columns = np.hstack([columns, of_term])
        if np.linalg.matrix_rank(columns) == rank:
            message = "says nothing that the environments and the other terms do not say."
            hint = "Leave it out of [model] bias."
            raise UsageError(message, key="model.bias", value=" : ".join(term), hint=hint)


def in_sds(covariates: pd.DataFrame) -> Array:
    """Centre covariates, and take them in their SDs, shape (rows, M)."""
    values = covariates.to_numpy(dtype=float)
    centred = values - values.mean(axis=0)
    return np.asarray(centred / values.std(axis=0))


def at_typical_references(sessions: Sessions, scene: Scene) -> Sessions:
    """Restate every adjustment at its environment's geometric mean of references.

    The column `reference` keeps how far each trial's own lies above that mean, in decades. Sessions
    with one environment get several: ranges of references with about equal numbers of trials.

    Parameters
    ----------
    sessions : Sessions
        Read with `[model] bias = "reference"`.
    scene : Scene
        Which quantities are analysed.

    Returns
    -------
    Sessions

    Raises
    ------
    UsageError
        References that do not vary within environments, vary in two quantities, or have no
        logarithm.
    """
    if TRIAL_REFERENCE in sessions.table:
        return sessions
    column = _varying(sessions, scene)
    table = sessions.table.copy()
    if table["environment"].nunique() == 1:
        # Ranges have equal numbers of trials; quantiles that ties make equal are dropped.
        number = pd.qcut(table[column], _RANGES, labels=False, duplicates="drop")
        of_range = table[column].groupby(number)
        ends = of_range.transform(lambda own: f"{own.min():.6g} to {own.max():.6g}")
        table["environment"] = ends
    log_reference = np.log(table[column])
    log_mean = log_reference.groupby(table["environment"]).transform("mean")
    log_ratio = log_reference - log_mean
    adjusted = f"{quantity_of(column)}_adj"
    table[TRIAL_REFERENCE] = log_ratio / np.log(10.0)
    table[adjusted] *= np.exp(-log_ratio)
    table[column] = np.exp(log_mean)
    text = f"{adjusted} is restated at the geometric mean of each environment's {column}"
    notices = (*sessions.notices, Notice(text, column=column))
    return dataclasses.replace(sessions, table=table, notices=notices)


def _varying(sessions: Sessions, scene: Scene) -> str:
    """Name the one column of references that vary within environments; refuse none, or several."""
    columns = [f"{parameter}_ref" for parameter in analysed_parameters(sessions, scene)]
    counts = sessions.table.groupby("environment")[columns].nunique().max()
    varying = [column for column in columns if counts[column] > 1]
    key = "model.bias"
    if not varying:
        message = (
            "every environment has one reference: the model already has the trend over references."
        )
        raise UsageError(message, key=key, value=TRIAL_REFERENCE, hint="Leave it out.")
    if len(varying) > 1:
        message = f"{' and '.join(varying)} vary by trial."
        hint = f'Analyse one of them: [inference] parameters = ["{quantity_of(varying[0])}"].'
        raise UsageError(message, key=key, value=TRIAL_REFERENCE, hint=hint)
    (column,) = varying
    low = sessions.table[column].min()
    if low <= 0.0:
        message = (
            "a trial's own reference must be positive: references are compared by their logarithms."
        )
        hint = "Leave these trials out: [sessions] exclude."
        raise UsageError(message, column=column, value=float(low), hint=hint)
    return column
