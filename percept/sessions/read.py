"""Files to Sessions: every file read on its own, then checked together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import doubts, merged
from percept.sessions.options import DataTables, canonical_columns
from percept.sessions.quantities import Quantities, Quantity
from percept.sessions.records import (
    IDS,
    MASS,
    SUMMARY_COLUMNS,
    Exclusion,
    Factors,
    Found,
    Notice,
    Source,
    once_per_text,
)
from percept.sessions.tables import Form, Log, OpenFile, open_files, open_frame
from percept.sessions.trials import read_summary, read_trials
from percept.sessions.values import fold


@dataclass(frozen=True, eq=False)
class Sessions:
    """A study's observations in one tidy table, with their provenance.

    Attributes
    ----------
    table : DataFrame
        Trial form: `subject`, `session`, `environment` (text), `k_ref` (N/m), `b_ref` (N·s/m),
        `trial` (whole number), `k_adj` (N/m), `b_adj` (N·s/m), then any group columns (text); a
        parameter that was not measured is NaN throughout, a single missing adjustment is NaN.
        `m_ref` (kg) stands there where an environment has a mass. Summary form: `environment`,
        `parameter` ("k" or "b"), `reference`, `lower`, `upper` (N/m or N·s/m), `n`, `level`. Other
        quantities stand in the places of k and b, in their own units. Rows stand in the order of
        the files.
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
        `file` (index into `sources`) and `row` (physical line, the header being 1) of each row of
        `table`.
    options : DataTables
        How the files were read: the scene, if there was one.
    factors : Factors, optional
        The conditions or groups that `environment` tells apart.
    at_limits : DataFrame
        Rows with an adjustment that is left out at a limit of its control; `parameter` names it.
    """

    table: pd.DataFrame
    form: Form
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    provenance: pd.DataFrame = field(default_factory=lambda: pd.DataFrame({"file": [], "row": []}))
    options: DataTables = field(default_factory=DataTables)
    factors: Factors | None = None
    at_limits: pd.DataFrame = field(default_factory=pd.DataFrame)

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        scene: DataTables | None = None,
    ) -> Sessions:
        """Build from a DataFrame as :func:`read_sessions` does; its header is row 1."""
        log = Log(scene)
        return _merged(log, open_frame(frame, log))

    @property
    def quantities(self) -> Quantities:
        """What may be adjusted, by name."""
        return self.options.quantities

    @property
    def parameters(self) -> tuple[str, ...]:
        """The quantities with at least one observation, by name and in the scene's order."""
        if self.form == "summary":
            present = set(self.table["parameter"])
            return tuple(p for p in self.quantities if p in present)
        return tuple(p for p in self.quantities if self.table[f"{p}_adj"].notna().any())

    @property
    def adjusted(self) -> list[Quantity]:
        """The quantities that `parameters` names."""
        return [self.quantities[name] for name in self.parameters]

    @property
    def simulated(self) -> bool:
        """Whether the data say of themselves, in a column `source`, that some are simulated."""
        return "source" in self.table and bool((self.table["source"] == "simulated").any())

    @property
    def subjects(self) -> tuple[str, ...]:
        """Subject ids in order of first appearance; empty in summary form."""
        return tuple(self.table["subject"].unique()) if self.form == "trials" else ()

    @cached_property
    def environments(self) -> tuple[str, ...]:
        """Environment ids as the scene lists them, then by their references."""
        listed = self.options.environments if self.factors is None else self.factors.cells
        ranks = {name: rank for rank, name in enumerate(listed)}
        references = self.references
        by_reference = references.sort_values(list(references.columns), kind="stable").index
        return tuple(sorted(by_reference, key=lambda name: ranks.get(name, len(ranks))))

    @property
    def references(self) -> pd.DataFrame:
        """Reference of every environment, by first appearance, and quantity."""
        names = list(self.quantities)
        if self.form == "trials":
            columns = {f"{p}_ref": p for p in names}
            references = self.table.groupby("environment", sort=False)[list(columns)].first()
            return references.rename(columns=columns)
        wide = self.table.pivot_table("reference", "environment", "parameter", sort=False)
        return wide.reindex(columns=names)

    @property
    def masses(self) -> dict[str, float]:
        """Mass of each environment, kg; 0 where the study gives none."""
        if MASS not in self.table:
            declared = self.options.environments
            return {name: declared.get(name, {}).get(MASS, 0.0) for name in self.environments}
        known = self.table.drop_duplicates("environment").set_index("environment")[MASS]
        return {name: float(known[name]) for name in self.environments}

    def by_environment(self) -> Iterator[tuple[str, pd.DataFrame]]:
        """Give the rows of each environment, in the order of `environments`."""
        rows = dict(list(self.table.groupby("environment", sort=False)))
        return ((name, rows[name]) for name in self.environments)

    @cached_property
    def warnings(self) -> tuple[Notice, ...]:
        """What to look at before believing the study."""
        if self.form == "summary":
            return ()
        found = doubts.doubts(self.table, self.adjusted, self.options, self.factors)
        return tuple(Notice(one.message, *self.locate(one.row), one.column) for one in found)

    @cached_property
    def slips(self) -> tuple[Found, ...]:
        """Adjustments that look mistyped, by the labels of their rows; none in summary form."""
        return tuple(doubts.slips(self.table, self.adjusted)) if self.form == "trials" else ()

    def left_out(self, environment: str, parameter: str) -> int:
        """Count the adjustments of a cell that are left out at a limit of their control."""
        if self.at_limits.empty:
            return 0
        of_cell = self.at_limits["environment"] == environment
        of_cell &= self.at_limits["parameter"] == parameter
        # Some analyses are of a part of the subjects.
        return int((of_cell & self.at_limits["subject"].isin(self.table["subject"])).sum())

    def locate(self, index: Any) -> tuple[str | None, int | None]:
        """File and physical row (the header is 1) of an observation, by its label in `table`.

        A table made by hand has neither.
        """
        if index not in self.provenance.index:
            return None, None
        file, row = self.provenance.loc[index, ["file", "row"]]
        return self.sources[int(file)].name, int(row)

    def _repr_html_(self) -> str:
        """Show the first rows, the counts and the notices in a notebook."""
        lines = [f"{number} {reason}" for reason, number in self.counts.items()]
        lines += [str(notice) for notice in self.notices]
        items = "".join(f"<li>{escape(line)}</li>" for line in lines)
        return f"{self.table.head(10).to_html(escape=True, index=False)}<ul>{items}</ul>"


def read_sessions(*paths: str | Path, scene: DataTables | None = None) -> Sessions:
    """Read session files into one checked table.

    Parameters
    ----------
    *paths : str or Path
        Files, folders or glob patterns; docs/files.md lists what percept reads.
    scene : Scene, optional
        Its [quantities], [columns], [sessions], [environments], [files] and [study] factor say how
        the files are read. Give the same scene to :class:`~percept.Study`.

    Returns
    -------
    Sessions
        Values in N/m and N·s/m, or the units of the quantities declared; rows in the order of the
        files.

    Raises
    ------
    UsageError
        What cannot be read as it stands, each problem with file, row, column, value and what to do;
        a :class:`~percept.sessions.ReadError` lists up to ten and holds them all.
    """
    log = Log(scene, paths)
    return _merged(log, open_files(paths, log))


def _merged(log: Log, files: Iterable[OpenFile]) -> Sessions:
    """Merge the files by column name and check them together."""
    frames = []
    forms: set[Form] = set()
    for file in files:
        with log.collecting():
            forms.add(file.form)
            frame = read_summary(file) if file.form == "summary" else read_trials(file)
            frames.append(frame.assign(file=len(log.sources) - 1))
            log.notices += file.grid.notices
    if len(forms) > 1:
        message = "trials and a published summary cannot be read together."
        log.add(message, hint="Read them one by one.")
    if not log.sources:
        for error in log.without_trials:
            log.extend(error)
    log.raise_if_any()
    for error in log.without_trials:
        log.notices.append(Notice(f"left out: {error.message}", error.file))
    (form,) = forms
    table = pd.concat(frames, ignore_index=True)
    _refuse_nothing(log, table)
    if form == "summary":
        log.refuse(table, merged.summary(table, log.options))
        log.raise_if_any()
        log.counts["observations"] = len(table)
        tidy = table[list(SUMMARY_COLUMNS)].astype({"n": np.int64})
    else:
        table = _checked_trials(log, table)
        tidy = table.drop(columns=["file", "row"])
    return Sessions(
        table=tidy,
        form=form,
        sources=tuple(log.sources),
        notices=once_per_text(log.notices),
        exclusions=tuple(log.exclusions),
        counts=dict(log.counts),
        provenance=table[["file", "row"]].astype(np.int64),
        options=log.options,
        at_limits=pd.concat(log.at_limits) if log.at_limits else pd.DataFrame(),
    )


def _refuse_nothing(log: Log, table: pd.DataFrame) -> None:
    """Refuse a rule that no row met, or a table without rows; notice environments without any."""
    for rule in log.options.sessions.exclude:
        # Limits may well be kept by all rows.
        if rule.equals and rule not in log.applied:
            raise UsageError(
                f"no row has {' or '.join(map(repr, rule.equals))} in this column.",
                key="sessions.exclude",
                column=rule.column,
                hint="Correct the text, or take the rule out.",
            )
    if table.empty:
        rows = ", ".join(f"{number} {reason}" for reason, number in log.counts.items())
        message = "no row has an adjustment."
        raise UsageError(message, file=log.sources[0].name, hint=f"Rows: {rows}.")
    folded = set(map(fold, table["environment"].unique()))
    for name in log.options.environments:
        if fold(name) not in folded:
            log.notices.append(Notice("[environments] names it, but no row has it", column=name))


def _checked_trials(log: Log, table: pd.DataFrame) -> pd.DataFrame:
    """Settle the names and references of all trials, and check them as a whole."""
    options = log.options
    quantities = [q for name, q in options.quantities.items() if name in log.parameters]
    others = (*canonical_columns(options.quantities), MASS, "row", "file")
    groups = [str(name) for name in table if name not in others]
    # A file that lacks a group column leaves blanks, never the text "nan".
    table[groups] = table[groups].fillna("").astype("str")
    merged.settle_names(table, groups, log)
    merged.settle_references(table, quantities, log)
    merged.make_absolute(table, quantities, log)
    table = merged.without_ends(table, quantities, log)
    if options.sessions.trial == "order":
        table["trial"] = table.groupby(list(IDS), sort=False).cumcount() + 1
    log.refuse(table, merged.repeats(table, log))
    log.refuse(table, merged.units(table, quantities, log))
    log.raise_if_any()
    for text in merged.remarks(table, log):
        log.notices.append(Notice(text))
    log.counts.update(merged.count_grid(table, quantities))
    return table
