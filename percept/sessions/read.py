"""Files to Sessions: every file read on its own, then checked together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions import checks
from percept.sessions.columns import resolve
from percept.sessions.decode import decode
from percept.sessions.dialect import Grid, read_grid
from percept.sessions.observations import read_part
from percept.sessions.options import IDS, ReadOptions
from percept.sessions.part import Part
from percept.sessions.problems import Problems
from percept.sessions.recognise import refuse_binary, refuse_text
from percept.sessions.records import SUMMARY_COLUMNS, TRIAL_COLUMNS, Exclusion, Notice, Sessions, Source
from percept.sessions.sources import Expanded, Input, expand, is_workbook, load, names_from_file
from percept.sessions.stream import NotPlain, open_stream
from percept.sessions.tables import excel_grid, frame_grid, parquet_grid


def read_sessions(
    *paths: str | Path, columns: Mapping[str, Any] | None = None, options: ReadOptions | None = None
) -> Sessions:
    """Read session files into one checked table.

    Parameters
    ----------
    *paths : str or Path
        Files, folders, glob patterns, or "-" for standard input; CSV in any dialect, gz and zip archives of
        them, Parquet and Excel.
    columns : mapping, optional
        From canonical name (subject, session, environment, trial, k_ref, b_ref, k_adj, b_adj) to the files'
        own column name or a table {name, unit, path}; it goes before `options.columns`.
    options : ReadOptions, optional
        How to read them; the scene's tables give one by `ReadOptions.from_mapping`.

    Returns
    -------
    Sessions
        Values in N/m and N·s/m; rows in the order of the files.

    Raises
    ------
    UsageError
        What cannot be read as it stands, each problem with file, row, column, value and what to do; a
        :class:`~percept.sessions.problems.ReadError` lists up to ten and holds them all.
    """
    options = (options or ReadOptions()).with_columns(columns)
    study = _Study(options)
    found = expand(paths)
    study.notices += not_read(found)
    for file in found.files:
        with study.collecting():
            if study.add_large(file):
                continue
            for entry in load(file):
                with study.collecting():
                    study.add(entry)
    return study.sessions()


def sessions_from_frame(frame: pd.DataFrame, *, options: ReadOptions | None = None) -> Sessions:
    """Build Sessions from a DataFrame, with the same checks as a file; see `Sessions.from_frame`."""
    if not isinstance(frame, pd.DataFrame):
        raise UsageError(
            f"a DataFrame is needed, not {type(frame).__name__}.", hint="read_sessions reads files."
        )
    study = _Study(options or ReadOptions())
    name = "<frame>"
    study.take(frame_grid(frame, file=name), name, "", {})
    return study.sessions()


def not_read(found: Expanded) -> list[Notice]:
    """Notice what the paths held beside tables."""
    notices = [Notice("a folder of results is not read", file=folder) for folder in found.results]
    if found.ignored:
        notices.append(Notice(f"{len(found.ignored)} files of other kinds in the folders are not read"))
    if found.repeated:
        notices.append(Notice("a file that is named more than once is read once"))
    return notices


def never_named(options: ReadOptions, present: Collection[str]) -> list[Notice]:
    """Notice environments that the scene declares and no row has."""
    return [
        Notice("[environments] names it, and no row does", column=name)
        for name in options.environments
        if name not in present
    ]


def read_parts(file: str, options: ReadOptions) -> tuple[list[Part], list[Source], list[Notice]]:
    """Read the tables of one file without the checks that need the whole study."""
    study = _Study(options)
    for entry in load(file):
        with study.collecting():
            study.add(entry)
    study.problems.raise_if_any()
    return study.parts, study.sources, study.notices + [n for part in study.parts for n in part.notices]


def read_grid_of(entry: Input, options: ReadOptions, notices: list[Notice]) -> Grid:
    """Cells of one input, whatever its format."""
    file, data = entry.name, entry.data
    refuse_binary(data, file=file)
    if data.startswith(b"PAR1"):
        return parquet_grid(data, file=file)
    if data.startswith(b"PK\x03\x04") and is_workbook(data, file):
        return excel_grid(data, file=file, sheet=options.sheet)
    decoded = decode(data, file=file, encoding=options.encoding)
    if decoded.encoding == "cp1252" and options.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))
    refuse_text(decoded.text, file=file)

    def resolves(header: list[str]) -> bool:
        try:
            found = resolve(header, options.columns, file=file)
        except UsageError:
            return False
        return found.form == "summary" or bool(found.present & {"k_adj", "b_adj"})

    return read_grid(decoded.text, file=file, delimiter=options.delimiter, resolves=resolves)


@dataclass
class _Study:
    """The files read so far, and what was noticed."""

    options: ReadOptions
    parts: list[Part] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    problems: Problems = field(default_factory=Problems)

    def collecting(self) -> _Collector:
        """Context in which an error of ours becomes a problem, so that the next file is read too."""
        return _Collector(self.problems)

    def add_large(self, file: str) -> bool:
        """Read a large plain file in blocks; False where it has to be read as a whole."""
        if file == "-":
            return False
        problems = Problems()
        named = names_from_file(file, self.options.filename, file=file)
        stream = open_stream(file, options=self.options, named=named, problems=problems)
        if stream is None:
            return False
        try:
            blocks = [block for block in stream.frames() if len(block)]
        except NotPlain:
            return False
        problems.raise_if_any()
        checks.refuse_twin(self.sources, file, stream.sha256)
        self.sources.append(Source(file, stream.sha256, stream.part.counts["rows read"]))
        if blocks:
            for block in blocks:
                for c in IDS:
                    block[c] = np.asarray(block[c], dtype=object)
            stream.part.frame = pd.concat(blocks, ignore_index=True)
        stream.part.frame["file"] = len(self.sources) - 1
        self.parts.append(stream.part)
        return True

    def add(self, entry: Input) -> None:
        """Read one input."""
        checks.refuse_twin(self.sources, entry.name, entry.sha256)
        self.sources.append(Source(entry.name, entry.sha256, 0))
        named = names_from_file(entry.path, self.options.filename, file=entry.name)
        self.take(read_grid_of(entry, self.options, self.notices), entry.name, entry.sha256, named)

    def take(self, grid: Grid, name: str, sha256: str, named: Mapping[str, str]) -> None:
        """Read the observations of one grid of cells."""
        part = read_part(grid, file=name, options=self.options, named=named, problems=self.problems)
        source = Source(name, sha256, len(grid.cells))
        if self.sources and self.sources[-1].name == name:
            self.sources[-1] = source
        else:
            self.sources.append(source)
        part.frame["file"] = len(self.sources) - 1
        self.parts.append(part)

    def sessions(self) -> Sessions:
        """Merge the files by column name and check them together."""
        forms = {part.form for part in self.parts}
        if len(forms) > 1:
            at = next(i for i, part in enumerate(self.parts) if part.form != self.parts[0].form)
            self.problems.add(
                "trials and a published summary cannot be read together.",
                file=self.sources[int(self.parts[at].frame["file"].iloc[0])].name,
                hint="Read them one by one.",
            )
        self.problems.raise_if_any()
        table = pd.concat([part.frame for part in self.parts], ignore_index=True)
        counts: Counter[str] = Counter()
        for part in self.parts:
            counts.update(part.counts)
            self.notices.extend(part.notices)
        if not len(table):
            left = ", ".join(f"{n} {why}" for why, n in counts.items())
            raise UsageError("no row holds an adjustment.", file=self.sources[0].name, hint=f"Rows: {left}.")
        present = set(table["environment"].astype(str)) if "environment" in table else set()
        self.notices += never_named(self.options, present)
        merged = _summary if forms == {"summary"} else _trials
        return merged(self, table, counts)

    def place(self, table: pd.DataFrame) -> checks.Place:
        """Where a row of the merged table stood."""
        files, rows = table["file"].to_numpy(), table["row"].to_numpy()
        return lambda at: {"file": self.sources[int(files[at])].name, "row": int(rows[at])}


class _Collector:
    def __init__(self, problems: Problems) -> None:
        self._problems = problems

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> bool:
        if isinstance(error, UsageError):
            self._problems.extend(error)
            return True
        return False


def _trials(study: _Study, table: pd.DataFrame, counts: Counter[str]) -> Sessions:
    options, problems = study.options, study.problems
    exclusions: list[Exclusion] = [e for part in study.parts for e in part.exclusions]
    measured = set().union(*(part.parameters for part in study.parts))
    parameters = [p for p in ("k", "b") if p in measured]
    place = study.place(table)
    checks.settle_references(table, options.environments, parameters, place, problems)
    checks.check_duplicates(table, place, problems)
    units = set().union(*(part.declared_units for part in study.parts))
    units |= checks.units_of_scene(options.environments)
    study.notices += checks.check_plausible(table, parameters, units, place, problems)
    problems.raise_if_any()
    if options.unfinished == "exclude":
        kept, unfinished = checks.drop_unfinished(table)
        exclusions += unfinished
        if unfinished:
            counts["excluded: unfinished subject"] = len(table) - len(kept)
        table = kept.reset_index(drop=True)
    for what in IDS:
        study.notices += checks.look_alikes(table[what].unique(), what)
    if table["session"].nunique() > 1:
        by_cell = table.groupby(["subject", "environment"], sort=False, observed=True)["session"]
        study.notices += checks.repeats_over_sessions(by_cell.nunique())
    counts.update(checks.count_grid(table, parameters))
    groups = [c for c in table.columns if c not in TRIAL_COLUMNS and c not in ("row", "file")]
    return _finish(study, table, "trials", [*TRIAL_COLUMNS, *groups], exclusions, counts)


def _summary(study: _Study, table: pd.DataFrame, counts: Counter[str]) -> Sessions:
    checks.check_summary(table, study.place(table), study.problems)
    study.problems.raise_if_any()
    table["n"] = table["n"].astype(np.int64)
    counts["observations"] = len(table)
    return _finish(study, table, "summary", SUMMARY_COLUMNS, [], counts)


def _finish(
    study: _Study,
    table: pd.DataFrame,
    form: Any,
    columns: Sequence[str],
    exclusions: Sequence[Exclusion],
    counts: Counter[str],
) -> Sessions:
    text = [c for c in ("subject", "session", "environment", "parameter") if c in columns]
    tidy = table[list(columns)].copy()
    for column in [*text, *(c for c in columns if c not in (*TRIAL_COLUMNS, *SUMMARY_COLUMNS))]:
        # A file that lacks a group column leaves blanks, never the text "nan".
        tidy[column] = tidy[column].fillna("").astype(str)
    return Sessions(
        table=tidy,
        form=form,
        sources=tuple(study.sources),
        notices=tuple(_unique(study.notices)),
        exclusions=tuple(exclusions),
        counts=dict(counts),
        provenance=table[["file", "row"]].astype(np.int64),
    )


def _unique(notices: Sequence[Notice]) -> Iterator[Notice]:
    return iter(dict.fromkeys(notices))
