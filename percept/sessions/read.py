"""Files to Sessions: every file read on its own, then checked together."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions import checks, doubts
from percept.sessions.options import DataTables, ReadOptions
from percept.sessions.quantities import Quantities, trial_columns
from percept.sessions.reading import Reading
from percept.sessions.records import (
    IDS,
    MASS,
    SUMMARY_COLUMNS,
    Exclusion,
    Factor,
    Notice,
    Place,
    Source,
    shown,
)
from percept.sessions.table import FileTable


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
    options : ReadOptions
        How the files were read.
    factor : Factor, optional
        The factor within subjects whose levels `environment` tells apart.
    """

    table: pd.DataFrame
    form: Literal["trials", "summary"]
    sources: tuple[Source, ...] = ()
    notices: tuple[Notice, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    provenance: pd.DataFrame = field(default_factory=lambda: pd.DataFrame({"file": [], "row": []}))
    options: ReadOptions = field(default_factory=ReadOptions)
    factor: Factor | None = None

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        scene: DataTables | None = None,
        options: ReadOptions | None = None,
    ) -> Sessions:
        """Build from a DataFrame as :func:`read_sessions` does from a file, its header being row 1."""
        if not isinstance(frame, pd.DataFrame):
            hint = "read_sessions reads files."
            raise UsageError(f"a DataFrame is needed, not {type(frame).__name__}.", hint=hint)
        reading = Reading(options or ReadOptions.of(scene))
        return _merged(reading, reading.frame(frame))

    @property
    def quantities(self) -> Quantities:
        """What may be adjusted, by name."""
        return self.options.quantities

    @property
    def parameters(self) -> tuple[str, ...]:
        """The quantities with at least one observation, by name; of k and b in this order by default."""
        if self.form == "summary":
            present = set(self.table["parameter"])
            return tuple(p for p in self.quantities if p in present)
        return tuple(p for p in self.quantities if self.table[f"{p}_adj"].notna().any())

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
        listed = self.options.environments if self.factor is None else self.factor.cells
        return checks.in_order(self._references, listed)

    @property
    def _references(self) -> pd.DataFrame:
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
        """What to look at before believing the study: gross errors, unchanged controls, missing cells."""
        quantities = [self.quantities[p] for p in self.parameters]
        scales = doubts.doubtful_scales(self._references, quantities)
        if self.form != "trials":
            return tuple(scales)

        def place(index: int) -> Place:
            # Sessions put together by hand have no places.
            if index not in self.provenance.index:
                return Place()
            file, row = self.locate(index)
            return Place(file=file, row=row)

        pooled = self.options.pooled(self.table.columns)
        seldom = doubts.screen(self.table, quantities, place, pooled, self.options.family)
        return (*scales, *seldom)

    def locate(self, index: int) -> tuple[str, int]:
        """File name and physical row (the header being 1) of an observation, by its label in `table`."""
        at = self.provenance.index.get_loc(index)
        file, row = (int(self.provenance[c].to_numpy()[at]) for c in ("file", "row"))
        return self.sources[file].name, row

    def _repr_html_(self) -> str:
        told = [
            *(f"{number} {reason}" for reason, number in self.counts.items()),
            *map(str, self.notices),
        ]
        items = "".join(f"<li>{escape(text)}</li>" for text in told)
        return f"{self.table.head(10).to_html(escape=True, index=False)}<ul>{items}</ul>"


def read_sessions(
    *paths: str | Path | pd.DataFrame,
    scene: DataTables | None = None,
    columns: Mapping[str, Any] | None = None,
    options: ReadOptions | None = None,
) -> Sessions:
    """Read session files, or a DataFrame, into one checked table.

    Parameters
    ----------
    *paths : str, Path or DataFrame
        Files, folders or glob patterns; CSV in any dialect, gz and zip archives of them, Parquet
        and Excel. Or one DataFrame, with the columns of a session file.
    scene : Scene, optional
        Its [quantities], [columns], [sessions], [environments] and [study] factor say how the files
        are read. Give the same scene to :class:`~percept.Study`.
    columns : mapping, optional
        From canonical name (subject, session, environment, trial, k_ref, b_ref, k_adj, b_adj) to
        the files' own column name or a table {name, unit, path}. It goes before the scene's.
    options : ReadOptions, optional
        How to read them, in place of a scene.

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
    options = (options or ReadOptions.of(scene)).with_columns(columns)
    files = [path for path in paths if not isinstance(path, pd.DataFrame)]
    for frame in (path for path in paths if isinstance(path, pd.DataFrame)):
        if len(paths) > 1:
            raise UsageError(
                "a DataFrame is read alone.", hint="Put all rows into one: pandas.concat."
            )
        return Sessions.from_frame(frame, options=options)
    reading = Reading(options)
    return _merged(reading, reading.tables(files))


def _merged(reading: Reading, tables: Generator[FileTable]) -> Sessions:
    """Merge the files by column name and check them together."""
    frames: list[pd.DataFrame] = []
    forms: dict[str, str] = {}
    present: set[str] = set()
    options, problems, quantities = reading.options, reading.problems, reading.options.quantities
    with closing(tables):
        for table in tables:
            with problems.collecting():
                forms.setdefault(table.form, table.name)
                present |= table.parameters
                frames += [frame.assign(file=len(reading.sources)) for frame in table.frames()]
    if len(forms) > 1:
        message = "trials and a published summary cannot be read together."
        problems.add(message, file=list(forms.values())[1], hint="Read them one by one.")
    reading.refuse_nothing(frames)
    merged = pd.concat(frames, ignore_index=True)
    place = reading.places(merged)
    columns, groups = list(SUMMARY_COLUMNS), list[str]()
    if "summary" in forms:
        checks.check_summary(merged, options, place, problems)
        problems.raise_if_any()
        merged["n"] = merged["n"].astype(np.int64)
        reading.counts["observations"] = len(merged)
    else:
        parameters = [p for p in quantities if p in present]
        if options.sessions.trial == "order":
            merged["trial"] = merged.groupby(list(IDS), sort=False).cumcount() + 1
        checks.settle_references(merged, options.environments, {}, parameters, place, problems)
        split = [name for name in options.split if name in merged]
        checks.check_duplicates(merged, place, problems, numbered=reading.numbered, split=split)
        reading.check(merged, parameters, pd.Series(1, index=merged.index))
        reading.counts.update(
            {f"rows without {p}": int(merged[f"{p}_adj"].isna().sum()) for p in parameters}
        )
        columns = [*trial_columns(quantities)]
        groups = [str(c) for c in merged if c not in (*columns, MASS, "row", "file")]
        columns += [*([MASS] if MASS in merged else []), *groups]
    # A file that lacks a group column leaves blanks, never the text "nan".
    tidy = merged[columns].assign(**{c: merged[c].fillna("").astype("str") for c in groups})
    return Sessions(
        table=tidy,
        form="summary" if "summary" in forms else "trials",
        sources=tuple(reading.sources),
        notices=tuple(dict.fromkeys(reading.notices)),
        exclusions=tuple(reading.exclusions),
        counts=dict(reading.counts),
        provenance=merged[["file", "row"]].astype(np.int64),
        options=options,
    )


def refuse_gaps(sessions: Sessions, column: str) -> None:
    """Refuse a column that does not put every row of trials into a group."""
    if sessions.form == "summary":
        message, hint = (
            "published limits hold no subjects to divide.",
            "Give sessions, or two studies.",
        )
        raise UsageError(message, column=column, hint=hint)
    table = sessions.table
    if column not in table:
        message = f"the sessions have no such column; they have {', '.join(map(str, table))}."
        hint = (
            "Read the files with the scene that names it: read_sessions(files, scene=scene)."
            f' A column of groups is kept by [sessions] groups = ["{column}"].'
        )
        raise UsageError(message, column=column, hint=hint)
    blank = table[column].astype(str).str.strip() == ""
    if blank.any():
        file, row = sessions.locate(int(table.index[blank][0]))
        message = f"{counted(int(blank.sum()), 'row')} without a value, of no group."
        hint = "Fill them in, or leave such rows out with [sessions] exclude."
        raise UsageError(message, file=file, row=row, column=column, hint=hint)
    if table[column].nunique() < 2:
        raise UsageError("all rows have one value: there is nothing to compare.", column=column)


def by_level(sessions: Sessions, column: str) -> Sessions:
    """Make each environment at each level of a column an environment of its own, such as "VE1 (left)"."""
    if sessions.factor is not None:
        return sessions
    refuse_gaps(sessions, column)
    names, levels = sessions.table["environment"], sessions.table[column].astype(str)
    factor = Factor(column, tuple(levels.unique()), {})
    present = set(zip(names, levels, strict=True))
    ordered = [pair for pair in product(sessions.environments, factor.levels) if pair in present]
    cells = {factor.cell(*pair): pair for pair in ordered}
    if len(cells) < len(ordered):
        hint = "Name environments or levels without brackets."
        raise UsageError(
            f"two cells would have one name: {shown(list(cells))}.", column=column, hint=hint
        )
    table = sessions.table.assign(environment=names + " (" + levels + ")")
    return replace(sessions, table=table, factor=replace(factor, cells=cells))
