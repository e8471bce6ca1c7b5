"""A file as a table: where its columns stand, and what became of its rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import pandas as pd

from percept.sessions.columns import Header, Resolution, unused_columns
from percept.sessions.grids import Block, Grid
from percept.sessions.options import ExcludeRule, ReadOptions
from percept.sessions.records import CellPlace, Exclusion, Notice, Problems, shown
from percept.sessions.values import Names

__all__ = ["FileTable", "OpenFile"]


@dataclass(frozen=True)
class OpenFile:
    """A file whose header is known, and what the study knows so far."""

    name: str
    header: Header
    blocks: Iterator[Block]
    ids: Mapping[str, str]  # Of the file's name
    options: ReadOptions
    problems: Problems
    names: Names


class FileTable(ABC):
    """One file: where its columns stand, its observations, and what became of its rows.

    Attributes
    ----------
    name : str
        The file's name for messages.
    counts : Counter
        Rows by what became of them; complete once `frames` is used up, as are all that follow.
    exclusions : list of Exclusion
        Rows left out by a rule, or for want of an adjustment.
    notices : list of Notice
        Choices made in reading.
    numbered : bool
        Whether a column numbers the trials.
    declared_units : set of str
        Canonical columns whose unit is declared.
    parameters : set of str
        Quantities that have a column of adjustments.
    applied : set of ExcludeRule
        Rules on texts that some row met.
    """

    form: ClassVar[Literal["trials", "summary"]]

    def __init__(self, file: OpenFile, found: Resolution) -> None:
        self.name = file.name
        self.file = file
        self.quantities = file.options.quantities
        self.problems = file.problems
        self.found = found
        self.counts: Counter[str] = Counter()
        self.exclusions: list[Exclusion] = []
        self.notices: list[Notice] = []
        self.numbered = False
        self.declared_units = {c for c, rule in found.rules.items() if rule.unit is not None}
        self.parameters: set[str] = set()
        self.applied: set[ExcludeRule] = set()
        for text in found.announced:
            self._notice(text)
        for column in sorted(file.ids.keys() & found.rules.keys()):
            own = found.rules[column].name
            self._notice(f"{column} is taken from the file's name; column {own!r} is not used")
        if unused := unused_columns(file.header, found, file.options):
            self._notice(f"columns not used: {shown(unused)}")

    @abstractmethod
    def frames(self) -> Iterator[pd.DataFrame]:
        """Give the observations of each block: canonical columns, groups, physical `row`."""

    def _notice(self, text: str) -> None:
        self.notices.append(Notice(text, self.name))

    def _counted(self, block: Block) -> Grid:
        """Split a block into cells, and count its rows."""
        grid = block.grid()
        self.counts["rows read"] += len(grid.cells)
        self.counts.update(grid.dropped)
        return grid

    def _place(self, column: str, row: int | None = None) -> CellPlace:
        """Where a column stands, by its canonical name or, with a prefix, its own."""
        rule = self.found.rules.get(column)
        name = column.rpartition(":")[2] if rule is None else rule.name
        place = CellPlace(file=self.name, column=name)
        if row is not None:
            place["row"] = int(row)
        return place
