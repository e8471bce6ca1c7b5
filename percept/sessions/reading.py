"""Files to tables whose header is known, one after the other."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path

import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Header, check_columns, resolve, unused_columns
from percept.sessions.files import Input, is_workbook, load, open_text
from percept.sessions.grids import Block, text_blocks
from percept.sessions.layout import refuse_headless
from percept.sessions.options import ReadOptions
from percept.sessions.paths import expand, ids_from_name
from percept.sessions.records import NoDataError, Notice, Source, shown
from percept.sessions.table import Log, OpenFile
from percept.sessions.typed import is_typed, sheets, typed_block, typed_rows


def open_files(paths: Sequence[str | Path], log: Log) -> Generator[OpenFile]:
    """Open files; an error of one becomes a problem, so that the next is read too.

    A file is added to the sources once all of it is read.
    """
    wants = log.options.sessions.files.wants
    files, notices = expand(paths, wants)
    log.notices += notices
    for file, named in files.items():
        with log.problems.collecting():
            for entry in load(file, log.options.files):
                is_file = entry.name == file
                if is_file or wants(entry.path):
                    with log.problems.collecting():
                        for part in _parts(entry, log.options):
                            yield from _open_input(part, log, named=named and is_file)


def _parts(entry: Input, options: ReadOptions) -> list[Input]:
    """Give an input, or each sheet of a workbook if the scene wants all; its path ends in it."""
    data = entry.data or b""
    if options.sessions.sheet != "*" or entry.part or not is_workbook(data, entry.name):
        return [entry]
    place = Path(entry.path)
    return [
        Input(f"{entry.name}::{sheet}", str(place / sheet), data, sheet) for sheet in sheets(data)
    ]


def _open_input(entry: Input, log: Log, *, named: bool) -> Generator[OpenFile]:
    """Open one input; nothing comes of a file without trials."""
    with closing(open_blocks(entry, log.options, log.notices)) as blocks:
        try:
            ids = ids_from_name(entry.path, log.options.sessions.filename, file=entry.name)
            table = _open(entry.name, blocks, ids, log)
        except NoDataError as error:
            # A file that somebody named has to hold trials; one of a folder may be a companion.
            if error.column and named:
                raise
            log.without_trials.append(error)
            return
        sha256 = entry.sha256()
        for source in log.sources:
            if source.sha256 == sha256 and entry.part is None:
                message = f"byte for byte the same file as {source.name}."
                raise UsageError(message, file=entry.name, hint="Leave one of them out.")
        yield from _read(table, sha256)


def open_frame(frame: pd.DataFrame, log: Log) -> Generator[OpenFile]:
    """Take a DataFrame as a file; a row's number is its position plus 2, as below a header."""
    limits = log.options.files
    limits.hold_table(len(frame), len(frame.columns), "<frame>")
    rows = [list(frame.columns), *frame.itertuples(index=False, name=None)]
    block = typed_block(rows, "<frame>", limits)
    yield from _read(_open("<frame>", iter([block]), {}, log), "")


def _read(table: OpenFile, sha256: str) -> Generator[OpenFile]:
    """Have a file read, and add it to the sources."""
    counts = table.log.counts
    before = counts["rows read"]
    yield table
    table.log.sources.append(Source(table.name, sha256, counts["rows read"] - before))


def _open(name: str, blocks: Iterator[Block], ids: Mapping[str, str], log: Log) -> OpenFile:
    """Find out from the header what kind of table a file is."""
    first = next(blocks)
    grid = first.grid()
    header = Header(grid.header, name, log.paths)
    found = resolve(header, log.options)
    file = OpenFile(name, header, found, ids, chain([first], blocks), log)
    if found.form == "trials":
        try:
            check_columns(header, found, log.options, ids)
        except UsageError:
            columns = [column.tolist() for _, column in grid.cells.items()]
            refuse_headless(grid.header, columns, name)
            raise
        log.numbered |= file.is_numbered
        log.parameters |= {p for p in log.options.quantities if f"{p}_adj" in found.rules}
        log.declared_units |= {c for c, rule in found.rules.items() if rule.unit is not None}
    for text in found.announced:
        file.notice(text)
    for column in sorted(ids.keys() & found.rules.keys()):
        own = found.rules[column].name
        file.notice(f"{column} is taken from the file's name; column {own!r} is not used")
    if unused := unused_columns(header, found, log.options):
        file.notice(f"columns not used: {shown(unused)}")
        log.unused = log.unused or [own for own in unused if header.names.count(own) == 1]
    return file


def open_blocks(entry: Input, options: ReadOptions, notices: list[Notice]) -> Generator[Block]:
    """Give the cells of one input, whatever its format, in blocks."""
    file = entry.name
    if is_typed(entry):
        part = entry.part or options.sessions.sheet
        rows = typed_rows(entry.read(options.files), file, part, options.files)
        yield typed_block(rows, file, options.files)
        return
    text, encoding = open_text(entry, options.sessions.encoding)
    if encoding == "cp1252" and options.sessions.encoding is None:
        notices.append(Notice("not UTF-8; read as Windows-1252", file))

    def resolves(names: list[str]) -> bool:
        """Whether a header, split by some delimiter, has columns that are read."""
        try:
            found = resolve(Header(names, file), options)
        except UsageError:
            return False
        adjusted = any(f"{p}_adj" in found.rules for p in options.quantities)
        return adjusted or found.form == "summary"

    yield from text_blocks(text, file=file, delimiter=options.sessions.delimiter, resolves=resolves)
