"""Which column is which: the scene's map first, then exact names, then known aliases, announced."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from percept.errors import UsageError, did_you_mean
from percept.sessions.options import (
    KEPT_COLUMNS,
    SUMMARY,
    ColumnRule,
    ReadOptions,
    canonical_columns,
)
from percept.sessions.quantities import IMPEDANCE, Quantities, numbers_of, with_mass
from percept.sessions.records import NoDataError, shown

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
_Rules = Mapping[str, ColumnRule]


@dataclass(frozen=True)
class Slot:
    """One set of adjustments in a row: all of a long table, one environment of a wide one."""

    columns: Mapping[str, int]  # From canonical name to a position in the header
    environment: str | None = None  # Read from the column names of a wide table
    trial: str | None = None  # Read from the column names of a wide table


@dataclass(frozen=True)
class Resolution:
    """What stands where in one header."""

    form: str
    slots: tuple[Slot, ...]  # One for a long table, one per environment (and trial) for a wide one
    rules: _Rules  # The rule each canonical column was found by, with the header's own name
    announced: tuple[str, ...]  # Choices that rest on an alias


def resolve(header: Sequence[str], options: ReadOptions, *, file: str) -> Resolution:
    """Find the canonical columns in a header."""
    names, declared, aliases = set(header), options.columns, _aliases(options.quantities)
    known = {_plain(name) for name in names} | declared.keys()
    summary = "parameter" in known and ({"lower", "upper"} <= known or {"mean", "sd"} <= known)
    wanted = SUMMARY if summary else canonical_columns(options.quantities)
    if options.sessions.trial == "order":
        wanted = tuple(column for column in wanted if column != "trial")
    mapped = {column: rule for column, rule in declared.items() if column in wanted}
    wide = {column: rule for column, rule in mapped.items() if "{environment}" in rule.name}
    found = {c: _declared(c, rule, header, file) for c, rule in mapped.items() if c not in wide}
    claimed = {rule.name for rule in found.values()}
    announced: list[str] = []
    for column in (column for column in wanted if column not in mapped):
        if column in names:
            found[column] = ColumnRule(name=column)
        elif alias := _alias(
            column, aliases.get(column, frozenset({column})), header, claimed, file
        ):
            announced.append(f"column {alias!r} is taken as {column}")
            found[column] = ColumnRule(name=alias)
    slots = tuple(_slots(header, found, wide, options.environments, file))
    return Resolution(
        "summary" if summary else "trials", slots, {**found, **wide}, tuple(announced)
    )


def _declared(canonical: str, rule: ColumnRule, header: Sequence[str], file: str) -> ColumnRule:
    for name in rule.also:
        position(header, name, file)
    if rule.name in header:
        return rule
    stem = rule.name
    while rule.path is None and "." in stem:
        stem = stem.rpartition(".")[0]
        if stem in header:
            return rule.model_copy(update={"name": stem, "path": rule.name[len(stem) + 1 :]})
    message = f"[columns] names {rule.name!r} for {canonical}, and no column has that name."
    hint = f"The columns are {shown(header)}.{did_you_mean(rule.name, header)}"
    raise UsageError(message, file=file, row=1, column=rule.name, hint=hint)


def _aliases(quantities: Quantities) -> dict[str, frozenset[str]]:
    """Other names of columns, of numbers such as "reference_k" or "stiffness_final"."""
    known = {name: frozenset({name, *words.split()}) for name, words in _WORDS.items()}
    for quantity in with_mass(quantities).values():
        stems = {_plain(quantity.name), _plain(quantity.label)}
        for kind, words in _NUMBER_WORDS.items():
            pairs = [*product(stems, words), *product(words, stems)]
            known[f"{quantity.name}_{kind}"] = frozenset(map("_".join, pairs))
    return known


def _alias(
    canonical: str, known: Collection[str], header: Sequence[str], claimed: set[str], file: str
) -> str | None:
    candidates = [name for name in header if _plain(name) in known and name not in claimed]
    if len(candidates) > 1:
        message = f"{shown(candidates)} could each be {canonical}."
        hint = f'Declare the one that is meant: [columns] {canonical} = "…".'
        raise UsageError(message, file=file, row=1, column=canonical, hint=hint)
    return next(iter(candidates), None)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def _slots(
    header: Sequence[str], found: _Rules, wide: _Rules, declared: Collection[str], file: str
) -> Iterator[Slot]:
    common = {canonical: position(header, rule.name, file) for canonical, rule in found.items()}
    if not wide:
        yield Slot(common)
        return
    places: dict[tuple[str, str | None], dict[str, int]] = {}
    taken = {rule.name for rule in found.values()}
    for canonical, rule in wide.items():
        text = re.escape(rule.name).replace(r"\{environment\}", "(?P<environment>.+)", 1)
        pattern = re.compile(text.replace(r"\{trial\}", "(?P<trial>[0-9]+)", 1), re.DOTALL)
        # "{environment}" alone fits every column: those are meant that the scene declares.
        names = (
            [n for n in header if n in declared]
            if rule.name == "{environment}" and declared
            else header
        )
        for name in (name for name in names if name not in taken):
            if match := pattern.fullmatch(name):
                key = (match["environment"], match.groupdict().get("trial"))
                places.setdefault(key, {})[canonical] = position(header, name, file)
    if not places:
        message = "no column fits the pattern in [columns]."
        hint = f"The columns are {shown(header)}."
        raise UsageError(
            message, file=file, row=1, column=next(iter(wide.values())).name, hint=hint
        )
    for (environment, trial), own in places.items():
        yield Slot({**common, **own}, environment, trial)


def position(header: Sequence[str], name: str, file: str) -> int:
    """Return where the one column of a name stands."""
    if header.count(name) == 1:
        return header.index(name)
    message = (
        "two columns have this name."
        if name in header
        else "this column is wanted, and is not there."
    )
    hint = f"The columns are {shown(header)}.{did_you_mean(name, header)}"
    raise UsageError(message, file=file, row=1, column=name, hint=hint)


def check_columns(
    header: Sequence[str],
    found: Resolution,
    options: ReadOptions,
    named: Collection[str],
    *,
    file: str,
) -> None:
    """Hold a header to what an analysis of trials needs; `named` columns come from the file's name."""
    present = {*found.rules, *named}
    if any(slot.environment is not None for slot in found.slots):
        present.add("environment")
    missing = [c for c in ("subject", "environment") if c not in present]
    first, *others = (f"{name}_adj" for name in options.quantities)
    if not present & {first, *others}:
        missing.append(f"{first} (or {' or '.join(others)})" if others else first)
    else:
        declared = {name for references in options.environments.values() for name in references}
        pairs = [(f"{p}_adj", f"{p}_ref") for p in options.quantities]
        missing += [ref for adj, ref in pairs if adj in present and ref not in present | declared]
        missing += [adj for adj, ref in pairs if ref in present and adj not in present]
    if missing:
        from_name = ', or take it from file names with [sessions] filename = "{subject}"'
        hint = f"Name it in the scene's [columns]{from_name if 'subject' in missing else ''}."
        if any("_adj" in name for name in missing) and options.quantities == IMPEDANCE:
            hint += " What people adjusted beside stiffness and damping is named in [quantities]."
        if any("_ref" in name for name in missing):
            hint += " References can stand in [environments]."
        message = (
            f"there is no column for {' and '.join(missing)}; the columns are {shown(header)}."
        )
        kind = UsageError if present & {*numbers_of(options.quantities)} else NoDataError
        raise kind(message, file=file, row=1, column=missing[0].split(" ")[0], hint=hint)


def unused_columns(header: Sequence[str], found: Resolution, options: ReadOptions) -> list[str]:
    """Name the columns of a header that nothing is read from."""
    used = {at for slot in found.slots for at in slot.columns.values()}
    own = options.sessions
    named = {name for rule in found.rules.values() for name in rule.also}
    named |= {*own.groups, *own.only, *(rule.column for rule in own.exclude), *KEPT_COLUMNS}
    return [name for at, name in enumerate(header) if at not in used and name not in named]
