"""A proposal in words: TOML of a scene, with a comment on each line and what was left out."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from percept.errors import counted, printable
from percept.sessions.evidence import Column
from percept.sessions.options import TO_FILL_IN
from percept.sessions.quantities import quantity_of
from percept.sessions.read import Sessions
from percept.sessions.roles import DECIBELS, ID_COLUMNS, Roles
from percept.sessions.wide import Wide

__all__ = ["Draft", "outcome", "toml_text", "toml_value"]

#: Name of the environment of a study with one.
_ONE_CONDITION = "all"
#: Environments whose missing references a draft lists.
_MOST_ENVIRONMENTS = 60
#: Warnings that stand below a proposal.
_WARNINGS = 3
#: Texts that a column of conditions has at most.
_MOST_CONDITIONS = 6


@dataclass
class Draft:
    """What a scene would say of files, and remarks on it."""

    file: str  # Name of the first file
    files: int  # How many files have its header
    rows: int
    columns: Sequence[Column]
    roles: Roles
    known: frozenset[str]  # Canonical columns that the reader finds without a guess
    missing: tuple[str, ...] = ()
    repeats: int = 0  # Rows whose ids stand before them, where no number tells trials apart
    filename: str | None = None  # Pattern of file names that holds the subject
    by_row: bool = False  # Each row is a subject
    wide: dict[str, Wide] = field(default_factory=dict)  # By quantity
    #: Conditions that subjects met beside each environment.
    crossed: Sequence[Column] = ()
    #: Unit by quantity, where values of zero or below need the normal family.
    scales: Mapping[str, float | None] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)  # Above the tables
    outcome: list[str] = field(default_factory=list)  # Below them

    @property
    def guessed(self) -> tuple[str, ...]:
        """Canonical columns that rest on a guess."""
        return tuple(c for c in self.roles.found if c not in self.known)

    @property
    def found_any(self) -> bool:
        """Whether adjustments were found, in a column of their own or one per environment."""
        return self.roles.has_adjustment or bool(self.wide)

    @property
    def conditions(self) -> list[str]:
        """Names of the environments; one, where nothing tells them apart."""
        environment = self.roles.found.get("environment")
        if environment is not None:
            return environment.texts
        for wide in self.wide.values():
            return list(wide.columns)
        return [_ONE_CONDITION]

    @property
    def wide_adjusted(self) -> list[str]:
        """Canonical columns that stand in a row per subject."""
        return [f"{name}_adj" for name in self.wide]

    def text(self) -> str:
        """Write it as TOML."""
        files = f" and {self.files - 1} more of its kind" if self.files > 1 else ""
        name = printable(Path(self.file).name)
        lines = [f"# What percept makes of {name}{files}: look through it before you go on."]
        lines += _comments(self.remarks)
        lines += self._quantities()
        lines += ["", "[columns]", *self._columns()]
        lines += self._sessions()
        lines += self._environments()
        left_out = list(self._left_out())
        if left_out:
            lines += ["", *left_out]
        lines += ["", *_comments(self.outcome)]
        return "\n".join(lines).rstrip() + "\n"

    def _quantities(self) -> Iterator[str]:
        """Tables of quantities that percept has no name for."""
        for quantity, unit in self.roles.units.items():
            ask = "" if unit else "  # no name of a column gives it: fill it in, or leave it empty"
            column = self.roles.found.get(f"{quantity}_adj")
            if column and column.unit in DECIBELS:
                ask = "  # an amplitude, read from decibels; of a power set scale = 0.1 below"
            yield from ("", f"[quantities.{quantity}]", f"unit = {toml_text(unit)}{ask}")
            if column and (ends := column.ends):
                yield f"# limits = [{ends[0]:g}, {ends[1]:g}]  # ends of its control, if they are:"
                yield "# values there are then left out of the intervals, and counted"
            if quantity in self.unmatched:
                yield "# For means, where nothing was matched, uncomment this line and those below:"
                yield '# reference = "none"'
        yield from self._model()

    @property
    def unmatched(self) -> list[str]:
        """Quantities without references: if nothing was matched, the study is of their means."""
        return [name for name in self.roles.units if f"{name}_ref" in self.missing]

    def _model(self) -> Iterator[str]:
        """Lines of the model of means, and for values that have no logarithm."""
        if self.scales:
            names = ", ".join(self.scales)
            yield "[inference]"
            yield f'family = "normal"  # {names}: values of zero or below have no logarithm'
        elif self.unmatched:
            yield "# [inference]"
            yield '# family = "normal"'
        units = {name: unit for name, unit in self.scales.items() if unit is not None}
        if units:
            scale = ", ".join(f"{name} = {unit:g}" for name, unit in units.items())
            yield "[model]"
            yield f"scale = {{ {scale} }}  # a reference is zero: results are in this unit"
        elif self.unmatched:
            scale = ", ".join(f"{name} = {self._typical(name):g}" for name in self.unmatched)
            yield "# [model]"
            yield f"# scale = {{ {scale} }}  # a typical value: the median of their sizes"

    def _typical(self, quantity: str) -> float:
        """Give a typical size of the values, to two digits; one where there is none."""
        column = self.roles.found.get(f"{quantity}_adj")
        columns = [column] if column is not None else list(self.wide[quantity].columns.values())
        sizes = np.abs(np.concatenate([each.numbers for each in columns]))
        sizes = sizes[sizes > 0]
        return float(f"{np.median(sizes):.2g}") if len(sizes) else 1.0

    def _columns(self) -> Iterator[str]:
        """Lines of [columns]: each with what the column holds, then what could stand there."""
        found = self.roles.found
        for canonical in _in_order(found):
            column = found[canonical]
            value = toml_text(column.name)
            own = self.roles.units.get(quantity_of(canonical), "")
            if column.unit in DECIBELS and quantity_of(canonical) in self.roles.units:
                value = f'{{ name = {value}, response = "log", scale = 0.05 }}'
            elif canonical not in ID_COLUMNS and column.unit and column.unit != own:
                value = f"{{ name = {value}, unit = {toml_text(column.unit)} }}"
            yield f"{canonical} = {value}  # {column.seen()}"
            others = self.roles.alternatives.get(canonical, ())
            for other in others:
                if other not in found.values():
                    yield f"# or {toml_text(other.name)}: {other.quoted()}"
            if canonical == "environment":
                yield from self._crossed(column)
                if self.unmatched:
                    yield "# for one mean of all adjustments, leave environment out"
        yield from self._without_column()

    def _without_column(self) -> Iterator[str]:
        """Lines of [columns] for what stands in no single column, or was not found."""
        for name, wide in self.wide.items():
            pattern = toml_text(wide.pattern)
            yield f"{name}_adj = {pattern}  # a row per subject: {len(wide.columns)} columns"
            if len(wide.columns) == 2:
                columns = list(wide.columns.values())
                first = toml_text(columns[0].name)
                second = toml_text(columns[1].name)
                yield f"# To compare {second} with {first} of the same subject, in place of this:"
                yield f"# {name}_adj = {second}"
                yield f"# {name}_ref = {first}"
                yield '# and, below [model]: bias = "reference", without [environments]'
        if self.roles.has_adjustment and "environment" not in self.roles.found:
            yield '# environment = ""  # one condition: no column seems to tell several apart'
        if "NAME_adj" in self.missing:
            yield from self._no_adjustment()
            return
        for canonical in self.missing:
            yield f'# {canonical} = ""  # not found: fill in the name of its column'

    def _no_adjustment(self) -> Iterator[str]:
        """Say what to write where no column seems to hold what people set."""
        free = [c for c in self.columns if c.is_numeric and c not in self.roles.taken]
        column = free[-1].name if free else "rt"
        name = "_".join(re.findall("[a-z][a-z0-9]*", column.casefold())) or "response"
        yield "# No column seems to hold what people set. Write which one does, such as:"
        yield f"# {name}_adj = {toml_text(column)}"
        yield "# and, above [columns], what it is and its unit:"
        yield f"# [quantities.{name}]"
        yield '# unit = "s"'
        for canonical in self.missing:
            if not canonical.startswith("NAME_"):
                yield f'# {canonical} = ""  # not found: fill in the name of its column'

    def _crossed(self, environment: Column) -> Iterator[str]:
        """Say that conditions are pooled as trials, and how to tell them apart."""
        for column in self.crossed:
            name = toml_text(column.name)
            both = toml_value([environment.name, column.name])
            yield f"# {name} is crossed with it: {column.quoted()}. Now its values are pooled."
            yield f"# To tell them apart: environment = {both}"
            yield f"# or, as a factor: [study] factor = {name}"

    def _sessions(self) -> Iterator[str]:
        """Lines of [sessions]."""
        if self.repeats or self.filename or self.by_row:
            yield from ("", "[sessions]")
        if self.by_row:
            yield 'subject = "row"  # no column holds an id: each row is a subject'
        if self.filename:
            yield f"filename = {toml_text(self.filename)}  # no column tells subjects apart"
        if self.repeats:
            seen = f"{counted(self.repeats, 'row')} of {self.rows} repeat a subject and environment"
            yield f'trial = "order"  # {seen}, without numbers'

    def _environments(self) -> Iterator[str]:
        """Ask for references that no column holds."""
        lacking = [canonical for canonical in self.missing if canonical.endswith("_ref")]
        if not lacking or {"environment", "NAME_adj"} & set(self.missing):
            return
        yield ""
        if any(wide.pattern == "{environment}" for wide in self.wide.values()):
            # The pattern fits every column: these names say which are meant.
            yield "[environments]  # the columns that are read; references go into their braces"
            for name in self.conditions:
                yield f"{toml_text(name)} = {{}}  # such as {{ {lacking[0]} = 3.5 }}"
            return
        unknown = toml_text(TO_FILL_IN)
        values = ", ".join(f"{canonical} = {unknown}" for canonical in lacking)
        yield '# If references are in no column, write numbers for "?" and uncomment the lines:'
        yield "# [environments]"
        for name in self.conditions[:_MOST_ENVIRONMENTS]:
            yield f"# {toml_text(name)} = {{ {values} }}"

    def _left_out(self) -> Iterator[str]:
        """Name the columns that have no part, and conditions that could have one."""
        used = list(self.roles.taken)
        for wide in self.wide.values():
            used += wide.columns.values()
        for column in self.columns:
            if column in used:
                continue
            yield f"# not used: {toml_text(column.name)}: {column.seen()}"
            names_conditions = column.is_whole or not column.is_numeric
            few = 2 <= len(column.texts) <= _MOST_CONDITIONS
            if names_conditions and few and column not in self.crossed:
                yield f"#   to contrast its values: [study] factor = {toml_text(column.name)}"


def outcome(sessions: Sessions, draft: Draft) -> list[str]:
    """Say what reading under a draft gives: subjects, environments, trials, first warnings."""
    table = sessions.table
    stand_in = ", with medians in place of missing references" if draft.missing else ""
    sizes = table.groupby(["subject", "environment"], sort=False).size()
    trials = counted(int(sizes.max()), "trial")
    each = trials if sizes.min() == sizes.max() else f"{sizes.min()} to {trials}"
    said = [
        f"Tried on the whole file{stand_in}:"
        f" {counted(draft.rows, 'row')} give {counted(len(table), 'adjustment')}.",
        f"It holds {counted(len(sessions.subjects), 'subject')} and"
        f" {counted(len(sessions.environments), 'environment')}:"
        f" {counted(len(sizes), 'cell')} with {each} each.",
    ]
    warnings = [str(notice) for notice in sessions.warnings]
    said += [f"warning: {text}" for text in warnings[:_WARNINGS]]
    if len(warnings) > _WARNINGS:
        said.append(f"and {counted(len(warnings) - _WARNINGS, 'more warning')}")
    return said


def _comments(remarks: Sequence[str]) -> list[str]:
    """Write remarks as comments, each on one line."""
    return [f"# {printable(' '.join(remark.split()))}" for remark in remarks]


def _in_order(found: Mapping[str, Column]) -> list[str]:
    """Order canonical columns: ids, references, adjustments."""
    ids = [c for c in ID_COLUMNS if c in found]
    references = [c for c in found if c.endswith("_ref")]
    adjusted = [c for c in found if c.endswith("_adj")]
    rest = [c for c in found if c not in (*ids, *references, *adjusted)]
    return [*ids, *references, *adjusted, *rest]


def toml_text(text: str) -> str:
    """Write a TOML string: a JSON one, but for DEL, which TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_value(value: object) -> str:
    """Write a value of a scene as TOML on one line."""
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, Mapping):
        items = [f"{toml_text(key)} = {toml_value(item)}" for key, item in value.items()]
        return f"{{ {', '.join(items)} }}"
    if isinstance(value, Sequence):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    # JSON and TOML write numbers, true and false in the same way.
    return json.dumps(value)
