"""What the reader hands over: the tidy table, where each row came from, and what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pandas as pd

if TYPE_CHECKING:
    from percept.sessions.options import ReadOptions

TRIAL_COLUMNS = ("subject", "session", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj")
SUMMARY_COLUMNS = ("environment", "parameter", "reference", "lower", "upper", "n", "level")


@dataclass(frozen=True)
class Source:
    """One file that was read: its name, the SHA-256 of its bytes, and its data rows."""

    name: str
    sha256: str
    rows: int


@dataclass(frozen=True)
class Notice:
    """Something the reader decided or noticed that the analyst should know."""

    text: str
    file: str | None = None
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.row, self.column) if part is not None)
        return f"{place}: {self.text}" if place else self.text


@dataclass(frozen=True)
class Exclusion:
    """One observation or subject left out: who, what was left out, why, and where it stood."""

    who: str
    what: str
    why: str
    file: str | None = None
    row: int | None = None


@dataclass(frozen=True, eq=False)
class Sessions:
    """A study's observations in one tidy table, with their provenance.

    Attributes
    ----------
    table : DataFrame
        Trial form: `subject`, `session`, `environment` (text), `k_ref` (N/m), `b_ref` (N·s/m), `trial`
        (whole number), `k_adj` (N/m), `b_adj` (N·s/m), then any group columns (text); a parameter that
        was not measured is NaN throughout, a single missing adjustment is NaN. Summary form:
        `environment`, `parameter` ("k" or "b"), `reference`, `lower`, `upper` (N/m or N·s/m), `n`, `level`.
        Rows stand in the order of the files.
    form : {"trials", "summary"}
        Which of the two forms `table` has.
    sources : tuple of Source
        The files read, in order.
    notices : tuple of Notice
        Every choice the reader announced.
    exclusions : tuple of Exclusion
        Every observation left out by a declared rule or for want of an adjustment.
    counts : mapping of str to int
        Rows by what became of them.
    provenance : DataFrame
        `file` (index into `sources`) and `row` (physical line, the header being 1) of each row of `table`.
    """

    table: pd.DataFrame
    form: Literal["trials", "summary"]
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    provenance: pd.DataFrame = field(default_factory=lambda: pd.DataFrame({"file": [], "row": []}))

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, *, options: ReadOptions | None = None) -> Sessions:
        """Build from a DataFrame, with the same checks as a file.

        Parameters
        ----------
        frame : DataFrame
            Columns as in a session file; numbers in N/m and N·s/m unless `options` declares a unit.
        options : ReadOptions, optional
            How to read it.

        Returns
        -------
        Sessions

        Raises
        ------
        UsageError
            As :func:`percept.sessions.read_sessions`; a row is the position in `frame` plus 2.
        """
        from percept.sessions.read import sessions_from_frame

        return sessions_from_frame(frame, options=options)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters with at least one observation: a subset of ("k", "b")."""
        if self.form == "summary":
            present = set(self.table["parameter"])
            return tuple(p for p in ("k", "b") if p in present)
        return tuple(p for p in ("k", "b") if self.table[f"{p}_adj"].notna().any())

    @property
    def simulated(self) -> bool:
        """Whether the data say of themselves, in a column `source`, that some are simulated."""
        return "source" in self.table and bool((self.table["source"] == "simulated").any())

    @property
    def subjects(self) -> tuple[str, ...]:
        """Subject ids in order of first appearance; empty in summary form."""
        return tuple(self.table["subject"].unique()) if self.form == "trials" else ()

    @property
    def environments(self) -> tuple[str, ...]:
        """Environment ids in order of first appearance."""
        return tuple(self.table["environment"].unique())

    @cached_property
    def doubts(self) -> tuple[Notice, ...]:
        """What to look at before believing the study: slips, knobs that never moved, cells not tried."""
        from percept.sessions.doubts import doubts

        return doubts(self)

    def locate(self, index: int) -> tuple[str, int]:
        """File name and physical row of an observation.

        Parameters
        ----------
        index : int
            Label in the index of `table`.

        Returns
        -------
        file : str
        row : int
            Physical line in `file`, the header being 1.
        """
        at = self.provenance.index.get_loc(index)
        file, row = (int(self.provenance[c].to_numpy()[at]) for c in ("file", "row"))
        return self.sources[file].name, row

    def to_csv(self, path: str | Path, *, for_spreadsheets: bool = False) -> None:
        """Write the table as a CSV file that reads back to the same table.

        Parameters
        ----------
        path : str or Path
            The file; it is replaced if it exists.
        for_spreadsheets : bool, optional
            Put an apostrophe before text that a spreadsheet would run as a formula.
        """
        from percept.sessions.write import write_csv

        write_csv(self, path, for_spreadsheets=for_spreadsheets)

    def _repr_html_(self) -> str:
        counts = "".join(
            f"<tr><td>{escape(reason)}</td><td>{number}</td></tr>" for reason, number in self.counts.items()
        )
        notices = "".join(f"<li>{escape(str(notice))}</li>" for notice in self.notices)
        head = self.table.head(10).to_html(escape=True, index=False)
        return f"{head}<table>{counts}</table><ul>{notices}</ul>"
