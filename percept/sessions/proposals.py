"""A mapping proposed for files with unknown column names, and tried on all of them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePath

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.errors import PerceptError, UsageError, counted
from percept.sessions.columns import Header, resolve
from percept.sessions.evidence import Column, table_columns
from percept.sessions.files import Input, load
from percept.sessions.options import ReadOptions, canonical_columns
from percept.sessions.paths import expand, pattern_of_names
from percept.sessions.proposed import Draft, outcome
from percept.sessions.quantities import IMPEDANCE, factor, quantity_of
from percept.sessions.read import Sessions, read_sessions
from percept.sessions.reading import open_blocks
from percept.sessions.records import IDS, MASS, Problems, ReadError, shown
from percept.sessions.roles import (
    ID_COLUMNS,
    Numbers,
    Roles,
    crossed_with_environment,
    drop_unnamed_subject,
    judge_environment,
    judge_ids,
    judge_numbers,
    take_most_varied,
)
from percept.sessions.wide import wide_quantities

__all__ = ["Proposal", "propose_columns"]

#: Files of a folder, and members of an archive, that are looked at.
_FILES = 40
#: Kinds of files, by their headers, that a mapping is looked for in; kinds with most rows first.
_KINDS = 4
#: Kinds that a remark names beside the one that it is of.
_LISTED_KINDS = 5
#: Attempts to read under a draft: each takes back one guess.
_ATTEMPTS = 8
#: Share of a guessed column's cells that may be wrong: a few refute nothing.
_WRONG = 0.1
#: More environments than these, each of hardly two trials, are no environments.
_MOST_ENVIRONMENTS = 20
#: Rows from which on a table may have one per subject.
_FEWEST_SUBJECTS = 3
#: Above this share of all, values of zero or below are meant.
_FEW_ZEROS = 0.05


@dataclass(frozen=True)
class Proposal:
    """How percept would read a file with unknown column names."""

    text: str  #: TOML of a scene; comments say what was seen, what else it could be, what it gives
    guessed: tuple[str, ...]  #: Canonical columns that rest on words and values
    missing: tuple[str, ...]  #: Canonical columns that an analysis needs and that were not found
    may_be_means: bool = False  #: Whether the text has lines to uncomment where nothing was matched
    refused: UsageError | None = None  #: Why the file is not read under the proposal


@dataclass(frozen=True)
class _Table:
    """The cells of files that have one header."""

    names: list[str]  # Of the files, for messages
    paths: list[str]
    header: list[str]
    cells: pd.DataFrame
    file_codes: npt.NDArray[np.intp]  # By row


def propose_columns(*paths: str | Path, options: ReadOptions | None = None) -> Proposal:
    """Propose how to read files with unknown column names, and try it on all of them.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`; files of one header are judged together,
        and the kind of file with the fewest gaps counts.
    options : ReadOptions, optional
        How to read them; columns that it declares stay.

    Returns
    -------
    Proposal
        With `refused`, where the files are not read under it.

    Raises
    ------
    UsageError
        No file is a table.
    """
    options = options or ReadOptions()
    problems = Problems()
    kinds: dict[tuple[str, ...], list[tuple[Input, pd.DataFrame]]] = {}
    for file in islice(expand(paths, options.sessions.files.wants)[0], _FILES):
        with problems.collecting():
            for entry in islice(load(file, options.files), _FILES):
                with problems.collecting():
                    header, cells = _whole(entry, options)
                    kinds.setdefault(tuple(header), []).append((entry, cells))
    if not kinds:
        problems.raise_if_any()
    tables = [_together(list(header), parts) for header, parts in kinds.items()]
    tables.sort(key=lambda table: -len(table.cells))
    proposals = []
    for table in tables[:_KINDS]:
        others = [other for other in tables if other is not table]
        proposals.append(_proposed(table, paths, options, _other_kinds(table, others)))
    return min(proposals, key=lambda proposal: (len(proposal.missing), not proposal.guessed))


def _whole(entry: Input, options: ReadOptions) -> tuple[list[str], pd.DataFrame]:
    """Read the header and all cells of one input."""
    with closing(open_blocks(entry, options, [])) as blocks:
        grids = [block.grid() for block in blocks]
    return grids[0].header, pd.concat([grid.cells for grid in grids])


def _together(header: list[str], parts: Sequence[tuple[Input, pd.DataFrame]]) -> _Table:
    """Put files of one header together."""
    names = []
    paths = []
    frames = []
    for entry, cells in parts:
        names.append(entry.name)
        paths.append(entry.path)
        frames.append(cells)
    codes = np.repeat(np.arange(len(frames)), [len(frame) for frame in frames])
    return _Table(names, paths, header, pd.concat(frames, ignore_index=True), codes)


def _other_kinds(table: _Table, others: Sequence[_Table]) -> list[str]:
    """Say which files a proposal is not of, and how to choose them."""
    if not others:
        return []
    kinds = f"{1 + len(others)} kinds of files, by their columns"
    said = [f"There are {kinds}. This is of {counted(len(table.names), 'file')}:"]
    said.append(f"  {shown(table.header)}")
    for other in others[:_LISTED_KINDS]:
        example = shown([PurePath(other.paths[0]).name])
        said.append(f"not of {counted(len(other.names), 'file')} such as {example}:")
        said.append(f"  {shown(other.header)}")
    if len(others) > _LISTED_KINDS:
        said.append(f"nor of {len(others) - _LISTED_KINDS} further kinds")
    said.append("For another kind give --from its files alone. To keep to a kind in a folder, name")
    said.append('its files by a pattern: [sessions.files] include = ["*.csv"].')
    return said


def _proposed(
    table: _Table, paths: Sequence[str | Path], options: ReadOptions, remarks: Sequence[str]
) -> Proposal:
    """Propose a mapping; guesses that the files refute are dropped."""
    draft = _draft(table, options)
    draft.remarks += remarks
    refused: UsageError | None = None
    for _ in range(_ATTEMPTS):
        # References are the analyst's to fill in: the others of a draft are tried without them.
        if any(not canonical.endswith("_ref") for canonical in draft.missing):
            break
        try:
            sessions = _read_under(draft, paths, options)
        except UsageError as error:
            refused = error
            wrong = _refuted(draft, error)
        else:
            refused = None
            wrong = _moment(draft, sessions)
            if wrong is None:
                draft.scales = _scales(sessions)
                draft.outcome = outcome(sessions, draft)
                break
        if wrong is None:
            break
        _drop(draft, wrong)
        _settle(draft, options)
    guessed = draft.guessed
    if draft.wide:
        guessed = (*guessed, *draft.wide_adjusted)
    if draft.filename:
        guessed = ("subject", *guessed)
    return Proposal(
        text=draft.text(),
        guessed=guessed,
        missing=draft.missing,
        may_be_means=bool(draft.unmatched),
        refused=refused,
    )


def _draft(table: _Table, options: ReadOptions) -> Draft:
    """Judge what stands where."""
    columns = table_columns(table.header, table.cells)
    by_name = {column.name: column for column in columns}
    declared = () if options.quantities == IMPEDANCE else tuple(options.quantities)
    roles = Roles(declared=declared)
    remarks = []
    try:
        rules = resolve(Header(table.header, table.names[0]), options).rules
    except PerceptError as error:
        remarks.append(str(error))
        wanted = canonical_columns(options.quantities)
        roles.found = {name: by_name[name] for name in wanted if name in by_name}
    else:
        for canonical, rule in rules.items():
            if rule.name in by_name:
                roles.found[canonical] = by_name[rule.name]
    draft = Draft(
        file=table.names[0],
        files=len(table.names),
        rows=len(table.cells),
        columns=columns,
        roles=roles,
        known=frozenset(roles.found),
        remarks=remarks,
    )
    judge_ids(roles, _free(draft))
    _find_adjustments(draft, table, options)
    # Responses in order stay for a run of rows, as ids do.
    guessed_subject = "subject" in draft.guessed
    if not draft.found_any and guessed_subject and drop_unnamed_subject(roles):
        _find_adjustments(draft, table, options)
    _settle(draft, options)
    return draft


def _find_adjustments(draft: Draft, table: _Table, options: ReadOptions) -> None:
    """Find what was adjusted, its references and what tells environments apart."""
    roles = draft.roles
    if "subject" not in roles.found and options.sessions.filename is None:
        draft.filename = pattern_of_names(table.paths)
    subject = roles.found.get("subject")
    subjects = table.file_codes if subject is None else subject.codes
    numbers = Numbers.of(_free(draft), subjects)
    if not roles.has_adjustment:
        judge_numbers(roles, numbers)
    if not roles.has_adjustment and (subject is None or len(subject.texts) == draft.rows):
        _take_for_wide(draft)
    if not draft.found_any:
        if subject is None and len(table.names) == 1:
            numbers = Numbers.of(_free(draft), np.arange(draft.rows))
        take_most_varied(roles, numbers)
    if roles.has_adjustment:
        judge_environment(roles, _free(draft))
        draft.crossed = crossed_with_environment(roles, _free(draft))
        # Without any id a row is a subject.
        no_id = subject is None and not any(_may_be_id(column) for column in _free(draft))
        draft.by_row = no_id and draft.filename is None and not _names_subjects(options)


def _may_be_id(column: Column) -> bool:
    """Whether values of a column come again: they may name subjects."""
    recurs = 2 < len(column.texts) < len(column.cells)
    return recurs and (column.is_whole or not column.is_numeric)


def _take_for_wide(draft: Draft) -> None:
    """Take a table with a row per subject for one with a column per environment."""
    if draft.rows < _FEWEST_SUBJECTS:
        return
    draft.wide = wide_quantities(_free(draft))
    if not draft.wide:
        return
    for name, wide in draft.wide.items():
        draft.roles.units[name] = next(iter(wide.columns.values())).unit or ""
    draft.filename = None
    draft.by_row = "subject" not in draft.roles.found


def _names_subjects(options: ReadOptions) -> bool:
    """Whether a scene says how subjects are named without a column."""
    return options.sessions.filename is not None or options.sessions.subject == "row"


def _free(draft: Draft) -> list[Column]:
    """Give the columns that have no part yet."""
    taken = draft.roles.taken
    return [column for column in draft.columns if column not in taken]


def _settle(draft: Draft, options: ReadOptions) -> None:
    """Say what is missing, and whether the order of rows has to number the trials."""
    found = draft.roles.found
    needed = []
    if not draft.by_row and draft.filename is None and not _names_subjects(options):
        needed.append("subject")
    # Adjustments without a column of conditions are of one condition.
    if not draft.roles.has_adjustment:
        needed.append("environment")
    numbers = [canonical for canonical in found if canonical not in (*ID_COLUMNS, MASS)]
    quantities = dict.fromkeys(quantity_of(canonical) for canonical in numbers)
    present = set(found)
    if draft.wide:
        present |= {"subject", "environment", *draft.wide_adjusted}
        quantities |= dict.fromkeys(draft.wide)
    for name in quantities or ["NAME"]:
        if name not in options.quantities or options.quantities[name].is_matched:
            needed.append(f"{name}_ref")
        needed.append(f"{name}_adj")
    for references in options.environments.values():
        present.update(references)
    draft.missing = tuple(canonical for canonical in needed if canonical not in present)
    draft.repeats = 0
    if "trial" in found or options.sessions.keep or draft.by_row:
        return
    ids = [found[canonical].cells for canonical in IDS if canonical in found]
    if ids:
        draft.repeats = int(pd.concat(ids, axis=1).duplicated().sum())


def _drop(draft: Draft, canonical: str) -> None:
    """Take a guess back, and with a reference the environments that it told apart."""
    column = draft.roles.found.pop(canonical)
    if canonical.endswith("_ref") and draft.roles.found.get("environment") is column:
        del draft.roles.found["environment"]


def _read_under(draft: Draft, paths: Sequence[str | Path], options: ReadOptions) -> Sessions:
    """Read all files under a draft; a reference that is missing is the median adjustment."""
    tables = tomllib.loads(draft.text())
    changed = dict(options)
    changed["columns"] = {**tables["columns"], **options.columns}
    changed["sessions"] = {
        **options.sessions.model_dump(),
        **tables.get("sessions", {}),
    }
    if "quantities" in tables:
        changed["quantities"] = tables["quantities"]
    if draft.missing:
        changed["environments"] = {name: _medians(draft) for name in draft.conditions}
    return read_sessions(*paths, scene=ReadOptions(**changed))


def _medians(draft: Draft) -> dict[str, float]:
    """Give the median adjustment in the place of each reference that is missing."""
    medians = {}
    # No adjustment equals it: nobody seems to have left the reference as it was.
    beside = 1.0 + 1e-9
    for canonical in draft.missing:
        name = quantity_of(canonical)
        if name in draft.wide:
            columns = list(draft.wide[name].columns.values())
        else:
            columns = [draft.roles.found[f"{name}_adj"]]
        median = float(np.nanmedian(np.concatenate([column.numbers for column in columns])))
        scale = factor(columns[0].unit, IMPEDANCE[name]) if name in IMPEDANCE else 1
        medians[canonical] = median * float(scale) * beside
    return medians


def _refuted(draft: Draft, error: UsageError) -> str | None:
    """Name a guess that an attempt to read refutes; a few wrong cells refute none."""
    problems = error.problems if isinstance(error, ReadError) else (error,)
    for problem in problems:
        if problem.column in draft.guessed and problem.column.endswith("_ref"):
            # It differs within an environment.
            return problem.column
    names = [problem.column for problem in problems]
    for canonical in draft.guessed:
        if names.count(draft.roles.found[canonical].name) > _WRONG * draft.rows:
            return canonical
    repeated = None in names
    return "trial" if repeated and "trial" in draft.roles.found else None


def _moment(draft: Draft, sessions: Sessions) -> str | None:
    """Name a guessed reference that differs in nearly every row: it is a time or a measurement."""
    environments = len(sessions.environments)
    if environments <= _MOST_ENVIRONMENTS or environments < len(sessions.table) / 2:
        return None
    return next((c for c in draft.guessed if c.endswith("_ref")), None)


def _scales(sessions: Sessions) -> dict[str, float | None]:
    """Give quantities whose values have no logarithm a unit, None where references give one."""
    scales: dict[str, float | None] = {}
    for name in sessions.parameters:
        if not sessions.options.quantities[name].is_matched:
            # Its zero references stand for none, and its scene has a scale.
            continue
        adjusted = sessions.table[f"{name}_adj"].dropna().to_numpy()
        references = sessions.table[f"{name}_ref"].to_numpy()
        many_zeros = np.mean(adjusted <= 0) > _FEW_ZEROS
        negative = bool((adjusted < 0).any())
        if not many_zeros and not negative and (references > 0).all():
            continue
        scales[name] = None
        spread = float(np.std(adjusted))
        if (references == 0).any() and spread > 0:
            scales[name] = float(f"{spread:.1g}")
    return scales
