"""A file whose header is known, and what the reader says of a study beside its table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from percept.sessions.columns import Header, Resolution
from percept.sessions.grids import Block
from percept.sessions.options import ExcludeRule, ReadOptions
from percept.sessions.records import (
    CellPlace,
    Exclusion,
    NoDataError,
    Notice,
    Place,
    Places,
    Problems,
    Source,
)
from percept.sessions.values import Names


class Log:
    """What is said of a study while it is read: each step adds to it."""

    def __init__(self, options: ReadOptions, paths: Sequence[str] = ()) -> None:
        self.options = options
        self.paths = paths  # As they were given
        self.problems = Problems()
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.exclusions: list[Exclusion] = []
        self.without_trials: list[NoDataError] = []
        self.unused: list[str] = []  # Columns of the first file that nothing is read from
        self.at_limits: list[pd.DataFrame] = []  # Adjustments left out at limits of controls
        self.counts: Counter[str] = Counter()  # Rows by what became of them
        self.parameters: set[str] = set()  # Quantities with a column of adjustments
        self.numbered = False  # Whether a column of any file numbers the trials
        self.applied: set[ExcludeRule] = set()  # Rules on texts that some row met
        self.declared_units = {name for own in options.environments.values() for name in own}
        self.names = Names()
        for environment in options.environments:
            self.names.add("environment", environment)

    def places(self, table: pd.DataFrame) -> Places:
        """Return where a row of the table, by its position, stands."""
        files = table["file"].to_numpy()
        rows = table["row"].to_numpy()
        return lambda at: Place(file=self.sources[int(files[at])].name, row=int(rows[at]))


@dataclass(frozen=True)
class OpenFile:
    """A file whose header is known."""

    name: str
    header: Header
    found: Resolution
    ids: Mapping[str, str]  # Of the file's name
    blocks: Iterator[Block]
    log: Log

    @property
    def options(self) -> ReadOptions:
        """How the study is read."""
        return self.log.options

    @property
    def is_numbered(self) -> bool:
        """Whether a column numbers the trials."""
        return "trial" in self.found.rules or any(slot.trial for slot in self.found.slots)

    def notice(self, text: str) -> None:
        """Say something about the whole file."""
        self.log.notices.append(Notice(text, self.name))

    def cells(self, block: Block) -> pd.DataFrame:
        """Split a block into cells, and count its rows."""
        grid = block.grid()
        self.log.counts["rows read"] += len(grid.cells)
        self.log.counts.update(grid.dropped)
        return grid.cells

    def place(self, column: str, row: int | None = None) -> CellPlace:
        """Where a column stands, by its canonical name or its own."""
        rule = self.found.rules.get(column)
        place = CellPlace(file=self.name, column=column if rule is None else rule.name)
        if row is not None:
            place["row"] = int(row)
        return place
