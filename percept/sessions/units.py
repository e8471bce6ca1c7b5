"""Declared units to N/m and N·s/m; pint is imported only when a unit is not one of these."""

from __future__ import annotations

import re
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from percept.errors import UsageError

UNITS = {"k": "N/m", "b": "N·s/m"}
# A plain product or quotient of names; an expression such as 10**10**10 is never handed to a parser.
_PLAIN = re.compile(r"[A-Za-zµ]+(?:[·*/ ][A-Za-zµ]+){0,4}")
_SAME = {"k": frozenset({"N/m"}), "b": frozenset({"N·s/m", "N*s/m", "Ns/m", "N s/m"})}


@lru_cache
def factor(unit: str | None, parameter: str) -> Fraction:
    """Exact factor from a declared unit to percept's."""
    if unit is None or unit in _SAME[parameter]:
        return Fraction(1)
    import pint

    text = re.sub(r"\bNs\b", "N*s", unit).replace("·", "*").replace(" ", "*")
    try:
        if not _PLAIN.fullmatch(unit):
            raise ValueError(unit)
        quantity = _registry().Quantity(Fraction(1), text)
        return Fraction(quantity.to(UNITS[parameter].replace("·", "*")).magnitude)
    except (pint.errors.PintError, ValueError, TypeError, AttributeError):
        raise UsageError(
            f"not a unit of {'stiffness' if parameter == 'k' else 'damping'}.",
            key="unit",
            value=unit,
            hint=f"Declare one that converts to {UNITS[parameter]}.",
        ) from None


@lru_cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


def convert(values: npt.NDArray[np.float64], unit: str | None, parameter: str) -> npt.NDArray[np.float64]:
    """Convert numbers to N/m or N·s/m."""
    scale = factor(unit, parameter)
    if scale.denominator == 1:
        return values * float(scale) if scale != 1 else values
    if scale.numerator == 1:
        return values / scale.denominator
    return values * float(scale)
