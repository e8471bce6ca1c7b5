"""Quantities that people adjust: their names in columns and tables, their words and their units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from percept.errors import UsageError, capitalised, did_you_mean
from percept.sessions.records import IDS

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
_IMPEDANCE = {
    "k": {"label": "stiffness", "unit": "N/m"},
    "b": {"label": "damping", "unit": "N·s/m"},
}
# A plain product or quotient of names; an expression such as 10**10**10 is never handed to a
# parser.
_UNIT = re.compile(r"[A-Za-zµ°%]+[²³]?(?:[·*/ ][A-Za-zµ°%]+[²³]?){0,4}")


def known_key(names: Sequence[str], name: str, key: str, value: object = None) -> None:
    """Refuse a key that a table does not have."""
    if name not in names:
        hint = did_you_mean(name, names).strip() or None
        message = f"there is no such key; there are {', '.join(names)}."
        raise UsageError(
            message, key=key, value=None if isinstance(value, Mapping) else value, hint=hint
        )


#: What a proposed scene has in the place of what a person must decide.
TO_FILL_IN = "?"


def unfilled(value: Any, key: str) -> Iterator[str]:
    """Give the keys of a table that nobody has filled in."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from unfilled(inner, f"{key}.{name}")
    elif value == TO_FILL_IN:
        yield key


#: What pydantic finds wrong, by its own name of the kind of error, in plain words.
_PLAIN_WORDS = {
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "string_type": "must be text",
    "tuple_type": "must be a list",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "literal_error": "must be {expected}",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must be one character, not a quote",
    "missing": "is missing",
}


def usage_error(error: ValidationError) -> UsageError:
    """Say the first thing that is wrong with the keys of a table, unknown ones before all else."""
    problems = error.errors(include_url=False)
    for problem in problems:
        # A misspelt key is missing too; its own name says more.
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, UsageError):
            keys = [*map(str, problem["loc"]), cause.key]
            cause.key = ".".join(key for key in keys if key)
            return cause
    first = problems[0]
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] in _PLAIN_WORDS:
        message = _PLAIN_WORDS[first["type"]].format(**first.get("ctx", {}))
    message = f"{message[:1].lower()}{message[1:]}".removesuffix(".")
    path = ".".join(str(key) for key in first["loc"])
    value = None if isinstance(first["input"], dict) else first["input"]
    return UsageError(f"{message}.", key=path or None, value=value)


class Table(BaseModel):
    """Settings that do not change, without keys beside those named."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, given: Any) -> Any:
        if isinstance(given, Mapping):
            for key, value in given.items():
                known_key(tuple(cls.model_fields), str(key), str(key), value)
        return given


class Quantity(Table):
    """A quantity that subjects adjust to a reference.

    Parameters
    ----------
    name : str
        Name in columns (`NAME_ref`, `NAME_adj`), and as `parameter` in tables and JSON.
    label : str
        Word in sentences; by default the name.
    symbol : str
        Symbol in figures and the heads of tables; by default the name.
    unit : str
        Unit of all its numbers in tables and figures; empty for a pure number.
    reference : {"none"}, optional
        "none" where nothing was matched: every reference is zero, and percept gives means.
    limits : tuple of float, optional
        Ends of the control, in the unit: adjustments at them or beyond are left out and counted.

    Raises
    ------
    UsageError
        From a scene: a name that fits no column, or another unit of "k" (N/m) or "b" (N·s/m).
    """

    name: str
    label: str = ""
    symbol: str = ""
    unit: str = ""
    reference: Literal["none"] | None = None
    limits: tuple[float, float] | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, given: Any) -> Any:
        name = given.get("name") if isinstance(given, Mapping) else None
        if not isinstance(name, str):
            return given
        usual = {"label": name.replace("_", " "), "symbol": name, "unit": ""}
        return usual | _IMPEDANCE.get(name, {}) | dict(given)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not _NAME.fullmatch(self.name) or self.name.casefold() in (*IDS, "trial"):
            raise ValueError(
                "a name has letters, digits and single underscores, and is not that of an id"
            )
        usual = _IMPEDANCE.get(self.name)
        if usual is not None and self.unit != usual["unit"]:
            text = f"{self.name} is {usual['label']} in {usual['unit']}"
            raise ValueError(f"{text}: name another quantity apart")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise ValueError("the lower of the two limits comes first")
        return self

    @property
    def is_matched(self) -> bool:
        """Whether adjustments have references; without them percept gives means."""
        return self.reference is None

    @property
    def words(self) -> str:
        """Label and symbol in a sentence, such as "stiffness k"."""
        same = self.symbol.casefold() == self.label.casefold()
        return self.label if same else f"{self.label} {self.symbol}"

    @property
    def head(self) -> str:
        """Label and symbol for the head of a table, such as "Stiffness k"."""
        return capitalised(self.words)

    def amount(self, *numbers: float) -> str:
        """Write a value, or the ends of an interval, with the unit, to four digits."""
        return f"{' to '.join(f'{number:.4g}' for number in numbers)} {self.unit}".rstrip()


Quantities = Mapping[str, Quantity]
#: What an environment's impedance has, and what a study adjusts unless the scene says otherwise.
IMPEDANCE: Quantities = {name: Quantity(name=name) for name in _IMPEDANCE}

_MASS = Quantity(name="m", label="mass", unit="kg")


def is_impedance(parameters: Iterable[str]) -> bool:
    """Whether the parameters are stiffness and damping, which curves and couplings need."""
    return set(parameters) == IMPEDANCE.keys()


def with_mass(quantities: Quantities) -> Quantities:
    """Return the quantities of references: those adjusted, and the mass of an impedance."""
    return {**quantities, "m": _MASS} if quantities.keys() >= IMPEDANCE.keys() else quantities


def quantity_of(column: str) -> str:
    """Name the quantity of a column of numbers."""
    return column.rpartition("_")[0]


@lru_cache
def factor(unit: str | None, quantity: Quantity, key: str | None = None) -> float:
    """Factor from a unit, declared at a key, to the quantity's; pint is imported if it must."""
    if unit is None or unit == quantity.unit:
        return 1.0
    import pint

    try:
        units = _parsed(quantity.unit)
        one, two = ((number * _parsed(unit)).to(units).magnitude for number in (1.0, 2.0))
        if not math.isclose(two, 2.0 * one):
            raise ValueError("a unit with an offset")
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, ArithmeticError):
        message = f"not a unit of {quantity.label}."
        hint = f"Declare one that converts to {quantity.unit or 'a pure number'}."
        raise UsageError(message, key=key, value=unit, hint=hint) from None
    # Where a factor has few digits, those are meant: pint multiplies several.
    short = float(f"{one:.12g}")
    return short if math.isclose(short, one, rel_tol=1e-15) else one


def amount_in(quantity: Quantity, text: str, *, key: str | None = None) -> float:
    """Read a positive number with its unit, such as "0.5 N/mm", in the quantity's unit.

    Raises
    ------
    UsageError
        No positive number, or a unit that does not convert.
    """
    number, _, unit = text.strip().partition(" ")
    unit = unit.strip()
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    # A number alone could be a fraction that somebody put in quotes.
    has_unit = bool(unit) or not quantity.unit
    if not (has_unit and 0.0 < value < math.inf):
        hint = f'Write it as "{f"150 {quantity.unit}".strip()}".'
        message = f"no positive amount of {quantity.label} with its unit."
        raise UsageError(message, key=key, value=text, hint=hint)
    return value * factor(unit or None, quantity)


def _parsed(unit: str) -> Any:
    """Return a unit as pint's."""
    if unit and not _UNIT.fullmatch(unit):
        raise ValueError(unit)
    import pint

    return pint.Unit(re.sub(r"\bNs\b", "N*s", unit))
