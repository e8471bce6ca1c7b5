"""Which column is which: the scene's map first, then exact names, then known aliases, announced."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from percept.errors import UsageError
from percept.sessions.options import KEPT_COLUMNS, SUMMARY, ColumnRule, ReadOptions, canonical_columns
from percept.sessions.quantities import Quantities, numbers_of, with_mass
from percept.sessions.records import NoDataError, shown

_WORDS = {
    "subject": "participant participant_id participant_private_id subject_nr subject_id subject_number subj "
    "sub ppid",
    "session": "session_num session_number session_id session_nr visit",
    "environment": "env environment_id ve virtual_environment reference_environment",
    "trial": "trial_num trial_number trial_no trial_index trials_thisn",
}
#: Beside or before the name or the label of a quantity.
_NUMBER_WORDS = {"ref": ("ref", "reference"), "adj": ("adj", "adjusted", "final")}
_Rules = Mapping[str, ColumnRule]
_WIDE = ("{column}_{{environment}}", "{{environment}}_{column}")


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
    announced: tuple[str, ...]  # Choices that rest on an alias or on a pattern of names


def resolve(header: Sequence[str], options: ReadOptions, *, file: str) -> Resolution:
    """Find the canonical columns in a header."""
    declared = options.columns
    aliases = _aliases(options.quantities)
    announced: list[str] = []
    found: dict[str, ColumnRule] = {}
    wide: dict[str, ColumnRule] = {}
    names = set(header)
    summary = _is_summary(names, declared)
    wanted = SUMMARY if summary else canonical_columns(options.quantities)
    if options.trial == "order":
        wanted = tuple(column for column in wanted if column != "trial")
    for column, rule in declared.items():
        if column not in wanted:
            continue
        if "{environment}" in rule.name:
            wide[column] = rule
        else:
            found[column] = _declared(column, rule, header, file)
    claimed = {rule.name for rule in found.values()}
    for column in wanted:
        if column in found or column in wide:
            continue
        if column in names:
            found[column] = ColumnRule(name=column)
            continue
        name = _alias(column, aliases.get(column, frozenset()), header, claimed, file)
        if name is not None:
            announced.append(f"column {name!r} is taken as {column}")
            found[column] = ColumnRule(name=name)
    if not summary and not wide and "environment" not in found:
        wide = _wide_by_name(header, found, options.quantities, file)
        announced += [f"columns {rule.name!r} are taken as {c}" for c, rule in wide.items()]
    slots = _slots(header, found, wide, options.environments, file)
    return Resolution("summary" if summary else "trials", slots, {**found, **wide}, tuple(announced))


def _is_summary(names: set[str], declared: _Rules) -> bool:
    known = {_plain(name) for name in names} | declared.keys()
    return "parameter" in known and ({"lower", "upper"} <= known or {"mean", "sd"} <= known)


def _declared(canonical: str, rule: ColumnRule, header: Sequence[str], file: str) -> ColumnRule:
    for name in rule.also:
        _declared(canonical, ColumnRule(name=name), header, file)
        _position(header, name, file)
    if rule.name in header:
        return rule
    stem = rule.name
    while rule.path is None and "." in stem:
        stem = stem.rpartition(".")[0]
        if stem in header:
            return ColumnRule(name=stem, unit=rule.unit, path=rule.name[len(stem) + 1 :])
    close = get_close_matches(rule.name, header, n=3)
    message = f"[columns] names {rule.name!r} for {canonical}, and no column has that name."
    hint = f"Did you mean {shown(close)}?" if close else f"The columns are {shown(header)}."
    raise UsageError(message, file=file, row=1, column=rule.name, hint=hint)


def _aliases(quantities: Quantities) -> dict[str, frozenset[str]]:
    """Other names of columns, of numbers such as "reference_k" or "stiffness_final"."""
    known = {name: frozenset(words.split()) for name, words in _WORDS.items()}
    for quantity in with_mass(quantities).values():
        stems = {_plain(quantity.name), _plain(quantity.label)}
        for kind, words in _NUMBER_WORDS.items():
            pairs = {(stem, word) for stem in stems for word in words}
            orders = {f"{a}_{b}" for one, other in pairs for a, b in ((one, other), (other, one))}
            known[f"{quantity.name}_{kind}"] = frozenset(orders)
    return known


def _alias(
    canonical: str, known: Collection[str], header: Sequence[str], claimed: set[str], file: str
) -> str | None:
    candidates = [name for name in header if _plain(name) in known and name not in claimed]
    candidates += [n for n in header if _plain(n) == canonical and n not in claimed]
    if len(candidates) > 1:
        message = f"{shown(candidates)} could each be {canonical}."
        hint = f'Declare the one that is meant: [columns] {canonical} = "…".'
        raise UsageError(message, file=file, row=1, column=canonical, hint=hint)
    return candidates[0] if candidates else None


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def _wide_by_name(
    header: Sequence[str], found: _Rules, quantities: Quantities, file: str
) -> dict[str, ColumnRule]:
    """Patterns such as "k_adj_VE1" or "VE1_k_adj", where a header has them."""
    for shape in _WIDE:
        patterns = {c: shape.format(column=c) for c in numbers_of(quantities) if c not in found}
        wide = {
            c: ColumnRule(name=pattern)
            for c, pattern in patterns.items()
            if any(_pattern(pattern).fullmatch(name) for name in header)
        }
        if wide.keys() & {f"{name}_adj" for name in quantities}:
            _refuse_numbered(header, wide, file)
            return wide
    return {}


def _refuse_numbered(header: Sequence[str], wide: _Rules, file: str) -> None:
    """Ask where "k_adj_VE1_1", "k_adj_VE1_2" may be two trials of VE1 as well as two environments."""
    for canonical, rule in wide.items():
        matches = (_pattern(rule.name).fullmatch(name) for name in header)
        names = [match["environment"] for match in matches if match]
        stems = {re.sub(r"[_. -]?[0-9]+$", "", name) for name in names}
        if (
            canonical.endswith("_adj")
            and any(re.search(r"[_. -][0-9]+$", n) for n in names)
            and len(stems) < len(names)
        ):
            message = f"{shown(names)} may be environments, or environments and trials."
            hint = f'Declare [columns] {canonical} = "{rule.name}" or "{rule.name}_{{trial}}".'
            raise UsageError(message, file=file, row=1, column=canonical, hint=hint)


def _pattern(name: str) -> re.Pattern[str]:
    text = re.escape(name)
    text = text.replace(r"\{environment\}", r"(?P<environment>.+)", 1)
    return re.compile(text.replace(r"\{trial\}", r"(?P<trial>[0-9]+)", 1), re.DOTALL)


def _slots(
    header: Sequence[str], found: _Rules, wide: _Rules, declared: Collection[str], file: str
) -> tuple[Slot, ...]:
    common = {canonical: _position(header, rule.name, file) for canonical, rule in found.items()}
    if not wide:
        return (Slot(common),)
    places: dict[tuple[str, str | None], dict[str, int]] = {}
    taken = {rule.name for rule in found.values()}
    for canonical, rule in wide.items():
        pattern = _pattern(rule.name)
        # "{environment}" alone fits every column: those are meant that the scene declares.
        names = [n for n in header if n in declared] if rule.name == "{environment}" and declared else header
        for name in names:
            match = pattern.fullmatch(name)
            if match and name not in taken:
                key = (match["environment"], match.groupdict().get("trial"))
                places.setdefault(key, {})[canonical] = _position(header, name, file)
    if not places:
        message = "no column fits the pattern in [columns]."
        hint = f"The columns are {shown(header)}."
        raise UsageError(message, file=file, row=1, column=next(iter(wide.values())).name, hint=hint)
    return tuple(Slot({**common, **own}, env, trial) for (env, trial), own in places.items())


def _position(header: Sequence[str], name: str, file: str) -> int:
    if header.count(name) > 1:
        raise UsageError(
            "two columns have this name.", file=file, row=1, column=name, hint="Rename or remove one of them."
        )
    return header.index(name)


def check_columns(
    header: Sequence[str], found: Resolution, options: ReadOptions, named: Collection[str], *, file: str
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
        if any("_ref" in name for name in missing):
            hint += " References can stand in [environments]."
        message = f"there is no column for {' and '.join(missing)}; the columns are {shown(header)}."
        kind = UsageError if present & {*numbers_of(options.quantities)} else NoDataError
        raise kind(message, file=file, row=1, column=missing[0].split(" ")[0], hint=hint)


def unused_columns(header: Sequence[str], found: Resolution, options: ReadOptions) -> list[str]:
    """Name the columns of a header that nothing is read from."""
    used = {at for slot in found.slots for at in slot.columns.values()}
    named = {name for rule in found.rules.values() for name in rule.also}
    named |= {*options.groups, *options.only, *(rule.column for rule in options.exclude), *KEPT_COLUMNS}
    return [name for at, name in enumerate(header) if at not in used and name and name not in named]
