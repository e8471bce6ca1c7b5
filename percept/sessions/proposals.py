"""A scene for files with other column names: what names say beyond doubt, and "?" for the rest.

Names, and units in brackets, give a column its role. Its cells can only take a role back, but for
one: a column that counts the rows of each subject numbers the trials.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

import pandas as pd

from percept.errors import printable
from percept.sessions.columns import aliases, plain
from percept.sessions.files import load
from percept.sessions.layout import refuse_headless
from percept.sessions.options import ReadOptions
from percept.sessions.paths import expand
from percept.sessions.quantities import IMPEDANCE, TO_FILL_IN, quantity_of
from percept.sessions.records import MOST_CONDITIONS, Problems, shown
from percept.sessions.tables import read_grid
from percept.sessions.values import CellError, is_missing, pick

#: Files of a folder, and members of an archive, that are looked at.
_FILES = 40
#: Share of numbers among the cells of a column of numbers: a few may be slips.
_NUMERIC = 0.9
#: Rows from which on two different values are answers to a choice, and no adjustments.
_MANY_ROWS = 8
#: Names of ids beside those that the reader knows by itself.
_IDS = {
    "subject": "pid pp ppt vp vpn observer observer_id person person_id participant_nr nsub"
    " part_id",
    "session": "session_no visit_nr",
    "environment": "condition cond condition_id condition_name",
    "trial": "trl trial_nr trial_n trial_id repetition rep",
}
#: Words of adjustments and references, some only beside a stem, and of what nobody adjusted.
_WORDS = {
    "adjusted": "response resp adjusted adjustment match matched estimate estimated reproduced"
    " reproduction",
    "adjusted, with a stem": "adj rep perc perceived final judged reported answer guess",
    "reference": "reference ref standard target true actual physical",
    "reference, with a stem": "cur current real presented shown sample test stim stimulus",
    "nothing": "time clock date timestamp started stopped onset offset start end begin rt latency"
    " elapsed wait frame frames error err bias deviation difference diff confidence initial type"
    " key keys button count index history accuracy acc correct id sd se nr no num number code",
}
_BRACKETED = re.compile(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$")
_STIFFNESS = {"N/m", "N/mm", "N/cm", "kN/m"}
_DAMPING = {"N·s/m", "N*s/m", "Ns/m", "N·s/mm", "N*s/mm", "Ns/mm"}
#: percept's own names of quantities, by words of a column, with the units that convert.
_OWN = {
    "k": ("k", _STIFFNESS),
    "stiffness": ("k", _STIFFNESS),
    "b": ("b", _DAMPING),
    "damping": ("b", _DAMPING),
}
#: What to write in the place of a "?".
_ASK = {
    "subject": 'its column; or remove this line and write, below [sessions], subject = "row" or'
    ' filename = "{subject}"',
    "session": "its column, or remove this line",
    "environment": "its column or a list of columns; if references differ by trial, remove this"
    ' line and set [model] bias = "reference"',
    "trial": "the column that numbers repeats; or remove this line and write, below [sessions],"
    ' trial = "order"',
    "ref": "its column; or remove this line and write numbers in [environments], or reference ="
    ' "none" below [quantities.NAME] if nothing was matched',
    "adj": 'its column; "wall_{environment}" if each environment has one',
}
_HEAD = '# What the names of columns in {} say. Write what is right in the place of each "?".'
_REST = '# Every other key has its default: "percept new all.toml" writes them all, to copy from.'


@dataclass(frozen=True)
class Proposal:
    """A scene as far as names of columns say it."""

    text: str  #: TOML; comments say what each column holds
    roles: Mapping[str, str]  #: Column, or "?", by canonical column

    @property
    def left(self) -> int:
        """How many lines somebody has to edit."""
        return self.text.count(f" = {_toml(TO_FILL_IN)}")


@dataclass(frozen=True, eq=False)
class _Column:
    """A column by its name and its cells."""

    name: str
    cells: pd.Series[str]

    @cached_property
    def texts(self) -> list[str]:
        """Different cells that are not blank, in order."""
        stripped = dict.fromkeys(cell.strip() for cell in self.cells.unique())
        return [text for text in stripped if not is_missing(text)]

    @cached_property
    def numbers(self) -> pd.Series[float]:
        """Numbers by row, NaN in cells without one."""
        return pd.to_numeric(self.cells.str.strip().str.replace(",", "."), errors="coerce")

    @cached_property
    def kind(self) -> str:
        """What its cells are."""
        if not self.texts:
            return "empty"
        filled = ~self.cells.map(is_missing)
        if self.numbers[filled].notna().mean() < _NUMERIC:
            return "text"
        known = self.numbers.dropna()
        return "whole numbers" if (known == known.round()).all() else "numbers"

    @property
    def unit(self) -> str:
        """Unit in brackets behind the name; empty without one."""
        found = _BRACKETED.search(self.name)
        return found[1] if found else ""

    @cached_property
    def words(self) -> list[str]:
        """Words of the name without its unit, in lower case."""
        spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", _BRACKETED.sub("", self.name))
        return re.findall(r"[^\W_]+", spaced.casefold())

    @property
    def seen(self) -> str:
        """Its kind and three values, for a comment."""
        more = " …" if len(self.texts) > 3 else ""
        return printable(f"{self.kind}: {', '.join(self.texts[:3])}{more}")[:80]


@dataclass(frozen=True)
class _Table:
    """The cells of files that have one header."""

    files: list[str]
    columns: list[_Column]

    def named(self, role: str) -> list[_Column]:
        """Give the columns whose whole name is one of an id; percept's own name goes before."""
        own = [column for column in self.columns if plain(column.name) == role]
        names = {*aliases(IMPEDANCE)[role], *_IDS[role].split()}
        others = []
        for column in self.columns:
            if names & {plain(column.name), "_".join(column.words)}:
                others.append(column)
        return own or others


#: By canonical column: its column, a pattern of columns, or None where somebody must decide.
_Roles = dict[str, _Column | str | None]


def propose_columns(*paths: str | Path) -> Proposal:
    """Write a scene for files with unknown column names, as far as these say what is what.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`. Of several kinds of files the one counts
        whose names say most.

    Returns
    -------
    Proposal

    Raises
    ------
    UsageError
        No file is a table, or the first row of one is data.
    """
    options = ReadOptions()
    problems = Problems()
    kinds: dict[tuple[str, ...], list[tuple[str, pd.DataFrame]]] = {}
    for file in islice(expand(paths)[0], _FILES):
        with problems.collecting():
            for entry in islice(load(file, options.files), _FILES):
                with problems.collecting():
                    grid = read_grid(entry, options, [])
                    rows = [cells for _, cells in grid.sample]
                    refuse_headless(grid.header, rows, entry.name)
                    cells = pd.DataFrame(rows, dtype=object)
                    kinds.setdefault(tuple(grid.header), []).append((entry.name, cells))
    if not kinds:
        problems.raise_if_any()
    tables = [_together(header, parts) for header, parts in kinds.items()]
    tables.sort(key=lambda table: -len(table.columns[0].cells))
    table = max(tables, key=lambda table: sum(map(bool, _roles(table).values())))
    return _proposal(table, [other for other in tables if other is not table])


def _together(header: Sequence[str], parts: Sequence[tuple[str, pd.DataFrame]]) -> _Table:
    """Put files of one header together; keys of JSON cells become columns of their own."""
    cells = pd.concat([own for _, own in parts], ignore_index=True)
    columns = []
    for position, name in enumerate(header):
        column = _Column(name, cells[position])
        columns += [column, *_inside(column)]
    return _Table([name for name, _ in parts], columns)


def _inside(column: _Column) -> Iterator[_Column]:
    """Make columns of the keys of a column's first JSON record, each called "column.key"."""
    first = next((text for text in column.texts if text.startswith("{")), "{}")
    try:
        keys = json.loads(first)
    except (ValueError, RecursionError):
        return
    for key in keys:
        cells = [_at(cell, key) for cell in column.cells]
        yield _Column(f"{column.name}.{key}", pd.Series(cells, dtype=str))


def _at(cell: str, key: str) -> str:
    try:
        return pick(cell, key) or ""
    except CellError:
        return ""


def _roles(table: _Table) -> _Roles:
    """Give each canonical column that a scene needs its column."""
    roles: _Roles = {}
    subject = _alone(table.named("subject"))
    roles["subject"] = subject
    if sessions := table.named("session"):
        roles["session"] = _alone(sessions)
    numbers = _wide(table) or _matched(table)
    first = next(iter(numbers.values()))
    environments = table.named("environment")
    environment = _alone(environments)
    if environment and not _tells_environments(environment, subject, first):
        environment = None
    few = isinstance(first, _Column) and len(first.texts) <= MOST_CONDITIONS
    if environments or not (few or isinstance(first, str)):
        roles["environment"] = environment
    roles |= numbers
    cell = [roles.get("session"), subject, environment or first]
    trials = table.named("trial")
    if not trials and roles.get("environment", True):
        free = [column for column in table.columns if column not in roles.values()]
        trials = [column for column in free if _counts(column, subject)]
    if trials:
        trial = _alone(trials)
        doubted = trial is None or trial.kind != "whole numbers" or _repeat([*cell, trial], roles)
        roles["trial"] = None if doubted else trial
    elif _repeat(cell, roles):
        roles["trial"] = None
    return roles


def _repeat(ids: Iterable[_Column | str | None], roles: _Roles) -> bool:
    """Whether adjustments of known subjects repeat ids."""
    column = next(own for name, own in roles.items() if name.endswith("_adj"))
    if roles["subject"] is None or not isinstance(column, _Column):
        return False
    cells = [own.cells for own in ids if isinstance(own, _Column)]
    rows = pd.concat(cells, axis=1)[~column.cells.map(is_missing)]
    return bool(rows.duplicated().any())


def _alone(columns: Sequence[_Column]) -> _Column | None:
    return columns[0] if len(columns) == 1 else None


def _tells_environments(column: _Column, subject: _Column | None, reference: object) -> bool:
    """Whether a column of conditions is one within subjects, with one reference to each value."""
    if isinstance(reference, _Column):
        if (reference.cells.groupby(column.cells).nunique() > 1).any():
            return False
    elif subject is None:
        return False
    if subject is not None and len(subject.texts) > 1:
        of_subject = column.cells.groupby(subject.cells).nunique()
        if len(column.texts) > 1 and (of_subject == 1).all():
            return False
    return len(column.texts) <= MOST_CONDITIONS or not _counts(column, subject)


def _counts(column: _Column, subject: _Column | None) -> bool:
    """Whether whole numbers rise by one from row to row of each subject."""
    if subject is None or column.kind != "whole numbers" or len(column.texts) < 2:
        return False
    return bool((column.numbers.groupby(subject.cells).diff().dropna() == 1).all())


def _wide(table: _Table) -> _Roles:
    """Find columns such as "k_adj_soft_1": percept's own names with environments behind them."""
    roles: _Roles = {}
    for canonical in ("k_ref", "b_ref", "k_adj", "b_adj"):
        pattern = rf"{canonical}_(.+?)(_\d+)?"
        found = [re.fullmatch(pattern, column.name) for column in table.columns]
        parts = [match.groups() for match in found if match]
        environments = {name for name, _ in parts}
        if len(environments) < 2 or all(name.isdigit() for name in environments):
            continue
        numbered = all(number for _, number in parts)
        roles[canonical] = f"{canonical}_{{environment}}{'_{trial}' * numbered}"
    return roles


def _matched(table: _Table) -> _Roles:
    """Find adjustments, and the reference that shares the rest of its name with each of them."""
    adjusted = list(_of_role(table, "adjusted", "reference"))
    references = list(_of_role(table, "reference", "adjusted"))
    partners = [[other for other in references if _share(other[0], own[0])] for own in adjusted]
    claimed = [other[1] for others in partners for other in others]
    roles: _Roles = {}
    for (stem, column), others in zip(adjusted, partners, strict=True):
        if len(others) == 1 and claimed.count(others[0][1]) == 1:
            stem, reference = others[0]
            name = _quantity(stem, column.unit)
            roles |= {f"{name}_ref": reference, f"{name}_adj": column}
    if roles:
        return roles
    if len(adjusted) == 1 and not adjusted[0][0] and not claimed:
        _, column = adjusted[0]
        name = _quantity((), column.unit)
        return {f"{name}_ref": None, f"{name}_adj": column}
    return {"response_ref": None, "response_adj": None}


def _of_role(table: _Table, role: str, other: str) -> Iterator[tuple[tuple[str, ...], _Column]]:
    """Give the columns of numbers that words put in a role, with the words that remain."""
    alone = _words(role)
    all_words = alone | _words(f"{role}, with a stem")
    against = _words("nothing") | _words(other) | _words(f"{other}, with a stem")
    for column in table.columns:
        stem = tuple(word for word in column.words if word not in all_words)
        fitting = all_words if stem else alone
        a_choice = len(column.texts) < 3 and len(column.cells) >= _MANY_ROWS
        if (role == "adjusted" and a_choice) or not column.kind.endswith("numbers"):
            continue
        if fitting & set(column.words) and not against & set(column.words):
            yield stem, column


def _words(role: str) -> set[str]:
    return set(_WORDS[role].split())


def _share(reference: tuple[str, ...], adjusted: tuple[str, ...]) -> bool:
    """Whether two stems are one, or an adjustment's says more: "pos x" and "pos x pivot"."""
    return reference == adjusted or bool(reference and reference == adjusted[: len(reference)])


def _quantity(stem: tuple[str, ...], unit: str) -> str:
    """Name a quantity by what its columns share."""
    name = "_".join(stem)
    own, units = _OWN.get(name, ("", {""}))
    if own and unit in {"", *units}:
        return own
    valid = re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name)
    return name if valid and name not in {*_IDS, *IMPEDANCE} else "response"


def _proposal(table: _Table, others: Sequence[_Table]) -> Proposal:
    """Write a scene: a line for each role, and a comment for each other column."""
    roles = _roles(table)
    lines = [_HEAD.format(shown(table.files, limit=1))]
    for other in others:
        names = shown([column.name for column in other.columns], limit=4)
        lines.append(f"# Not of {shown(other.files, limit=1)}, with the columns {names}.")
    lines += _quantities(roles)
    lines += ["", "[columns]"]
    for canonical, column in roles.items():
        lines.append(f"{canonical} = {_line(canonical, column, roles)}")
    lines.append("")
    for column in table.columns:
        if column not in roles.values():
            lines.append(f"# {_toml(column.name)} ({column.seen})")
    lines += ["", _REST]
    named = {
        canonical: column.name if isinstance(column, _Column) else column or TO_FILL_IN
        for canonical, column in roles.items()
    }
    return Proposal("\n".join(lines) + "\n", named)


def _quantities(roles: _Roles) -> Iterator[str]:
    """Tables of what was adjusted, unless that is stiffness and damping."""
    names = dict.fromkeys(quantity_of(name) for name in roles if name.endswith(("_ref", "_adj")))
    if names.keys() <= IMPEDANCE.keys():
        return
    for name in names:
        yield from ("", f"[quantities.{name}]")
        if name not in IMPEDANCE:
            unit = _unit(roles.get(f"{name}_adj")) or _unit(roles.get(f"{name}_ref")) or TO_FILL_IN
            ask = '  # such as "ms"; "" for a pure number' if unit == TO_FILL_IN else ""
            yield f"unit = {_toml(unit)}{ask}"


def _unit(column: _Column | str | None) -> str:
    return column.unit if isinstance(column, _Column) else ""


def _line(canonical: str, column: _Column | str | None, roles: _Roles) -> str:
    """Write a column as a value of [columns], with what it holds or what is asked."""
    if column is None:
        return f"{_toml(TO_FILL_IN)}  # {_ASK[canonical.rpartition('_')[2]]}"
    if isinstance(column, str):
        return _toml(column)
    name = _toml(column.name)
    quantity = quantity_of(canonical)
    usual = _unit(roles.get(f"{quantity}_adj"))
    if column.unit and (quantity in IMPEDANCE or column.unit != usual):
        name = f"{{ name = {name}, unit = {_toml(column.unit)} }}"
    return f"{name}  # {column.seen}"


def _toml(text: str) -> str:
    """Write a TOML string; what cannot be seen is escaped."""
    text = json.dumps(text, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in text)
