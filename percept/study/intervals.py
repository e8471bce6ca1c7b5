"""Rows of the interval table, the classical ones of every family; and the cells they rest on."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Self

import numpy as np
import pandas as pd

from percept.errors import PerceptError, RefusalError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments
from percept.inference.classical.trials import check_normality, subject_means
from percept.inference.record import ROW, Family, Interval, Joint, Kind
from percept.results import CellValues, DesignCounts, IntervalRow
from percept.scene import InferenceTable
from percept.sessions import Sessions
from percept.sessions.doubts import empty_cells
from percept.sessions.quantities import Quantity
from percept.study.basics import FAMILIES, IF_BY_TRIAL, References, Skipped, claim_of

__all__ = [
    "COLUMNS",
    "KEYS",
    "TOO_FEW",
    "Cell",
    "Row",
    "adjustments",
    "bayesian_row",
    "cell_moments",
    "classical_rows",
    "compare_intervals",
    "design_counts",
    "known_moments",
    "normality_tests",
    "with_left_out",
]

Row = dict[str, Any]

COLUMNS = ["environment", "parameter", *(name for name in ROW if name != "covers"), "reference"]
KEYS = COLUMNS[:6]
TOO_FEW = "it has fewer than two subjects"


@dataclasses.dataclass(frozen=True)
class Cell:
    """One parameter in one environment, one value per subject."""

    quantity: Quantity
    environment: str
    moments: (
        Moments | None
    )  # Of the subjects' values, the mean of their trials on the family's scale
    why: str = ""  # Why there are none

    @classmethod
    def of(cls, quantity: Quantity, environment: str, found: Moments | str) -> Self:
        """Make a cell of its moments, or of why there are none, such as no scatter."""
        if isinstance(found, str):
            return cls(quantity, environment, None, found)
        if np.all(found.sd == 0):
            return cls(quantity, environment, None, "all subjects made the same adjustments")
        return cls(quantity, environment, found)

    @property
    def parameter(self) -> str:
        """Name of the quantity."""
        return self.quantity.name

    @property
    def where(self) -> str:
        """The cell in words."""
        return f"{self.quantity.label} in {self.environment}"


def cell_moments(sessions: Sessions, parameters: tuple[str, ...], family: Family) -> list[Cell]:
    """Work out every cell of a study, parameter by parameter."""
    tables = list(sessions.by_environment())
    moments_of = _published if sessions.form == "summary" else _adjusted
    cells = []
    for parameter in parameters:
        quantity = sessions.quantities[parameter]
        for environment, table in tables:
            moments = moments_of(table, parameter, family)
            cells.append(Cell.of(quantity, environment, moments))
    return cells


def _published(table: pd.DataFrame, parameter: str, family: Family) -> Moments | str:
    row = table[table["parameter"] == parameter]
    if row.empty:
        return "it was not published"
    limits = row.iloc[0]
    level = float(limits["level"])
    n = int(limits["n"])
    moments = Moments.from_limits(limits["lower"], limits["upper"], n, level=level)
    if family == "lognormal" and np.any(moments.mean <= 0):
        return "the published mean is zero or negative"
    return moments


def _adjusted(table: pd.DataFrame, parameter: str, family: Family) -> Moments | str:
    column = f"{parameter}_adj"
    known = table.dropna(subset=column)
    adjusted = known[column].to_numpy(dtype=float)
    if known["subject"].nunique() < 2:
        return TOO_FEW
    if family == "lognormal" and np.any(adjusted <= 0):
        return "a value is zero or negative"
    return subject_means(adjusted, known["subject"].to_numpy(), family=family).moments()


def normality_tests(sessions: Sessions, parameters: tuple[str, ...]) -> pd.DataFrame:
    """Test subjects' values and their logarithms; cells that no test is for have no row."""
    rows = []
    tables = sessions.by_environment() if sessions.form == "trials" else ()
    for environment, table in tables:
        for parameter in parameters:
            column = f"{parameter}_adj"
            known = table.dropna(subset=column)
            subjects = known["subject"].to_numpy()
            for family in FAMILIES:
                with suppress(PerceptError):
                    means = subject_means(known[column], subjects, family=family)
                    test = check_normality(means.values, family=family)
                    cell = (environment, parameter, family)
                    rows.append((*cell, test.statistic, test.p_value, test.n))
    columns = ["environment", "parameter", "family", "statistic", "p_value", "n"]
    return pd.DataFrame(rows, columns=columns)


def known_moments(cells: Sequence[Cell], family: Family) -> dict[tuple[str, str], Moments]:
    """Moments on a family's scale, of the cells that have some, by parameter and environment."""
    return {
        (cell.parameter, cell.environment): cell.moments.on_scale(family)
        for cell in cells
        if cell.moments is not None
    }


def classical_rows(
    cells: Mapping[Family, Sequence[Cell]],
    asked: InferenceTable,
    reference: References,
    *,
    users: tuple[str, str],
) -> Iterator[IntervalRow | Skipped]:
    """Yield a row for every classical interval the scene asks for, of cells by family.

    `users` are the study's words for one user and for several, here and below.
    """
    if asked.method == "classical":
        of_all = list(itertools.chain.from_iterable(cells.values()))
        if not any(cell.moments for cell in of_all):
            cell = of_all[0]
            message = f"there is no interval of anything: {cell.where}, say, where {cell.why}."
            raise RefusalError(message, hint=IF_BY_TRIAL)
    for family, found in cells.items():
        parameters = {cell.parameter for cell in found}
        joints: list[Joint] = ["marginal"]
        if len(parameters) == 2:
            joints.append("bonferroni")
        for cell in found:
            if cell.moments is None:
                yield Skipped(f"classical {family} intervals of {cell.where}", cell.why)
                continue
            how: Any = {**claim_of(asked), "family": family, "unit": cell.quantity.unit}
            at = cell.parameter, cell.environment
            for kind, joint in itertools.product(asked.kinds, joints):
                interval = interval_of(kind, cell.moments, Claim(joint=joint, **how))
                yield _row(interval, at, reference[at], users)


def bayesian_row(
    asked: InferenceTable,
    kind: Kind,
    cell: tuple[str, str],
    limits: tuple[float, float, float],
    reference: float,
    unit: str,
    users: tuple[str, str] = ("user", "users"),
    **rest: Any,
) -> IntervalRow:
    """Make the row of a posterior interval; `rest` are fields of `Interval`."""
    lower, upper, estimate = map(float, limits)
    if kind == "share":
        rest |= {"share": asked.share, "confidence": asked.confidence}
    interval = Interval(
        kind=kind, method="bayesian", family=asked.family, level=asked.level,
        lower=lower, upper=upper, estimate=estimate, unit=unit, **rest,
    )  # fmt: skip
    return _row(interval, cell, reference, users)


def _row(
    interval: Interval, cell: tuple[str, str], reference: float, users: tuple[str, str]
) -> IntervalRow:
    parameter, environment = cell
    fields = interval.as_dict() | {"covers": interval.covers_of(*users)}
    return IntervalRow(environment=environment, parameter=parameter, reference=reference, **fields)


def with_left_out(rows: Sequence[IntervalRow], sessions: Sessions) -> list[IntervalRow]:
    """Say how many adjustments of its cell each interval leaves out at limits of their control."""
    counted = []
    for row in rows:
        count = sessions.left_out(row.environment, row.parameter)
        counted.append(dataclasses.replace(row, left_out=count))
    return counted


def compare_intervals(intervals: pd.DataFrame) -> pd.DataFrame:
    """Pair the methods' marginal intervals.

    The shift of the estimates is relative, or in the quantity's unit where one of its references is
    zero or negative.
    """
    marginal = intervals[intervals["joint"] == "marginal"]
    by_difference = marginal.loc[marginal["reference"] <= 0, "parameter"]
    names = ["environment", "parameter", "kind", "family"]
    columns = [*names, "lower", "upper", "estimate"]
    classical = marginal.loc[marginal["method"] == "classical", columns]
    bayesian = marginal.loc[marginal["method"] == "bayesian", columns]
    both = classical.merge(bayesian, on=names, suffixes=("_classical", "_bayesian"))
    low = np.array([both["lower_classical"], both["lower_bayesian"]], dtype=float)
    high = np.array([both["upper_classical"], both["upper_bayesian"]], dtype=float)
    both["width_ratio"] = (high[1] - low[1]) / (high[0] - low[0])
    new = both["estimate_bayesian"]
    old = both["estimate_classical"]
    both["relative"] = ~both["parameter"].isin(by_difference)
    ratio = new / old - 1.0
    both["shift"] = ratio.where(both["relative"], new - old)
    return both


def adjustments(sessions: Sessions) -> Iterator[CellValues]:
    """Describe what was adjusted, on no scale: values, mean and SD of each cell."""
    if sessions.form != "trials":
        return
    for environment, rows in sessions.by_environment():
        for parameter in sessions.parameters:
            known = rows.dropna(subset=f"{parameter}_adj")
            adjusted = known[f"{parameter}_adj"].to_numpy(dtype=float)
            subjects = known["subject"].to_numpy()
            values = subject_means(adjusted, subjects).values.tolist() if len(known) else []
            moments = Moments.from_values(values) if len(values) > 1 else None
            yield CellValues(
                environment=environment,
                parameter=parameter,
                reference=float(rows[f"{parameter}_ref"].iloc[0]),
                n=len(values),
                mean=float(moments.mean) if moments else next(iter(values), None),
                sd=float(moments.sd) if moments else None,
                values=tuple(values),
                unit=sessions.quantities[parameter].unit,
            )


def design_counts(sessions: Sessions) -> DesignCounts | None:
    """Count trials, sessions and cells; None for published limits."""
    if sessions.form != "trials":
        return None
    table = sessions.table
    trials = table.groupby(["subject", "environment"], sort=False).size()
    visits = table.groupby("subject", sort=False)["session"].nunique()
    missing = sum(1 for _ in empty_cells(table, sessions.factors))
    return DesignCounts(
        cells=len(trials) + missing,
        missing=missing,
        trials=(int(trials.min()), int(trials.max())),
        sessions=(int(visits.min()), int(visits.max())),
    )
