"""Rows of the interval table, and how both methods' intervals compare."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

from percept.errors import RefusalError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.record import ROW, Interval, Joint, Kind
from percept.results import IntervalRow, MethodPair, Skipped
from percept.scene import InferenceTable
from percept.study.basics import IF_BY_TRIAL, claim_of, known
from percept.study.data import Data

COLUMNS = ["environment", "parameter", *(name for name in ROW if name != "covers"), "reference"]
KEYS = COLUMNS[:6]


def classical_rows(data: Data) -> Iterator[IntervalRow | Skipped]:
    """Yield a row for every classical interval that the scene asks for."""
    asked = data.asked
    if asked.method == "classical":
        of_all = list(itertools.chain.from_iterable(data.cells.values()))
        if not any(cell.moments for cell in of_all):
            cell = of_all[0]
            message = f"there is no interval of anything: {cell.where}, say, where {cell.why}."
            raise RefusalError(message, hint=IF_BY_TRIAL)
    joints: list[Joint] = ["marginal"]
    if len(data.parameters) == 2:
        joints.append("bonferroni")
    for family, cells in data.cells.items():
        for cell in cells:
            if cell.moments is None:
                yield Skipped(f"classical {family} intervals of {cell.where}", cell.why)
                continue
            how: Any = {**claim_of(asked), "family": family, "unit": cell.quantity.unit}
            at = cell.parameter, cell.environment
            for kind, joint in itertools.product(asked.kinds, joints):
                interval = interval_of(kind, cell.moments, Claim(joint=joint, **how))
                left_out = data.sessions.left_out(cell.environment, cell.parameter)
                yield _row(interval, at, data.reference[at], data.scene.user_noun, left_out)


def bayesian_row(
    asked: InferenceTable,
    kind: Kind,
    cell: tuple[str, str],
    limits: tuple[float, float, float],
    reference: float,
    *,
    users: tuple[str, str] = ("user", "users"),
    left_out: int = 0,
    **rest: Any,
) -> IntervalRow:
    """Make the row of a posterior interval; `rest` are fields of `Interval`."""
    lower, upper, estimate = map(float, limits)
    if kind == "share":
        rest |= {"share": asked.share, "confidence": asked.confidence}
    interval = Interval(
        kind=kind, method="bayesian", family=asked.family, level=asked.level,
        lower=lower, upper=upper, estimate=estimate, **rest,
    )  # fmt: skip
    return _row(interval, cell, reference, users, left_out)


def _row(
    interval: Interval,
    cell: tuple[str, str],
    reference: float,
    users: tuple[str, str],
    left_out: int,
) -> IntervalRow:
    """Make a row; `users` are the study's words for one user and for several."""
    parameter, environment = cell
    fields = interval.as_dict() | {"covers": interval.covers_of(*users)}
    fields |= {name: float(fields[name]) for name in ("lower", "upper", "estimate")}
    return IntervalRow(
        environment=environment,
        parameter=parameter,
        reference=None if math.isnan(reference) else reference,
        left_out=left_out,
        **fields,
    )


def method_pairs(rows: Sequence[IntervalRow]) -> Iterator[MethodPair]:
    """Pair the methods' marginal intervals.

    The shift of the estimates is relative, or in the quantity's unit where one of its references is
    zero or negative.
    """
    marginal = [row for row in rows if row.joint == "marginal"]
    by_difference = {
        row.parameter for row in marginal if row.reference is not None and row.reference <= 0.0
    }
    posterior = {}
    for row in marginal:
        if row.method == "bayesian":
            posterior[row.environment, row.parameter, row.kind, row.family] = row
    for row in marginal:
        key = row.environment, row.parameter, row.kind, row.family
        other = posterior.get(key)
        if row.method == "bayesian" or other is None:
            continue
        relative = row.parameter not in by_difference
        shift = other.estimate - row.estimate
        yield MethodPair(
            environment=row.environment,
            parameter=row.parameter,
            kind=row.kind,
            family=row.family,
            width_ratio=known((other.upper - other.lower) / (row.upper - row.lower)),
            relative=relative,
            shift=other.estimate / row.estimate - 1.0 if relative else shift,
        )
