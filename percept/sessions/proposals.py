"""A scene for files with other column names: what names and units say, and "?" for the rest."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from percept.errors import UsageError, printable
from percept.sessions.columns import aliases, plain
from percept.sessions.grid import NUMBER, Grid, refuse_headless
from percept.sessions.inputs import expand, load
from percept.sessions.options import DataTables
from percept.sessions.quantities import IMPEDANCE, TO_FILL_IN, factor, quantity_of
from percept.sessions.records import Problems, shown
from percept.sessions.tables import read_grid
from percept.sessions.values import is_missing

#: Files that are looked at.
_FILES = 40
#: Names of ids beside those that the reader knows by itself.
_IDS = {
    "subject": "pid pp ppt vp vpn observer observer_id person person_id participant_nr nsub"
    " part_id",
    "session": "session_no visit_nr",
    "environment": "condition cond condition_id condition_name",
    "trial": "trl trial_nr trial_n trial_id trialnum repetition rep",
}
#: Words of adjustments and references, those that count beside a stem alone, and words of what
#: nobody adjusted.
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
#: The kind of each of these words.
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_BRACKETED = re.compile(r"[(\[]\s*([^)\]]+?)\s*[)\]]\s*$")
#: percept's own quantities, by words of a column.
_OWN = {"k": "k", "stiffness": "k", "b": "b", "damping": "b"}
#: What to write in the place of a "?".
_ASK = {
    "subject": 'its column; or remove this line and write, below [sessions], subject = "row" or'
    ' filename = "{subject}"',
    "session": "its column, or remove this line",
    "environment": "its column; remove this line if values of the reference name environments,"
    ' and set [model] bias = "reference" if they differ by trial',
    "trial": "the column that numbers repeats; or remove this line and write, below [sessions],"
    ' trial = "order"',
    "ref": "its column; or remove this line and write numbers in [environments], or reference ="
    ' "none" below [quantities.NAME] if nothing was matched',
    "adj": 'its column; "wall_{environment}" if each environment has one',
}
_HEAD = '# What the names of columns in {} say. Write what is right in the place of each "?".'
_REST = '# Every other key has its default: "percept new all.toml" writes them all, to copy from.'


@dataclass(frozen=True)
class _Column:
    """A column: its name, the unit of its numbers, and its different cells that are not blank."""

    name: str
    unit: str
    cells: list[str]

    @property
    def words(self) -> list[str]:
        """Words of the name without its unit, in lower case."""
        spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", _BRACKETED.sub("", self.name))
        return re.findall(r"[^\W_]+", spaced.casefold())

    @property
    def has_numbers(self) -> bool:
        """Whether the first cells are numbers."""
        return bool(self.cells) and all(map(NUMBER.fullmatch, self.cells[:3]))

    @property
    def seen(self) -> str:
        """What it holds and three values, for a comment."""
        kind = "numbers" if self.has_numbers else "text" if self.cells else "empty"
        more = " …" if len(self.cells) > 3 else ""
        return printable(f"{kind}: {', '.join(self.cells[:3])}{more}")[:80]


#: By canonical column: its column, or None where somebody must decide.
_Roles = dict[str, _Column | None]


def propose_scene(*paths: str | Path) -> str:
    """Write a scene for files with unknown column names, as far as these say what is what.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`~percept.sessions.read_sessions`. Of several kinds of files the one counts
        whose names say most.

    Returns
    -------
    str
        TOML; comments say what each column holds, and a "?" stands where somebody must decide.

    Raises
    ------
    UsageError
        No file is a table, or the first row of one is data.
    """
    options = DataTables()
    problems = Problems()
    tables: dict[tuple[str, ...], tuple[str, list[_Column]]] = {}
    for file in islice(expand(paths)[0], _FILES):
        with problems.collecting():
            for entry in load(file, options.files):
                with problems.collecting():
                    grid = read_grid(entry, options)
                    refuse_headless(grid)
                    tables.setdefault(tuple(grid.header), (entry.name, _columns(grid)))
    if not tables:
        problems.raise_if_any()
    best = max(tables.values(), key=lambda table: sum(map(bool, _roles(table[1]).values())))
    return _scene(*best)


def _columns(grid: Grid) -> list[_Column]:
    """Give the columns of a file with the different cells of its first rows."""
    columns = []
    for position, name in enumerate(grid.header):
        cells = dict.fromkeys(cells[position].strip() for _, cells in grid.sample)
        bracketed = _BRACKETED.search(name)
        unit = bracketed[1] if bracketed else grid.units.get(name, "")
        columns.append(_Column(name, unit, [cell for cell in cells if not is_missing(cell)]))
    return columns


def _roles(columns: Sequence[_Column]) -> _Roles:
    """Give each canonical column that a scene needs its column; percept's own name goes before."""
    roles: _Roles = {}
    for role, words in _IDS.items():
        names = {*aliases(IMPEDANCE)[role], *words.split()}
        named = [column for column in columns if plain(column.name) == role] or [
            column for column in columns if names & {plain(column.name), "_".join(column.words)}
        ]
        if named or role in ("subject", "environment"):
            roles[role] = named[0] if len(named) == 1 else None
    return roles | _matched(columns)


def _matched(columns: Sequence[_Column]) -> _Roles:
    """Find adjustments, and the reference that shares the rest of its name with each of them."""
    adjusted = list(_of_kind(columns, "adjusted"))
    pairs = [
        (match, stem, reference)
        for other, match in adjusted
        for stem, reference in _of_kind(columns, "reference")
        # An adjustment's name may say more: "pos x" and "pos x pivot".
        if stem == other[: len(stem)] and bool(stem) == bool(other)
    ]
    claims = Counter(column.name for match, _, reference in pairs for column in (match, reference))
    roles: _Roles = {}
    for match, stem, reference in pairs:
        if claims[match.name] == claims[reference.name] == 1:
            name = _quantity(stem, match.unit)
            roles |= {f"{name}_ref": reference, f"{name}_adj": match}
    alone = len(adjusted) == 1 and not adjusted[0][0] and not pairs
    nothing = {"response_ref": None, "response_adj": adjusted[0][1] if alone else None}
    return roles or nothing


def _of_kind(columns: Sequence[_Column], kind: str) -> Iterator[tuple[tuple[str, ...], _Column]]:
    """Give the columns of numbers of a kind, with the words of their names that remain."""
    of_kind = {kind, f"{kind}, with a stem"}
    # Two different values are answers to a choice, and no adjustments.
    fewest = 3 if kind == "adjusted" else 1
    for column in columns:
        stem = tuple(word for word in column.words if word not in _KINDS)
        kinds = {_KINDS[word] for word in column.words if word in _KINDS}
        fits = kinds <= of_kind and bool(kinds if stem else kind in kinds)
        if fits and column.has_numbers and len(column.cells) >= fewest:
            yield stem, column


def _quantity(stem: tuple[str, ...], unit: str) -> str:
    """Name a quantity by what its columns share."""
    name = "_".join(stem)
    if name in _OWN:
        with suppress(UsageError):
            factor(unit or None, IMPEDANCE[_OWN[name]])
            return _OWN[name]
    valid = re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name)
    return name if valid and name not in {*_IDS, *IMPEDANCE} else "response"


def _scene(file: str, columns: Sequence[_Column]) -> str:
    """Write a scene: a line for each role, and a comment for each other column."""
    roles = _roles(columns)
    lines = [_HEAD.format(shown([file]))]
    quantities = dict.fromkeys(quantity_of(name) for name in roles if name not in _IDS)
    if not quantities.keys() <= IMPEDANCE.keys():
        for name in quantities:
            lines += ["", f"[quantities.{name}]"]
            unit = _unit(name, roles)
            if name not in IMPEDANCE:
                ask = "" if unit else '  # such as "ms"; "" for a pure number'
                lines.append(f"unit = {_toml(unit or TO_FILL_IN)}{ask}")
    lines += ["", "[columns]"]
    lines += [f"{canonical} = {_line(canonical, roles)}" for canonical in roles]
    lines.append("")
    for column in columns:
        if column not in roles.values():
            lines.append(f"# {_toml(column.name)} ({column.seen})")
    return "\n".join([*lines, "", _REST, ""])


def _unit(quantity: str, roles: _Roles) -> str:
    """Name the unit of a quantity: that of its adjustments, or of its references."""
    columns = (roles[f"{quantity}_adj"], roles[f"{quantity}_ref"])
    return next((column.unit for column in columns if column and column.unit), "")


def _line(canonical: str, roles: _Roles) -> str:
    """Write a column as a value of [columns], with what it holds or what is asked."""
    column = roles[canonical]
    if column is None:
        return f"{_toml(TO_FILL_IN)}  # {_ASK[canonical.rpartition('_')[2]]}"
    name = _toml(column.name)
    quantity = quantity_of(canonical)
    if column.unit and (quantity in IMPEDANCE or column.unit != _unit(quantity, roles)):
        name = f"{{ name = {name}, unit = {_toml(column.unit)} }}"
    return f"{name}  # {column.seen}"


def _toml(text: str) -> str:
    """Write a TOML string; what cannot be seen is escaped."""
    text = json.dumps(text, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in text)
