"""Which column is which: the scene's map first, then exact names, then known aliases, announced."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
#: An id that the names of a wide table's columns hold, and the same in an escaped pattern.
_IN_NAMES = re.compile(r"\{(subject|session|environment|trial)\}")
_ID = re.compile(r"\\\{(subject|session|environment|trial)\\\}")


@dataclass(frozen=True)
class Header:
    """The names of a file's columns."""

    names: list[str]
    file: str
    paths: Sequence[str] = ()  # As they were given, for a command to type

    def position(self, name: str) -> int:
        """Return where the one column of a name stands."""
        if self.names.count(name) == 1:
            return self.names.index(name)
        message = f"there is no column {name!r}."
        if name in self.names:
            message = f"two columns have the name {name!r}."
        raise self.error(message, name, self.listed + did_you_mean(name, self.names))

    @property
    def listed(self) -> str:
        """A hint that lists the columns."""
        return f"The columns are {shown(self.names)}."

    def error(
        self, message: str, column: str, hint: str, kind: type[UsageError] = UsageError
    ) -> UsageError:
        """Return an error about a column of the header."""
        return kind(message, file=self.file, row=1, column=column, hint=hint)


#: Environment of trials that only their own references tell apart.
_ALL_TRIALS = "all trials"


@dataclass(frozen=True)
class Slot:
    """One set of adjustments in a row: all of a long table, one environment of a wide one."""

    columns: Mapping[str, int]  # From canonical name to a position in the header
    ids: Mapping[str, str] = field(default_factory=dict)  # Read from the names of columns


@dataclass(frozen=True)
class Resolution:
    """What stands where in one header."""

    form: str
    slots: tuple[Slot, ...]  # One for a long table, one per environment (and trial) for a wide one
    rules: _Rules  # The rule each canonical column was found by, with the header's own name
    announced: tuple[str, ...]  # Choices that rest on an alias

    @property
    def ids(self) -> set[str]:
        """Ids that the names of columns hold."""
        return {name for slot in self.slots for name in slot.ids}

    @property
    def is_numbered(self) -> bool:
        """Whether a column, or the names of columns, number the trials."""
        return "trial" in {*self.rules, *self.ids}


def resolve(header: Header, options: ReadOptions) -> Resolution:
    """Find the canonical columns in a header."""
    known = {plain(name) for name in header.names} | options.columns.keys()
    limits_or_moments = {"lower", "upper"} <= known or {"mean", "sd"} <= known
    summary = "parameter" in known and limits_or_moments
    wanted = SUMMARY if summary else canonical_columns(options.quantities)
    if options.sessions.trial == "order":
        wanted = tuple(column for column in wanted if column != "trial")
    found, wide = _by_scene(header, wanted, options)
    announced = _by_name(header, wanted, found, wide, options)
    if not (summary or "environment" in found or _is_in_names("environment", wide)):
        announced += _named_by_reference(found, options)
    slots = tuple(_slots(header, found, wide, options))
    form = "summary" if summary else "trials"
    return Resolution(form, slots, {**found, **wide}, tuple(announced))


def _by_scene(
    header: Header, wanted: Sequence[str], options: ReadOptions
) -> tuple[dict[str, ColumnRule], dict[str, ColumnRule]]:
    """Give the rules of the scene for single columns, and those for several with ids in names."""
    found = {}
    wide = {}
    kind = _kind_of_error(header, options)
    for column, rule in options.columns.items():
        if column not in wanted:
            continue
        if _IN_NAMES.search(rule.name):
            wide[column] = rule
        else:
            found[column] = _declared(column, rule, header, kind)
    if options.sessions.layout == "subjects in columns":
        first = f"{next(iter(options.quantities))}_adj"
        wide.setdefault(first, ColumnRule(name="{subject}"))
    return found, wide


def _by_name(
    header: Header,
    wanted: Sequence[str],
    found: dict[str, ColumnRule],
    wide: _Rules,
    options: ReadOptions,
) -> list[str]:
    """Find the columns that no rule names by percept's names, or aliases; announce the latter."""
    claimed = {rule.name for rule in found.values()}
    known_names = aliases(options.quantities)
    announced = []
    for column in wanted:
        if column in found or column in wide:
            continue
        if column in header.names:
            found[column] = ColumnRule(name=column)
            continue
        alias = _alias(column, known_names.get(column, frozenset({column})), header, claimed)
        if alias is not None:
            announced.append(f"column {alias!r} is taken as {column}")
            found[column] = ColumnRule(name=alias)
    return announced


def _declared(
    canonical: str, rule: ColumnRule, header: Header, kind: type[UsageError]
) -> ColumnRule:
    """Find the column that the scene names; a dotted name leads into its JSON cells."""
    for name in rule.also:
        header.position(name)
    if rule.name in header.names:
        return rule
    stem = rule.name
    while rule.path is None and "." in stem:
        stem = stem.rpartition(".")[0]
        if stem in header.names:
            return rule.model_copy(update={"name": stem, "path": rule.name[len(stem) + 1 :]})
    message = f"[columns] names {rule.name!r} for {canonical}, and no column has that name."
    hint = header.listed + did_you_mean(rule.name, header.names)
    raise header.error(message, rule.name, hint, kind)


def _named_by_reference(found: dict[str, ColumnRule], options: ReadOptions) -> list[str]:
    """Let the values of the first reference name environments that have no column."""
    references = [column for column in found if column.endswith("_ref")]
    by_file = "{environment}" in (options.sessions.filename or "")
    if not references or by_file or options.trial_references:
        return []
    found["environment"] = found[references[0]]
    return [f"environments are named by the values of column {found['environment'].name!r}"]


def _kind_of_error(header: Header, options: ReadOptions) -> type[UsageError]:
    """Say what a missing column makes of a file: without a column of adjustments it is no table."""
    names = {plain(name) for name in header.names}
    stems = {name.partition(".")[0] for name in header.names}
    known = aliases(options.quantities)
    for column in (f"{name}_adj" for name in options.quantities):
        rule = options.columns.get(column)
        if rule is None and names & {column, *known[column]}:
            return UsageError
        if rule is not None and ("{" in rule.name or rule.name.partition(".")[0] in stems):
            return UsageError
    return NoDataError


def aliases(quantities: Quantities) -> dict[str, frozenset[str]]:
    """Other names of columns, of numbers such as "reference_k" or "stiffness_final"."""
    known = {name: frozenset({name, *words.split()}) for name, words in _WORDS.items()}
    for quantity in with_mass(quantities).values():
        stems = {plain(quantity.name), plain(quantity.label)}
        for kind, words in _NUMBER_WORDS.items():
            pairs = [*product(stems, words), *product(words, stems)]
            known[f"{quantity.name}_{kind}"] = frozenset("_".join(pair) for pair in pairs)
    return known


def _alias(
    canonical: str, known: Collection[str], header: Header, claimed: Collection[str]
) -> str | None:
    """Return the one column with a known alias that the scene does not name."""
    free = [name for name in header.names if name not in claimed]
    candidates = [name for name in free if plain(name) in known]
    if len(candidates) > 1:
        message = f"{shown(candidates)} could each be {canonical}."
        hint = f'Declare the one that is meant: [columns] {canonical} = "…".'
        raise header.error(message, canonical, hint)
    return candidates[0] if candidates else None


def plain(name: str) -> str:
    """Write a name in lower case, with an underscore for what is no letter or digit."""
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def _slots(header: Header, found: _Rules, wide: _Rules, options: ReadOptions) -> Iterator[Slot]:
    """Give the one slot of a long table, or those that the names of a wide one hold."""
    common = {canonical: header.position(rule.name) for canonical, rule in found.items()}
    has_environment = "environment" in found or _is_in_names("environment", wide)
    alone = None if has_environment else _alone(found, options)
    alone_ids = {} if alone is None else {"environment": alone}
    if not wide:
        yield Slot(common, alone_ids)
        return
    taken = {rule.name for rule in found.values()} | _named_apart(found, options)
    free = [name for name in header.names if name not in taken]
    places: dict[tuple[tuple[str, str], ...], dict[str, int]] = {}
    for canonical, rule in wide.items():
        pattern = re.compile(_ID.sub(_group, re.escape(rule.name)), re.DOTALL)
        # "{environment}" alone fits every column: those are meant that the scene declares.
        bare = rule.name == "{environment}" and options.environments
        for name in free:
            if (match := pattern.fullmatch(name)) and (not bare or name in options.environments):
                ids = tuple(match.groupdict().items())
                places.setdefault(ids, {})[canonical] = header.position(name)
    if not places:
        first = next(iter(wide.values()))
        message = "no column fits the pattern in [columns]."
        raise header.error(message, first.name, header.listed)
    for ids, own in places.items():
        yield Slot({**common, **own}, {**alone_ids, **dict(ids)})


def _is_in_names(canonical: str, wide: _Rules) -> bool:
    """Whether the names of a wide table's columns hold an id."""
    return any(f"{{{canonical}}}" in rule.name for rule in wide.values())


def _group(match: re.Match[str]) -> str:
    """Turn an id in an escaped pattern into a group; numbers count trials."""
    return f"(?P<{match[1]}>{'[0-9]+' if match[1] == 'trial' else '.+'})"


def _alone(found: _Rules, options: ReadOptions) -> str | None:
    """Name the one environment that needs no column; None where there may be several."""
    declared = options.environments
    if declared:
        return next(iter(declared)) if len(declared) == 1 else None
    adjusted = [name for name in options.quantities if f"{name}_adj" in found]
    nothing_matched = not any(options.quantities[name].is_matched for name in adjusted)
    if options.trial_references or (adjusted and nothing_matched):
        return _ALL_TRIALS
    return None


def check_columns(
    header: Header, found: Resolution, options: ReadOptions, ids: Collection[str]
) -> None:
    """Hold a header to what an analysis of trials needs; `ids` come from the file's name."""
    present = {*found.rules, *found.ids, *ids}
    if options.sessions.subject == "row":
        present.add("subject")
    missing = [column for column in ("subject", "environment") if column not in present]
    missing += _missing_numbers(present, options)
    if not missing:
        return
    names = " and ".join(missing)
    hints = ["Name it in the scene's [columns]."]
    if "subject" in missing:
        file_names = 'or take it from file names with [sessions] filename = "{subject}".'
        hints = [f"Name it in the scene's [columns], {file_names}"]
    if "_adj" in names and options.quantities == IMPEDANCE:
        hints.append("[quantities] names what people adjusted beside stiffness and damping.")
    if "_ref" in names:
        hints.append("References can stand in [environments].")
    if header.paths:
        hints.append(f"Or run: percept new scene.toml --from {shlex.join(header.paths)}")
    alike = did_you_mean(missing[0].split(" ")[0], set(header.names) - present)
    message = f"there is no column for {names}; the columns are {shown(header.names)}.{alike}"
    kind = UsageError if present & {*numbers_of(options.quantities)} else NoDataError
    raise header.error(message, missing[0].split(" ")[0], " ".join(hints), kind)


def _missing_numbers(present: Collection[str], options: ReadOptions) -> list[str]:
    """Name the missing columns of numbers: an adjustment, and a reference for each."""
    first, *others = (f"{name}_adj" for name in options.quantities)
    if not {first, *others} & {*present}:
        return [f"{first} (or {' or '.join(others)})" if others else first]
    declared = {name for own in options.environments.values() for name in own}
    missing = []
    for name, quantity in options.quantities.items():
        adjusted = f"{name}_adj"
        reference = f"{name}_ref"
        if quantity.is_matched and adjusted in present and reference not in {*present, *declared}:
            missing.append(reference)
        if quantity.is_matched and reference in present and adjusted not in present:
            missing.append(adjusted)
    return missing


def unused_columns(header: Header, found: Resolution, options: ReadOptions) -> list[str]:
    """Name the columns of a header that nothing is read from."""
    read = {position for slot in found.slots for position in slot.columns.values()}
    read_by_name = _named_apart(found.rules, options)
    unread = [name for position, name in enumerate(header.names) if position not in read]
    return [name for name in unread if name not in read_by_name]


def _named_apart(rules: _Rules, options: ReadOptions) -> set[str]:
    """Name the columns that select rows, keep groups, or are further parts of ids."""
    selection = options.sessions
    named = {*KEPT_COLUMNS, *selection.groups, *selection.only}
    named |= {rule.column for rule in selection.exclude}
    for rule in rules.values():
        named |= set(rule.also)
    return named
