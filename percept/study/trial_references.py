"""Trials that each have a reference of their own: restated at one reference per environment.

The model needs one reference per environment. That is the geometric mean g of the references r of
its trials. What subjects adjusted, a, becomes a·g/r: the ratio to the reference stays. How far r
lies above g, in decades, becomes a column, so that the model can have its effect as a covariate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.formula import TRIAL_REFERENCE
from percept.sessions.quantities import quantity_of
from percept.sessions.records import Notice
from percept.study.basics import analysed_parameters

#: Environments made of a study that has one only. A line over references takes two; five show
#: whether the means depart from it, and leave each a fifth of the trials.
_RANGES = 5


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
        table["environment"] = _ranges(table[column])
    log_reference = np.log(table[column])
    log_mean = log_reference.groupby(table["environment"]).transform("mean")
    log_ratio = log_reference - log_mean
    adjusted = f"{quantity_of(column)}_adj"
    table[TRIAL_REFERENCE] = log_ratio / np.log(10.0)
    table[adjusted] *= np.exp(-log_ratio)
    table[column] = np.exp(log_mean)
    text = f"{adjusted} is restated at the geometric mean of each environment's {column}"
    notices = (*sessions.notices, Notice(text, column=column))
    return replace(sessions, table=table, notices=notices)


def _varying(sessions: Sessions, scene: Scene) -> str:
    """Name the one column of references that vary within environments; refuse none, or several."""
    asked = scene.inference.parameters
    parameters = analysed_parameters(sessions.parameters, asked, sessions.quantities)
    columns = [f"{parameter}_ref" for parameter in parameters]
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


def _ranges(references: pd.Series[float]) -> pd.Series[str]:
    """Name the range that each reference lies in, by the range's ends."""
    # Ranges have equal numbers of trials; quantiles that ties make equal are dropped.
    number = pd.qcut(references, _RANGES, labels=False, duplicates="drop")
    ends = references.groupby(number).agg(["min", "max"])
    # A range that ties leave empty is missing here: names go by number, not by place.
    names = [f"{low:.6g} to {high:.6g}" for low, high in ends.to_numpy().tolist()]
    return number.map(dict(zip(ends.index, names, strict=True)))
