"""How to read a study's files: the scene's [columns], [sessions] and [environments] as one record."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from percept.errors import UsageError
from percept.sessions.units import factor

IDS = ("subject", "session", "environment")
NUMBERS = ("k_ref", "b_ref", "k_adj", "b_adj")
CANONICAL = (*IDS, "trial", *NUMBERS)
#: Columns kept as text wherever they stand: groups of subjects, and whether data are simulated.
KEPT_COLUMNS = ("group", "source")
SUMMARY = ("environment", "parameter", "reference", "lower", "upper", "mean", "sd", "n", "level")
_PLACE = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class ColumnRule:
    """Where a canonical column stands in the files.

    Attributes
    ----------
    name : str
        The file's own column name. `{environment}` and `{trial}` in it make the table a wide one.
    unit : str, optional
        Unit of the file's numbers; None means N/m for stiffness and N·s/m for damping.
    path : str, optional
        Dotted path into a JSON cell ("response.k"; a number picks from a list, -1 its last item).
    """

    name: str
    unit: str | None = None
    path: str | None = None


@dataclass(frozen=True)
class ExcludeRule:
    """Observations to leave out, and why.

    Attributes
    ----------
    column : str
        A canonical name (values in N/m or N·s/m) or one of the file's own columns.
    why : str
        The reason, as it is counted and reported.
    equals : tuple of str
        Leave out rows whose cell is one of these texts.
    below, above : float, optional
        Leave out rows whose number is below or above.
    """

    column: str
    why: str
    equals: tuple[str, ...] = ()
    below: float | None = None
    above: float | None = None


@dataclass(frozen=True)
class ReadOptions:
    """How to read a study's files; every default is the strictest reading.

    Attributes
    ----------
    columns : mapping of str to ColumnRule
        From canonical name to where it stands.
    environments : mapping of str to mapping
        From environment id to its references, `k_ref` (N/m) and `b_ref` (N·s/m).
    decimal : {".", ","}, optional
        The decimal mark of every file; None finds it per file and refuses what can be read two ways.
    delimiter, encoding : str, optional
        Declared where they cannot be told.
    keep : {"last"}, optional
        Files with a row per event: the last value of each parameter in a trial stands. Texts leave events out
        before that, limits of `exclude` leave out what stands.
    filename : str, optional
        Pattern of file names without suffix, such as "sub-{subject}_ses-{session}".
    groups : tuple of str
        Further columns to keep, as text.
    only : mapping of str to tuple of str
        Rows are used only where these columns hold one of these texts.
    exclude : tuple of ExcludeRule
        What to leave out, counted and logged by reason.
    unfinished : {"keep", "exclude"}
        Whether a subject who lacks an environment that others have stays.
    sheet : str, optional
        Sheet of an Excel workbook; the first by default.
    """

    columns: Mapping[str, ColumnRule] = field(default_factory=dict)
    environments: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    decimal: Literal[".", ","] | None = None
    delimiter: str | None = None
    encoding: str | None = None
    keep: Literal["last"] | None = None
    filename: str | None = None
    groups: tuple[str, ...] = ()
    only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    exclude: tuple[ExcludeRule, ...] = ()
    unfinished: Literal["keep", "exclude"] = "keep"
    sheet: str | None = None

    def with_columns(self, columns: Mapping[str, Any] | None) -> ReadOptions:
        """Return a copy in which further columns are declared.

        Parameters
        ----------
        columns : mapping or None
            As a scene's `[columns]`; it goes before what was declared.

        Returns
        -------
        ReadOptions

        Raises
        ------
        UsageError
            An unknown canonical name or key, or a value that is no text.
        """
        return replace(self, columns={**self.columns, **_columns(columns or {})})

    def with_groups(self, groups: Iterable[str]) -> ReadOptions:
        """Return a copy that keeps further columns as groups of subjects; those it always has are no news."""
        further = [name for name in groups if name not in CANONICAL]
        return replace(self, groups=tuple(dict.fromkeys([*self.groups, *further])))

    @classmethod
    def from_mapping(cls, tables: Mapping[str, Any], *, file: str | None = None) -> ReadOptions:
        """Build from a scene's tables, checking every key.

        Parameters
        ----------
        tables : mapping
            Any of: `columns`, from canonical name to a column name or a table {name, unit, path};
            `sessions`, with keys decimal, delimiter, encoding, keep, filename, groups, only, exclude,
            unfinished, sheet; `environments`, from id to {k_ref, b_ref} (or {stiffness, damping}).
            Other tables are not looked at.
        file : str, optional
            Where they come from, for messages.

        Returns
        -------
        ReadOptions

        Raises
        ------
        UsageError
            An unknown key, or a value of the wrong kind, naming table and key.
        """
        try:
            return cls._from_mapping(tables)
        except UsageError as error:
            error.file = file
            raise

    @classmethod
    def _from_mapping(cls, tables: Mapping[str, Any]) -> ReadOptions:
        sessions = _table(tables.get("sessions", {}), "[sessions]")
        unknown = sorted(set(sessions) - set(_SESSION_KEYS))
        if unknown:
            raise UsageError(
                f"unknown key in [sessions]; the keys are {', '.join(_SESSION_KEYS)}.",
                key=f"sessions.{unknown[0]}",
            )
        return cls(
            columns=_columns(tables.get("columns", {})),
            environments=_environments(tables.get("environments", {})),
            **{key: _SESSION_KEYS[key](value, key) for key, value in sessions.items()},
        )


def _columns(table: Any) -> Mapping[str, ColumnRule]:
    rules: dict[str, ColumnRule] = {}
    for canonical, value in _table(table, "[columns]").items():
        if canonical not in CANONICAL and canonical not in SUMMARY:
            names = ", ".join(dict.fromkeys((*CANONICAL, *SUMMARY)))
            raise UsageError(
                f"no such column in [columns]; the names are {names}.", key=f"columns.{canonical}"
            )
        if isinstance(value, ColumnRule):
            rules[canonical] = _with_unit(canonical, value)
            continue
        entry = {"name": value} if isinstance(value, str) else _table(value, f"[columns] {canonical}")
        wrong = [k for k, v in entry.items() if k not in ("name", "unit", "path") or not isinstance(v, str)]
        if wrong or not entry.get("name", "").strip():
            raise UsageError(
                "a column is a name, or a table of the texts name, unit and path.",
                key=f"columns.{canonical}",
                value=value,
            )
        rules[canonical] = _with_unit(canonical, ColumnRule(**entry))
    return rules


def _with_unit(canonical: str, rule: ColumnRule) -> ColumnRule:
    """Check a rule's unit before any file is read, while its key is known."""
    if canonical in NUMBERS:
        try:
            factor(rule.unit, canonical[0])
        except UsageError as error:
            error.key = f"columns.{canonical}.unit"
            raise
    return rule


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise UsageError(f"{where} must be a table.", value=value)
    return value


def _environments(value: Any) -> Mapping[str, Mapping[str, float]]:
    alias = {"k_ref": "k_ref", "b_ref": "b_ref", "stiffness": "k_ref", "damping": "b_ref"}
    out: dict[str, Mapping[str, float]] = {}
    for name, entry in _table(value, "[environments]").items():
        where = f"environments.{name}"
        references: dict[str, float] = {}
        for key, number in _table(entry, f"[{where}]").items():
            if key not in alias or isinstance(number, bool) or not isinstance(number, int | float):
                raise UsageError(
                    "an environment has the numbers k_ref and b_ref.", key=f"{where}.{key}", value=number
                )
            if not math.isfinite(number):
                raise UsageError("a reference must be finite.", key=f"{where}.{key}", value=number)
            references[alias[key]] = float(number)
        out[str(name)] = references
    return out


def _text(value: Any, key: str) -> str:
    if not isinstance(value, str) or not value:
        raise UsageError("must be text.", key=f"sessions.{key}", value=value)
    return value


def _one_of(*choices: str) -> Callable[[Any, str], str]:
    def check(value: Any, key: str) -> str:
        if value not in choices:
            allowed = " or ".join(f'"{choice}"' for choice in choices)
            raise UsageError(f"must be {allowed}.", key=f"sessions.{key}", value=value)
        return str(value)

    return check


def _character(value: Any, key: str) -> str:
    if not isinstance(value, str) or len(value) != 1 or value in '"\r\n\\':
        raise UsageError("must be one character, not a quote.", key=f"sessions.{key}", value=value)
    return value


def _texts(value: Any, key: str) -> tuple[str, ...]:
    listed = [value] if isinstance(value, str | int) and not isinstance(value, bool) else value
    if not isinstance(listed, list | tuple) or not all(
        isinstance(item, str | int) and not isinstance(item, bool) for item in listed
    ):
        raise UsageError("must be a text or a list of texts.", key=f"sessions.{key}", value=value)
    return tuple(str(item) for item in listed)


def _filename(value: Any, key: str) -> str:
    places = _PLACE.findall(_text(value, key))
    if not places or not set(places) <= set(IDS) or len(set(places)) < len(places):
        raise UsageError(
            "must name {subject}, {session} or {environment}, each once.",
            key=f"sessions.{key}",
            value=value,
        )
    return str(value)


def _only(value: Any, key: str) -> Mapping[str, tuple[str, ...]]:
    table = _table(value, f"[sessions] {key}")
    return {str(name): _texts(texts, f"{key}.{name}") for name, texts in table.items()}


def _exclude(value: Any, key: str) -> tuple[ExcludeRule, ...]:
    if not isinstance(value, list | tuple):
        raise UsageError("must be a list of rules.", key=f"sessions.{key}", value=value)
    return tuple(_rule(entry, f"{key}[{at}]") for at, entry in enumerate(value))


def _rule(value: Any, key: str) -> ExcludeRule:
    if isinstance(value, ExcludeRule):
        return value
    entry = _table(value, f"[sessions] {key}")
    column = _text(entry.get("column"), f"{key}.column")
    equals = _texts(entry["equals"], f"{key}.equals") if "equals" in entry else ()
    limits = {name: entry[name] for name in ("below", "above") if name in entry}
    if any(isinstance(limit, bool) or not isinstance(limit, int | float) for limit in limits.values()):
        raise UsageError("below and above are numbers.", key=f"sessions.{key}", value=value)
    if set(entry) - {"column", "why", "equals", "below", "above"} or bool(equals) == bool(limits):
        raise UsageError(
            "a rule has column, why, and either equals or limits (below, above).",
            key=f"sessions.{key}",
            value=value,
        )
    described = f"{column} is " + (
        " or ".join(equals) if equals else " or ".join(f"{name} {limit:g}" for name, limit in limits.items())
    )
    why = _text(entry["why"], f"{key}.why") if "why" in entry else described
    return ExcludeRule(column, why, equals, **{name: float(limit) for name, limit in limits.items()})


_SESSION_KEYS: Mapping[str, Callable[[Any, str], Any]] = {
    "decimal": _one_of(".", ","),
    "delimiter": _character,
    "encoding": _text,
    "keep": _one_of("last"),
    "filename": _filename,
    "groups": _texts,
    "only": _only,
    "exclude": _exclude,
    "unfinished": _one_of("keep", "exclude"),
    "sheet": _text,
}
