"""A study being read, file by file: what is opened, left out, noticed and counted on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path

import pandas as pd

from percept.errors import UsageError, counted
from percept.sessions import checks
from percept.sessions.files import Input, expand, ids_from_name, load
from percept.sessions.formats import frame_grid, open_blocks
from percept.sessions.grids import Block
from percept.sessions.options import ReadOptions
from percept.sessions.records import IDS, Exclusion, NoDataError, Notice, Problems, Source
from percept.sessions.table import FileTable

#: Suffixes of files of other kinds that are named.
_KINDS = 6


class Reading:
    """A study being read, file by file: its sources, and what was noticed so far."""

    def __init__(self, options: ReadOptions) -> None:
        self.options = options
        self.problems = Problems()
        self.sources: list[Source] = []
        self.notices: list[Notice] = []
        self.exclusions: list[Exclusion] = []
        self.left_out: list[NoDataError] = []
        self.counts: Counter[str] = Counter()
        self.numbered = False  # Whether a column of any file numbers the trials
        self.declared_units = {name for references in options.environments.values() for name in references}

    def tables(self, paths: Sequence[str | Path]) -> Generator[FileTable]:
        """Open the files; an error of one becomes a problem, so that the next is read too."""
        found = expand(paths)
        self.notices += [Notice("a folder of results is not read", file=folder) for folder in found.results]
        if found.ignored:
            kinds = ", ".join(
                sorted({Path(name).suffix or Path(name).name for name in found.ignored})[:_KINDS]
            )
            text = f"{counted(len(found.ignored), 'file')} of other kinds in the folders not read ({kinds})"
            self.notices.append(Notice(text))
        wants = self.options.files.wants
        files = [name for name in found.files if name not in found.inside or wants(name)]
        if len(files) < len(found.files):
            left = counted(len(found.files) - len(files), "file")
            self.notices.append(Notice(f"{left} in the folders left out by [sessions.files]"))
        if not files:
            message, hint = "no file in the folders fits include and exclude.", "Correct the patterns."
            raise UsageError(message, key="sessions.files", hint=hint)
        if found.repeated:
            self.notices.append(Notice("a file that is named more than once is read once"))
        for file in files:
            with self.problems.collecting():
                for entry in load(file):
                    if entry.path != file and not wants(entry.path):
                        continue
                    with (
                        self.problems.collecting(),
                        closing(open_blocks(entry, self.options, self.notices)) as blocks,
                    ):
                        try:
                            named = ids_from_name(entry.path, self.options.filename, file=entry.name)
                            table = FileTable(entry.name, blocks, self.options, named, self.problems)
                        except NoDataError as error:
                            # A file that was named is asked for; what a folder holds may be a companion.
                            if error.column and file not in found.inside and entry.path == file:
                                raise
                            self.left_out.append(error)
                            continue
                        sha256 = self._new(entry)
                        yield table
                        self._add(table, sha256)

    def frame(self, frame: pd.DataFrame) -> Generator[FileTable]:
        """Take a DataFrame as a file."""
        name = "<frame>"
        blocks = iter([Block(cells=frame_grid(frame, file=name))])
        table = FileTable(name, blocks, self.options, {}, self.problems)
        yield table
        self._add(table, "")

    def _new(self, entry: Input) -> str:
        """Refuse a file that was read already, under whatever name."""
        sha256 = entry.sha256()
        if (twin := next((s.name for s in self.sources if s.sha256 == sha256), None)) is not None:
            hint = "Leave one of them out."
            raise UsageError(f"byte for byte the same file as {twin}.", file=entry.name, hint=hint)
        return sha256

    def _add(self, table: FileTable, sha256: str) -> None:
        """Take up what is known of a file once all of it is read."""
        self.sources.append(Source(table.name, sha256, table.counts["rows read"]))
        self.notices += table.notices
        self.numbered |= table.numbered
        self.exclusions += table.exclusions
        self.counts.update(table.counts)
        self.declared_units |= table.declared_units

    def refuse_nothing(self, frames: Sequence[pd.DataFrame]) -> None:
        """Raise the problems found, or that no row is left; notice environments that no row has."""
        if not self.sources:
            for error in self.left_out:
                self.problems.extend(error)
        self.problems.raise_if_any()
        self.notices += [Notice(f"left out: {error.message}", error.file) for error in self.left_out]
        if not any(map(len, frames)):
            left = ", ".join(f"{n} {why}" for why, n in self.counts.items())
            hint = f"Rows: {left}."
            raise UsageError("no row holds an adjustment.", file=self.sources[0].name, hint=hint)
        present = {name for frame in frames if len(frame) for name in frame["environment"].unique()}
        unnamed = (name for name in self.options.environments if name not in present)
        self.notices += [Notice("[environments] names it, and no row does", column=name) for name in unnamed]

    def settled(self, table: pd.DataFrame) -> pd.DataFrame:
        """Look at ids and cells over all files; a row of the table may stand for as many as `rows` says."""
        rows = table["rows"] if "rows" in table else pd.Series(1, index=table.index)
        if self.options.unfinished == "exclude":
            kept, unfinished = checks.drop_unfinished(table)
            self.exclusions += unfinished
            if unfinished:
                self.counts["excluded: unfinished subject"] = int(rows.sum() - rows[kept.index].sum())
            table, rows = kept.reset_index(drop=True), rows[kept.index]
        for what in IDS:
            self.notices += checks.look_alikes(table[what].unique(), what)
        if table["session"].nunique() > 1:
            self.notices += checks.repeats_over_sessions(table)
        self.counts.update(checks.count_grid(table, rows))
        return table
