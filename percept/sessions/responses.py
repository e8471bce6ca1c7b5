"""Adjustments made absolute by their references: ratios, differences, and angles that wrap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from percept.sessions.quantities import Quantity
from percept.sessions.records import Problems
from percept.sessions.tables import Log

#: A whole turn in units of angles.
_TURNS = {"deg": 360.0, "°": 360.0, "degree": 360.0, "degrees": 360.0}
_TURNS |= dict.fromkeys(("rad", "radian", "radians"), 2 * np.pi)


def complete_responses(table: pd.DataFrame, parameters: Sequence[str], log: Log) -> None:
    """Make adjustments of ratios to their references, and of differences from them.

    Angles beyond half a turn have no mean: 350 and 10 deg lie beside each other. They are refused,
    unless the adjustments are differences within half a turn.
    """
    for p in parameters:
        rule = log.options.columns.get(f"{p}_adj")
        response = rule.response if rule else None
        quantity = log.options.quantities[p]
        half_turn = _half_turn(quantity)
        if half_turn and response == "difference":
            _refuse_far_differences(table, quantity, half_turn, log)
        elif half_turn:
            _refuse_whole_turns(table, quantity, half_turn, log.problems)
        if response == "ratio":
            table[f"{p}_adj"] *= table[f"{p}_ref"]
        elif response == "difference":
            table[f"{p}_adj"] += table[f"{p}_ref"]


def _half_turn(quantity: Quantity) -> float | None:
    turn = _TURNS.get(quantity.unit.casefold())
    return turn / 2 if turn else None


def _refuse_whole_turns(
    table: pd.DataFrame, quantity: Quantity, half_turn: float, problems: Problems
) -> None:
    """Refuse an angle whose references, or adjustments about them, reach beyond half a turn."""
    name = f"{quantity.name}_adj"
    pairs = table[[f"{quantity.name}_ref", name]].dropna().to_numpy(dtype=float)
    references = pairs[:, 0]
    if not len(pairs):
        return
    far_references = max(np.ptp(references), np.abs(references).max()) > half_turn
    if not far_references and np.abs(pairs[:, 1] - references).max() <= half_turn:
        return
    which = "references reach" if far_references else "adjustments lie"
    message = (
        f"{quantity.label} in {quantity.unit} wraps: {which} beyond half a turn,"
        f" {half_turn:.4g} {quantity.unit}."
    )
    hint = (
        f"Give {name} a column of adjusted − reference, within half a turn:"
        f' {name} = {{ name = "…", response = "difference" }} in [columns].'
        " If the knob can turn more than once its angle does not wrap: give it in turns,"
        ' unit = "turn".'
    )
    problems.add(message, column=name, hint=hint)


def _refuse_far_differences(
    table: pd.DataFrame, quantity: Quantity, half_turn: float, log: Log
) -> None:
    """Refuse the first difference that goes the long way round."""
    differences = table[f"{quantity.name}_adj"].to_numpy(dtype=float)
    far = np.flatnonzero(np.abs(differences) > half_turn)
    if not len(far):
        return
    first = int(far[0])
    unit = quantity.unit
    message = f"a difference of more than half a turn, {half_turn:.4g} {unit}; {len(far)} in all."
    hint = f"Add or subtract {2 * half_turn:.4g} {unit}."
    value = float(differences[first])
    column = f"{quantity.name}_adj"
    place = log.places(table)(first)
    log.problems.add(message, column=column, value=value, hint=hint, **place)
