"""Labels of logarithmic axes in plain letters."""

from __future__ import annotations

import re

from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

_FORMULA = re.compile(r"\$\\mathdefault\{(.*)\}\$")
_EXPONENT = re.compile(r"\^\{([^}]*)\}")
_RAISED = str.maketrans("-−0123456789.", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹·")


class _Plain(LogFormatterSciNotation):
    """Labels the places that matplotlib labels, without its formulas, which take longer than the figure."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        formula = _FORMULA.fullmatch(label := super().__call__(x, pos))
        if formula is None:
            return label
        plain = _EXPONENT.sub(lambda found: found[1].translate(_RAISED), formula[1])
        return plain.replace(r"\times", "×")


def plain_powers(figure: Figure) -> None:
    """Write powers of ten as 10⁻³ on every logarithmic axis whose labels are matplotlib's own."""
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if type(axis.get_major_formatter()) is LogFormatterSciNotation:
                axis.set_major_formatter(_Plain())
            if type(axis.get_minor_formatter()) is LogFormatterSciNotation:
                # As matplotlib has it: between the powers only where they are few.
                axis.set_minor_formatter(_Plain(labelOnlyBase=False))
