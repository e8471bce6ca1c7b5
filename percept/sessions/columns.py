"""Which column is which: the scene's map first, then exact names, then known aliases, announced."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from percept.errors import UsageError, did_you_mean
from percept.sessions.grid import Grid
from percept.sessions.options import (
    KEPT_COLUMNS,
    ColumnRule,
    DataTables,
    canonical_columns,
)
from percept.sessions.quantities import Quantities, with_mass
from percept.sessions.records import IDS, MOMENTS_COLUMNS, SUMMARY_COLUMNS, NoDataError, shown

_WORDS = {
    "subject": (
        "participant participant_id participant_private_id subject_nr subject_id subject_number"
        " subj sub ppid"
    ),
    "session": "session_num session_number session_id session_nr visit",
    "environment": "env environment_id ve virtual_environment reference_environment",
    "trial": "trial_num trial_number trial_no trial_index trials_thisn",
}
#: Beside or before the name or the label of a quantity.
_NUMBER_WORDS = {"ref": ("ref", "reference"), "adj": ("adj", "adjusted", "final")}
#: An id that the names of a wide table's columns hold, and the same in an escaped pattern.
_IN_NAMES = re.compile(r"\{(subject|session|environment|trial)\}")
_ID = re.compile(r"\\\{(subject|session|environment|trial)\\\}")
_NAME_COLUMNS = (
    "Name it in the scene's [columns]. Subjects may stand in file names, [sessions] filename ="
    ' "{subject}", and references in [environments]. [quantities] names what people adjusted beside'
    " stiffness and damping."
)
#: Environment of trials that only their own references tell apart.
_ALL_TRIALS = "all trials"
#: Rules by canonical column; the name of one is a column of the header, or a pattern of several.
Rules = dict[str, ColumnRule]


@dataclass(frozen=True)
class Slot:
    """One set of adjustments in a row: all of a long table, one environment of a wide one."""

    columns: Mapping[str, int]  # From canonical name to a position in the header
    ids: Mapping[str, str]  # Read from the names of columns


def resolve(grid: Grid, options: DataTables) -> tuple[tuple[Slot, ...], Rules]:
    """Find the canonical columns in a header; announce choices that nobody declared.

    A long table has one slot, a wide one a slot for each environment (and trial).
    """
    known = {plain(name) for name in grid.header} | options.columns.keys()
    wanted = canonical_columns(options.quantities)
    for columns in (MOMENTS_COLUMNS, SUMMARY_COLUMNS):
        if {"parameter", *columns[3:5]} <= known:
            wanted = columns
    if options.sessions.trial == "order":
        wanted = tuple(column for column in wanted if column != "trial")
    rules = {name: rule for name, rule in options.columns.items() if name in wanted}
    if options.sessions.layout == "subjects in columns":
        rules.setdefault(f"{next(iter(options.quantities))}_adj", ColumnRule(name="{subject}"))
    _by_name(grid, wanted, rules, options)
    _refuse_missing(grid, rules)
    _name_by_reference(grid, rules, options)
    return _slots(grid, rules, options), rules


def _by_name(
    grid: Grid,
    wanted: Sequence[str],
    rules: Rules,
    options: DataTables,
) -> None:
    """Find the columns that no rule names by percept's names, or aliases; announce the latter."""
    taken = {rule.name for rule in rules.values()}
    known = aliases(options.quantities)
    for canonical in wanted:
        if canonical in rules:
            continue
        names = known.get(canonical, {canonical})
        found = [name for name in grid.header if name not in taken and plain(name) in names]
        if canonical in grid.header:
            found = [canonical]
        if len(found) > 1:
            message = f"{shown(found)} could each be {canonical}."
            hint = f'Declare the one that is meant: [columns] {canonical} = "…".'
            raise grid.error(message, canonical, hint)
        for name in found:
            rules[canonical] = ColumnRule(name=name)
            if name != canonical:
                grid.notice(f"column {name!r} is taken as {canonical}")


def _refuse_missing(grid: Grid, rules: Rules) -> None:
    """Refuse rules on columns that are not there; without an adjustment the file is no table."""
    lacking = {
        canonical: rule.name
        for canonical, rule in rules.items()
        if rule.name not in grid.header and not _IN_NAMES.search(rule.name)
    }
    is_trials = any(column.endswith("_adj") for column in rules.keys() - lacking.keys())
    for canonical, name in lacking.items():
        message = f"[columns] names {name!r} for {canonical}, and no column has that name."
        kind = UsageError if is_trials else NoDataError
        raise grid.error(message, name, grid.columns_like(name), kind)


def _name_by_reference(grid: Grid, rules: Rules, options: DataTables) -> None:
    """Let the values of the first reference name environments that have no column."""
    references = [column for column in rules if column.endswith("_ref")]
    patterns = [options.sessions.filename or "", *(rule.name for rule in rules.values())]
    has_name = "environment" in rules or any("{environment}" in pattern for pattern in patterns)
    if has_name or not references or options.trial_references:
        return
    rules["environment"] = rules[references[0]]
    name = rules["environment"].name
    grid.notice(f"environments are named by the values of column {name!r}")


def aliases(quantities: Quantities) -> dict[str, set[str]]:
    """Other names of columns, of numbers such as "reference_k" or "stiffness_final"."""
    known = {name: {name, *words.split()} for name, words in _WORDS.items()}
    for quantity in with_mass(quantities).values():
        stems = {plain(quantity.name), plain(quantity.label)}
        for kind, words in _NUMBER_WORDS.items():
            pairs = [*product(stems, words), *product(words, stems)]
            known[f"{quantity.name}_{kind}"] = {"_".join(pair) for pair in pairs}
    return known


def plain(name: str) -> str:
    """Write a name in lower case, with an underscore for what is no letter or digit."""
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def _slots(grid: Grid, rules: Rules, options: DataTables) -> tuple[Slot, ...]:
    """Give the one slot of a long table, or those that the names of a wide one hold."""
    taken = {rule.name for rule in rules.values()} | _named_apart(options)
    common: dict[str, int] = {}
    positions: dict[tuple[tuple[str, str], ...], dict[str, int]] = {}
    for canonical, rule in rules.items():
        if not _IN_NAMES.search(rule.name):
            common[canonical] = grid.position(rule.name)
            continue
        pattern = _ID.sub(r"(?P<\1>.+)", re.escape(rule.name)).replace("<trial>.+", "<trial>[0-9]+")
        # "{environment}" alone fits every column: those are meant that the scene declares.
        declared = options.environments if rule.name == "{environment}" else {}
        for name in grid.header:
            match = re.fullmatch(pattern, name, re.DOTALL)
            if match and name not in taken and (not declared or name in declared):
                ids = tuple(match.groupdict().items())
                positions.setdefault(ids, {})[canonical] = grid.position(name)
    wide = [rule.name for name, rule in rules.items() if name not in common]
    if wide and not positions:
        message = "no column fits the pattern in [columns]."
        raise grid.error(message, wide[0], f"The columns are {shown(grid.header)}.")
    alone = _alone(rules, options)
    slots = (positions or {(): {}}).items()
    return tuple(Slot(common | columns, alone | dict(ids)) for ids, columns in slots)


def _alone(rules: Rules, options: DataTables) -> dict[str, str]:
    """Name the one environment that needs no column, if there can be only one."""
    if "environment" in rules:
        return {}
    names = list(options.environments)
    matched = {q.is_matched for name, q in options.quantities.items() if f"{name}_adj" in rules}
    if not names and (options.trial_references or matched == {False}):
        names = [_ALL_TRIALS]
    return {"environment": names[0]} if len(names) == 1 else {}


def check_columns(
    grid: Grid,
    present: Collection[str],
    options: DataTables,
    paths: Sequence[str | Path],
) -> None:
    """Refuse a header that lacks what an analysis of trials needs; paths are as they were given."""
    missing = [column for column in ("subject", "environment") if column not in present]
    first, *others = (f"{name}_adj" for name in options.quantities)
    if not {first, *others} & {*present}:
        missing.append(f"{first} (or {' or '.join(others)})" if others else first)
    else:
        for name, quantity in options.quantities.items():
            pair = {f"{name}_ref", f"{name}_adj"}
            if quantity.is_matched and pair & {*present}:
                missing += pair - {*present} - options.declared_references
    if not missing:
        return
    names = " and ".join(missing)
    hint = _NAME_COLUMNS
    if paths:
        hint += f" Or run: percept new scene.toml --from {shlex.join(map(str, paths))}"
    first = missing[0].split(" ")[0]
    alike = did_you_mean(first, {*grid.header} - {*present})
    message = f"there is no column for {names}; the columns are {shown(grid.header)}.{alike}"
    kind = UsageError if {*present} - {*IDS, "trial"} else NoDataError
    raise grid.error(message, first, hint, kind)


def unused_columns(grid: Grid, slots: Iterable[Slot], options: DataTables) -> list[str]:
    """Name the columns of a header that nothing is read from."""
    read = {position for slot in slots for position in slot.columns.values()}
    apart = _named_apart(options)
    names = enumerate(grid.header)
    return [name for position, name in names if position not in read and name not in apart]


def _named_apart(options: DataTables) -> set[str]:
    """Name the columns that select rows or keep groups."""
    selection = options.sessions
    excluded = {rule.column for rule in selection.exclude}
    return {*KEPT_COLUMNS, *options.groups, *selection.only, *excluded}
