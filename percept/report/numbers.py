"""Numbers as a reader sees them: rounded here and nowhere else, each with its place in report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from percept.errors import UsageError

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_INFINITE = {"inf": "∞", "-inf": "−∞"}


@dataclass(frozen=True)
class Number:
    """A number on the page."""

    text: str  # As it is read
    exact: str  # Every digit
    place: str  # Its JSON pointer in report.json


def rounded(value: float, digits: int = 5) -> str:
    """Write a number to significant digits, in powers of ten where it is very large or very small."""
    if math.isinf(value):
        return _INFINITE["inf" if value > 0 else "-inf"]
    if value == 0:
        return "0"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < max(digits, 6):
        # Decimal, because rounding to a count of decimals would round the rounded once more.
        text = f"{Decimal(f'{mantissa}e{power}'):f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(_SUPERSCRIPT)}"
    return text.replace("-", "−")


def percentage(value: float, digits: int = 3) -> str:
    """Write a fraction as a percentage."""
    return f"{rounded(100 * value, digits)}\u202f%"


def at(document: Any, place: str) -> Any:
    """Return what stands at a JSON pointer."""
    value = document
    for step in place.split("/")[1:]:
        name = _plain_name(step)
        try:
            if isinstance(value, Mapping):
                value = value[name]
            elif isinstance(value, Sequence) and not isinstance(value, str):
                value = value[int(name)]
            else:
                raise KeyError(name)
        except (KeyError, IndexError, ValueError) as error:
            raise UsageError("the report has nothing at this place.", value=place) from error
    return value


def number(document: Any, place: str, *, digits: int = 5, style: str = "plain") -> Number:
    """Return the number at a place of the document, as it is shown."""
    parent, _, last = place.rpartition("/")
    owner = at(document, parent)
    value = owner.get(_plain_name(last)) if isinstance(owner, Mapping) else at(document, place)
    if value is None:
        return Number("–", "", place)
    if isinstance(value, str) and value in _INFINITE:
        return Number(_INFINITE[value], value, place)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UsageError("a number was expected at this place of the report.", key=place, value=value)
    if style == "count":
        return Number(f"{value:,}".replace(",", "\u202f"), repr(value), place)
    if style.startswith("short"):
        text = _short(value, style)
    else:
        text = percentage(value, digits) if style == "percent" else rounded(float(value), digits)
    return Number(text, repr(value), place)


def _short(value: float, style: str) -> str:
    """Write what somebody chose as somebody would write it."""
    fraction = style == "short percent"
    text = f"{100 * value if fraction else value:.10g}".replace("-", "−")
    return f"{text}\u202f%" if fraction else text


def _plain_name(step: str) -> str:
    return step.replace("~1", "/").replace("~0", "~")
