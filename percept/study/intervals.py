"""Rows of the interval table, and how both methods' intervals compare."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from percept.errors import RefusalError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.record import ROW, Interval, Joint, Kind
from percept.results import IntervalRow, MethodPair, Skipped
from percept.study.basics import IF_BY_TRIAL, Array, claim_of, known
from percept.study.data import Data

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Of the table of intervals.
COLUMNS = ["environment", "parameter", *ROW, "reference"]


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
                yield _row(data, interval, at, data.reference[at])


def bayesian_rows(
    fit: Fit,
    kind: Kind,
    cells: Sequence[tuple[str, str]],
    ends: Array,
    references: Sequence[float],
    counts: Sequence[int],
) -> Iterator[IntervalRow]:
    """Yield rows of posterior intervals of one kind.

    Parameters
    ----------
    fit : Fit
        That passed.
    kind : str
        What the intervals cover.
    cells : sequence of (str, str)
        Parameter and environment of C cells.
    ends : ndarray, shape (3, C)
        Lower limits, upper limits and estimates, in the units of the quantities.
    references : sequence of float
        Of the cells, in the same units.
    counts : sequence of int
        Subjects behind each cell.
    """
    data = fit.data
    asked = data.asked
    is_share = kind == "share"
    of_cells = zip(cells, ends.T.tolist(), references, counts, strict=True)
    for cell, (lower, upper, estimate), reference, n in of_cells:
        interval = Interval(
            kind=kind,
            method="bayesian",
            family=asked.family,
            level=asked.level,
            share=asked.share if is_share else None,
            confidence=asked.confidence if is_share else None,
            lower=lower,
            upper=upper,
            estimate=estimate,
            n=n,
            unit=data.quantities[cell[0]].unit,
            repeats=fit.repeats,
            # Moments of logarithms are matched to published limits.
            approximate=data.sessions.form == "summary" and asked.family == "lognormal",
        )
        yield _row(data, interval, cell, reference)


def _row(data: Data, interval: Interval, cell: tuple[str, str], reference: float) -> IntervalRow:
    """Make a row of an interval in a cell, (parameter, environment)."""
    parameter, environment = cell
    fields = {name: getattr(interval, name) for name in ROW}
    fields["covers"] = interval.covers_of(*data.scene.user_noun)
    return IntervalRow(
        environment=environment,
        parameter=parameter,
        reference=known(reference),
        left_out=data.sessions.left_out(environment, parameter),
        **fields,
    )


def method_pairs(rows: Sequence[IntervalRow]) -> Iterator[MethodPair]:
    """Pair the methods' marginal intervals.

    The shift of the estimates is relative, or in the quantity's unit where one of its references is
    zero or negative.
    """
    marginal = [row for row in rows if row.joint == "marginal"]
    by_difference = set()
    posterior = {}
    for row in marginal:
        if row.reference is not None and row.reference <= 0.0:
            by_difference.add(row.parameter)
        if row.method == "bayesian":
            posterior[row.environment, row.parameter, row.kind, row.family] = row
    for row in marginal:
        other = posterior.get((row.environment, row.parameter, row.kind, row.family))
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
