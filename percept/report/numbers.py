"""Numbers as a reader sees them: rounded here and nowhere else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal

from percept.errors import UsageError

__all__ = [
    "SUPERSCRIPT", "Number", "bare", "digits_of", "number", "percentage", "rounded", "short",
]  # fmt: skip

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Number:
    """A number on the page."""

    text: str  # As it is read
    exact: str  # Every digit; empty where there is none


_NO_NUMBER = Number("–", "")


def rounded(value: float, digits: int = 5) -> str:
    """Write a number to significant digits, as a power of ten where very large or small."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < max(digits, 6):
        # Decimal, because rounding to a count of decimals would round the rounded once more.
        text = f"{Decimal(f'{mantissa}e{power}'):f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(SUPERSCRIPT)}"
    return text.replace("-", "−")


def bare(text: str) -> str:
    """Drop zeros that end a decimal fraction."""
    mantissa, times, power = text.partition(" ×")
    return (mantissa.rstrip("0").removesuffix(".") if "." in mantissa else mantissa) + times + power


def short(value: float, digits: int = 3) -> str:
    """Write a number to significant digits, without zeros at its end."""
    return bare(rounded(value, digits))


def percentage(value: float, digits: int = 3) -> str:
    """Write a fraction as a percentage, "< 0.1 %" where it is less."""
    if 0 < abs(value) < 0.001:
        return ("< " if value > 0 else "> −") + "0.1\u202f%"
    return f"{bare(rounded(100 * value, digits))}\u202f%"


def _bias(value: float) -> str:
    """Write how far something lies from its reference: +38 %, −7.1 %, or 254 times as high."""
    if value >= 9:
        return f"{bare(rounded(1 + value, 3))} times"
    sign = "+" if value > 0 else ""
    if abs(value) < 0.001:
        # The sign may decide, so that no bias is written as less than something.
        return f"{sign}{bare(rounded(100 * value, 2))}\u202f%"
    # Whole percents at least, as the sentences on the first screen.
    return sign + percentage(value, 2 if abs(value) < 0.995 else 3)


def number(value: object, *, digits: int = 5, style: str = "plain") -> Number:
    """Return a number as it is shown; a dash where there is none."""
    if value is None:
        return _NO_NUMBER
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UsageError("a number was expected at this place of the report.", value=value)
    if math.isnan(value):
        return _NO_NUMBER
    # An array's double has a text form of its own.
    exact = float(value) if isinstance(value, float) else value
    if math.isinf(exact):
        return Number(rounded(exact), repr(exact))
    return Number(_written(exact, digits, style), repr(exact))


def _written(value: float, digits: int, style: str) -> str:
    """Write a number: "short" keeps the digits that somebody chose."""
    if style == "count":
        return f"{value:,}".replace(",", "\u202f")
    if style == "short":
        return f"{value:.10g}".replace("-", "−")
    if style == "short percent":
        return f"{100 * value:.10g}\u202f%".replace("-", "−")
    if style == "bias":
        return _bias(value)
    if style == "difference":
        return ("+" if value > 0 else "") + bare(rounded(value, digits))
    if style == "difference percent":
        return ("+" if value > 0 else "") + short(100 * value, digits) + "\u202f%"
    if style == "percent":
        return percentage(value, digits)
    if style == "error":
        return f"{bare(rounded(100 * value, 1))}\u202f%"
    return bare(rounded(value, digits))


def digits_of(value: float | None, lower: float | None, upper: float | None) -> int:
    """Return the digits worth reading: to about a hundredth of an interval's half-width."""
    limits = [limit for limit in (lower, upper) if limit is not None]
    width = max(limits, default=0.0) - min(limits, default=0.0)
    size = abs(value) if value is not None else 0.0
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 4
    return min(max(math.ceil(math.log10(size / (0.005 * width))), 2), 6)
