"""Tables of a report for LaTeX, with booktabs rules."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.numbers import number
from percept.report.sections.intervals import interval_tables

_ESCAPES = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "{": r"\{",
        "}": r"\}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
    }
)
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_UNITS = {"N/m": "N/m", "N·s/m": r"N\,s/m"}
_SYMBOLS = {"k": "k", "b": "b"}
_WIDENED = {"marginal": "", "bonferroni": ", widened so that stiffness and damping hold together"}


def latex_tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables of intervals, rounded as on the page."""
    return {
        f"intervals_{'_'.join(_name(table))}.tex": _table(document, table)
        for table in interval_tables(document)
    }


def _name(table: Mapping[str, Any]) -> list[str]:
    """Say what tells a table from the others."""
    joint = table["joint"]
    return [table["parameter"], *([] if joint == "marginal" else [joint])]


def _table(document: Mapping[str, Any], table: Mapping[str, Any]) -> str:
    columns = table["columns"]
    symbol, unit = _SYMBOLS[table["parameter"]], _UNITS[table["unit"]]
    heads = " & ".join(rf"\multicolumn{{2}}{{c}}{{{c['method']}, {c['family']}}}" for c in columns)
    rules = "".join(rf"\cmidrule(lr){{{4 + 2 * i}-{5 + 2 * i}}}" for i in range(len(columns)))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{Adjusted ${symbol}$ in {unit}: limits by environment, kind and method"
        rf"{_WIDENED[table['joint']]}.}}",
        rf"\label{{tab:intervals-{'-'.join(_name(table))}}}",
        rf"\begin{{tabular}}{{llr{'rr' * len(columns)}}}",
        r"\toprule",
        rf"& & & {heads} \\",
        rules,
        "Environment & Kind & Reference" + " & lower & upper" * len(columns) + r" \\",
    ]
    seen = None
    for row in table["rows"]:
        if row["environment"] != seen:
            lines.append(r"\midrule")
        name = _escaped(row["environment"]) if row["environment"] != seen else ""
        seen = row["environment"]
        cells = [name, row["kind"], _number(document, row["reference"])]
        for place in row["cells"]:
            limits = ("lower", "upper")
            cells += [_number(document, f"{place}/{limit}") if place else "" for limit in limits]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _number(document: Mapping[str, Any], place: str) -> str:
    text = number(document, place).text
    if text == "–":
        return "--"
    mantissa, _, power = text.partition(" × 10")
    digits = mantissa.replace("−", "-").replace("∞", r"\infty")
    return rf"${digits} \times 10^{{{power.translate(_SUPERSCRIPTS)}}}$" if power else f"${digits}$"


def _escaped(text: str) -> str:
    return text.translate(_ESCAPES)
