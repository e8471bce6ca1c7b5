"""Published tables: limits, or means and standard deviations, by environment and parameter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Resolution
from percept.sessions.grids import Grid
from percept.sessions.records import shown
from percept.sessions.table import FileTable, OpenFile
from percept.sessions.values import decimal_mark, is_missing, parse_numbers

__all__ = ["SummaryTable"]

#: Limits at any level give back the mean and SD they were made of.
_LEVEL = 0.95


class SummaryTable(FileTable):
    """A published table of limits, or of means and standard deviations."""

    form: ClassVar[Literal["trials", "summary"]] = "summary"

    def __init__(self, file: OpenFile, found: Resolution) -> None:
        super().__init__(file, found)
        self._columns = found.slots[0].columns
        self._has_limits = {"lower", "upper"} <= self._columns.keys()

    def frames(self) -> Iterator[pd.DataFrame]:
        """Give the rows of each block with limits; means and SDs become limits."""
        self._require_columns()
        if self._has_limits and self._columns.keys() & {"mean", "sd"}:
            self._notice("mean and sd are not used: lower and upper are there")
        if "level" not in self._columns:
            self._notice(f"means and SDs without a level are kept as their limits at {_LEVEL}")
        for block in self.file.blocks:
            yield self._frame(self._counted(block))

    def _numbers(self) -> list[str]:
        """Name the columns of numbers that are read."""
        pair = ["lower", "upper"] if self._has_limits else ["mean", "sd"]
        names = ["reference", *pair, "n"]
        if self._has_limits or "level" in self._columns:
            names.append("level")
        return names

    def _require_columns(self) -> None:
        """Refuse a table that lacks a column, or declares a unit."""
        for column in ("environment", *self._numbers()):
            if column not in self._columns:
                there = shown(self.file.header.names)
                message = f"a published table needs the column {column}; the columns are {there}."
                hint = "Add it, or name it in the scene's [columns]."
                raise self.file.header.error(message, column, hint)
        if self.declared_units:
            quantities = self.quantities.values()
            units = " and ".join(quantity.unit for quantity in quantities)
            message = f"a published table is in {units}."
            raise UsageError(message, file=self.name, key="columns", hint="Convert the table.")

    def _frame(self, grid: Grid) -> pd.DataFrame:
        """Convert the cells of a block."""
        texts = {column: grid.cells[at].tolist() for column, at in self._columns.items()}
        rows = grid.cells.index.to_numpy()
        frame = pd.DataFrame({"environment": texts["environment"], "parameter": texts["parameter"]})
        numbers = {name: texts[name] for name in self._numbers()}
        frame = frame.assign(**self._converted(numbers, rows), row=rows)
        if "level" not in frame:
            frame["level"] = _LEVEL
        return frame if self._has_limits else self._with_limits(frame)

    def _converted(
        self, texts: dict[str, list[str]], rows: npt.NDArray[np.int64]
    ) -> dict[str, npt.NDArray[np.float64]]:
        """Convert columns of numbers, which have no empty cell."""
        mark = self.file.options.sessions.decimal
        if mark is None:
            mark = decimal_mark(list(texts.items()), rows, file=self.name, problems=self.problems)
        converted = {}
        for name, cells in texts.items():
            converted[name] = parse_numbers(cells, rows, mark, self.problems, self._place(name))
            empty = [is_missing(cell) for cell in cells]
            for row in rows[empty].tolist():
                place = self._place(name, row)
                self.problems.add(
                    "a published table has no empty cells.", hint="Fill it in.", **place
                )
        return converted

    def _with_limits(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Replace means and SDs by their t-limits."""
        from scipy.special import stdtrit

        sd = frame["sd"]
        for row, value in zip(frame["row"][sd < 0], sd[sd < 0], strict=True):
            place = self._place("sd", int(row))
            problem = "a standard deviation is not negative."
            self.problems.add(problem, value=float(value), hint="Correct it.", **place)
        n = frame["n"]
        level = frame["level"]
        # Impossible n and levels are told by the checks of the whole study.
        possible = (n >= 2) & (level > 0) & (level < 1)
        df = (n - 1).where(possible)
        tail = (0.5 * (1 - level)).where(possible)
        half = -stdtrit(df, tail) / np.sqrt(df + 1) * sd
        limits = frame.assign(lower=frame["mean"] - half, upper=frame["mean"] + half)
        return limits.drop(columns=["mean", "sd"])
