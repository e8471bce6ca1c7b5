"""Numbers as a reader sees them: rounded here and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: A bias of so many references and more is written as a multiple.
_MULTIPLE = 9.0
#: An upper limit over the lower one beyond which the two say nothing.
_UNKNOWN = 1e10
#: Environments that a sentence names; more are counted.
MOST_NAMED = 5


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


def short(value: float, digits: int = 3) -> str:
    """Write a number to significant digits, without zeros at its end."""
    mantissa, times, power = rounded(value, digits).partition(" ×")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").removesuffix(".")
    return mantissa + times + power


def apart(first: float, second: float) -> tuple[str, str]:
    """Write two numbers with the digits that tell them apart."""
    for digits in range(3, 16):
        texts = short(first, digits), short(second, digits)
        if texts[0] != texts[1]:
            break
    return texts


def is_known(lower: float, upper: float) -> bool:
    """Say whether limits say anything: positive ones span ten decades at most."""
    return not 0.0 < _UNKNOWN * lower < upper


def percentage(value: float, digits: int = 3) -> str:
    """Write a fraction as a percentage, "< 0.1 %" where it is less."""
    if 0 < abs(value) < 0.001:
        return ("< " if value > 0 else "> −") + "0.1\u202f%"
    return f"{short(100 * value, digits)}\u202f%"


def _bias(value: float) -> str:
    """Write how far something lies from its reference: +38 %, −7.1 %, or 254 times as high."""
    if value >= _MULTIPLE:
        return f"{short(1 + value, 3)} times"
    sign = "+" if value > 0 else ""
    if abs(value) < 0.001:
        # The sign may decide, so that no bias is written as less than something.
        return f"{sign}{short(100 * value, 2)}\u202f%"
    # Whole percents at least.
    return sign + percentage(value, 2 if abs(value) < 0.995 else 3)


def written(value: float | None, digits: int = 5, style: str = "plain") -> str:
    """Write a number in a style, a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return rounded(value)
    if style == "ratio":
        return short(math.exp(value), digits)
    if style == "count":
        return f"{value:,}".replace(",", "\u202f")
    if style == "short":
        # Somebody chose these digits.
        return f"{value:.10g}".replace("-", "−")
    if style == "bias":
        return _bias(value)
    if style == "percent":
        return percentage(value, digits)
    sign = "+" if style == "difference" and value > 0 else ""
    return sign + short(value, digits)


def digits_of(value: float | None, lower: float | None, upper: float | None) -> int:
    """Return the digits worth reading: to about a hundredth of an interval's half-width."""
    limits = [limit for limit in (lower, upper) if limit is not None]
    width = max(limits, default=0.0) - min(limits, default=0.0)
    size = abs(value) if value is not None else 0.0
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 4
    return min(max(math.ceil(math.log10(size / (0.005 * width))), 2), 6)


@dataclass(frozen=True, kw_only=True)
class Estimated:
    """An estimate and its limits as sentences have them: with digits and unit alike."""

    estimate: float
    lower: float
    upper: float
    unit: str = ""
    style: str = "plain"
    least_digits: int = 2

    def text(self, number: float, style: str = "") -> str:
        """Write a number with its unit."""
        digits = max(digits_of(self.estimate, self.lower, self.upper), self.least_digits)
        text = written(number, digits, style or self.style).replace("\u202f", " ")
        return f"{text} {self.unit}".rstrip()

    @property
    def limits(self) -> str:
        """Both limits; a unit that they share stands once."""
        lower = self.text(self.lower)
        upper = self.text(self.upper)
        for unit in (" %", f" {self.unit}"):
            if upper.endswith(unit):
                lower = lower.removesuffix(unit)
        return f"{lower} to {upper}"


def listed(names: Sequence[str], most: int = 10**6) -> str:
    """Join names with commas and a final "and"; count those beyond the first few."""
    if len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def spanned(sizes: Sequence[float], texts: Sequence[str]) -> str:
    """List sizes as they are written; of many the smallest and the largest, of equal ones one."""
    if len(set(texts)) == 1:
        return texts[0]
    if len(texts) <= MOST_NAMED:
        return listed(texts)
    by_size = [text for _, text in sorted(zip(sizes, texts, strict=True))]
    return f"{by_size[0]} to {by_size[-1]}"
