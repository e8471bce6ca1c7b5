"""A published table of limits, kept as it was printed: n, level, and the digits of every limit."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.classical.quantiles import t_upper
from percept.sessions import ReadOptions, read_sessions
from percept.sessions.columns import resolve
from percept.sessions.problems import shown
from percept.sessions.read import read_grid_of
from percept.sessions.sources import load
from percept.simulate.design import PARAMETERS, Design, Parameter

COLUMNS = ("environment", "parameter", "reference", "lower", "upper", "n", "level")


@dataclass(frozen=True, eq=False)
class PublishedLimits:
    """Limits of t-intervals as printed, for J environments and P parameters.

    Parameters
    ----------
    environments : tuple of str
        Names, J of them.
    parameters : tuple of {"k", "b"}
        P of them.
    reference, lower, upper : tuple of tuple of Decimal
        (J, P), in N/m and N·s/m, with the decimals that were printed.
    n : int
        Number of subjects.
    level : float
        Confidence level.
    """

    environments: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    reference: tuple[tuple[Decimal, ...], ...]
    lower: tuple[tuple[Decimal, ...], ...]
    upper: tuple[tuple[Decimal, ...], ...]
    n: int
    level: float

    @classmethod
    def from_table(cls, table: pd.DataFrame, *, file: str | None = None) -> PublishedLimits:
        """Check a summary table and keep its digits.

        Parameters
        ----------
        table : pandas.DataFrame
            Columns environment, parameter, reference, lower, upper, n, level. Cells that are text
            keep their printed digits; of numbers the shortest text counts.
        file : str, optional
            Where the table came from, for messages; its index then counts lines after the header.

        Returns
        -------
        PublishedLimits
            The table, environments in order of appearance.

        Raises
        ------
        UsageError
            A missing column, a cell that is no number, a limit out of order, a parameter that is not
            k or b, a cell given twice or not at all, several n or levels, an n or level out of range.
        """
        _require_columns(table, file)
        lines = list(table.index + 2) if file else list(range(2, len(table) + 2))
        numbers = {
            column: [_number(cell, column, row, file) for row, cell in zip(lines, table[column], strict=True)]
            for column in COLUMNS[2:]
        }
        cells = _positions(table, lines, file)
        _require_order(numbers["lower"], numbers["upper"], lines, file)
        environments = tuple(dict.fromkeys(environment for environment, _ in cells))
        parameters = tuple(p for p in PARAMETERS if any(parameter == p for _, parameter in cells))
        for environment, parameter in itertools.product(environments, parameters):
            if (environment, parameter) not in cells:
                raise UsageError(
                    f"{environment} has no row for {parameter}, though others have.",
                    file=file,
                    column="parameter",
                )
        n = _one(numbers["n"], "n", lines, file)
        if n != int(n) or n < 2:
            raise UsageError(
                "n must be a whole number of subjects, at least 2.", file=file, column="n", value=str(n)
            )
        level = _one(numbers["level"], "level", lines, file)
        if not 0 < level < 1:
            raise UsageError(
                "the level must lie between 0 and 1.", file=file, column="level", value=str(level)
            )

        def grid(column: str) -> tuple[tuple[Decimal, ...], ...]:
            return tuple(
                tuple(numbers[column][cells[environment, parameter]] for parameter in parameters)
                for environment in environments
            )

        return cls(
            environments=environments,
            parameters=parameters,
            reference=grid("reference"),
            lower=grid("lower"),
            upper=grid("upper"),
            n=int(n),
            level=float(level),
        )

    @property
    def factor(self) -> float:
        """Half-width of the interval in standard deviations, t/√n (Eq. 15)."""
        return float(t_upper((1 - self.level) / 2, self.n - 1) / np.sqrt(self.n))

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean of the subjects, (J, P): the middle of the limits."""
        return (np.array(self.lower, dtype=float) + np.array(self.upper, dtype=float)) / 2

    @property
    def sd(self) -> NDArray[np.float64]:
        """Standard deviation of the subjects, (J, P), backed out of the limits' distance."""
        return (np.array(self.upper, dtype=float) - np.array(self.lower, dtype=float)) / (2 * self.factor)

    def design(self, subjects: int) -> Design:
        """One trial of each subject in each environment of the table.

        Parameters
        ----------
        subjects : int
            Number of subjects.

        Returns
        -------
        Design
            With the table's names and references.
        """
        return Design.balanced(
            np.array(self.reference, dtype=float),
            subjects=subjects,
            parameters=self.parameters,
            environments=self.environments,
        )


def read_summary(path: str | os.PathLike[str], *, options: ReadOptions | None = None) -> PublishedLimits:
    """Read a published table from a file, digits kept.

    Parameters
    ----------
    path : str or path-like
        A file that `percept.read_sessions` reads as a summary, with limits.
    options : ReadOptions, optional
        How to read it.

    Returns
    -------
    PublishedLimits
        The table.

    Raises
    ------
    UsageError
        If the file cannot be read or its table is not a summary.
    """
    file, options = str(Path(path)), options or ReadOptions()
    if not Path(file).is_file():
        raise UsageError("there is no such file.", file=file)
    tables = list(load(file))
    if len(tables) != 1:
        raise UsageError(f"{len(tables)} tables where one is needed.", file=file, hint="Unpack the archive.")
    grid = read_grid_of(tables[0], options, [])
    found = resolve(grid.header, options.columns, file=file)
    if found.form != "summary":
        raise UsageError(
            f"no table of published limits; the columns are {shown(grid.header)}.",
            file=file,
            row=1,
            hint=f"It needs {', '.join(COLUMNS)}; the scene's [columns] says which is which.",
        )
    read_sessions(file, options=options)
    columns = found.slots[0].columns
    # The reader has held all numbers to one decimal mark, so a comma is nothing else.
    text = {
        c: [record[at] if c == "environment" else record[at].replace(",", ".") for record in grid.cells]
        for c, at in columns.items()
    }
    return PublishedLimits.from_table(pd.DataFrame(text, index=np.array(grid.rows) - 2), file=file)


def _require_columns(table: pd.DataFrame, file: str | None) -> None:
    for column in COLUMNS:
        if column not in table:
            raise UsageError(
                "the summary has no such column.",
                file=file,
                column=column,
                hint="Printed limits are what is reproduced; percept fit works them out of means and SDs."
                if "mean" in table
                else f"It needs {', '.join(COLUMNS)}.",
            )
    if table.empty:
        raise UsageError("the summary has no rows.", file=file)


def _positions(table: pd.DataFrame, lines: list[int], file: str | None) -> dict[tuple[str, str], int]:
    """Position in the table of every (environment, parameter)."""
    cells: dict[tuple[str, str], int] = {}
    for i, (environment, parameter) in enumerate(zip(table["environment"], table["parameter"], strict=True)):
        if parameter not in PARAMETERS:
            raise UsageError(
                "a parameter is k or b.", file=file, row=lines[i], column="parameter", value=parameter
            )
        first = cells.setdefault((str(environment), parameter), i)
        if first != i:
            raise UsageError(
                f"{environment}, {parameter} was given before, in row {lines[first]}.",
                file=file,
                row=lines[i],
                column="parameter",
                value=parameter,
            )
    return cells


def _require_order(lower: list[Decimal], upper: list[Decimal], lines: list[int], file: str | None) -> None:
    for row, low, high in zip(lines, lower, upper, strict=True):
        if low >= high:
            raise UsageError(
                f"the upper limit must be above the lower one, {low}.",
                file=file,
                row=row,
                column="upper",
                value=str(high),
            )


def _number(cell: object, column: str, row: int, file: str | None) -> Decimal:
    try:
        number = Decimal(str(cell).strip())
    except InvalidOperation:
        number = Decimal("NaN")
    if not number.is_finite():
        raise UsageError(
            "a number is needed here.",
            file=file,
            row=row,
            column=column,
            value=cell,
            hint="Write it with a '.'.",
        )
    return number


def _one(numbers: list[Decimal], column: str, lines: list[int], file: str | None) -> Decimal:
    for row, number in zip(lines, numbers, strict=True):
        if number != numbers[0]:
            raise UsageError(
                f"all rows must have the same {column}; the first has {numbers[0]}.",
                file=file,
                row=row,
                column=column,
                value=str(number),
            )
    return numbers[0]
