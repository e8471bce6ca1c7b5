"""Tables of a report as CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from percept.report.interval_tables import interval_tables
from percept.report.numbers import SUPERSCRIPT, number
from percept.report.select import Record, distinct, matching, quantities_of
from percept.sessions.read import neutralised

_INTERVAL = ("environment", "kind", "method", "family", "joint", "level", "share", "confidence")
_CURVE = ("environment", "kind", "method", "family", "joint", "shape", "level")


def csv_tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables of a document as CSV, by file name."""
    tables = {}
    quantities = quantities_of(document)
    for parameter in distinct(document["intervals"], "parameter"):
        heads = {name: name for name in _INTERVAL}
        heads |= _with_unit(("lower", "upper", "estimate", "reference"), quantities[parameter].unit)
        heads |= {"n": "n", "covers": "covers"}
        tables[f"intervals_{parameter}"] = _table(heads, matching(document["intervals"], parameter=parameter))
    if document["boundaries"]:
        tables["boundaries"] = _curves(document["boundaries"])
    cells = document["data"]["cells"]
    for parameter in distinct(cells, "parameter"):
        heads = {"environment": "environment", "n": "n"}
        heads |= _with_unit(("reference", "mean", "sd"), quantities[parameter].unit)
        tables[f"data_{parameter}"] = _table(heads, matching(cells, parameter=parameter))
    band = document["band"] or {}
    for parameter in dict.fromkeys(row.get("parameter") for row in band.get("rows") or ()):
        heads = {name: name for name in ("environment", "method", "kind", "family")}
        size, unit = (
            ("impedance", "N·s/m") if parameter is None else ("reference", quantities[parameter].unit)
        )
        heads |= {**_with_unit((size, "band"), unit), "relative": "relative"}
        name = "band" if parameter is None else f"band_{parameter}"
        tables[name] = _table(heads, matching(band["rows"], parameter=parameter))
    records = {
        "contrast": document["contrast"],
        "comparison": document["comparison"],
        "realism": (document["coupling"] or {}).get("realism"),
    }
    for name, rows in records.items():
        if rows:
            tables[name] = _table({head: head for head in rows[0]}, rows)
    return {f"{name}.csv": text for name, text in tables.items()}


def _with_unit(names: Iterable[str], unit: str) -> dict[str, str]:
    return {name: f"{name} ({unit})" if unit else name for name in names}


def _curves(records: Sequence[Record]) -> str:
    """Write a row per curve and frequency."""
    heads = {"omega": "omega (rad/s)"} | _with_unit(("lower", "upper", "reference", "coupled"), "N·s/m")
    rows = (
        [*labels, *point]
        for record in records
        if (labels := [_cell(record[label]) for label in _CURVE])
        for point in zip(*(record.get(name) or [None] * len(record["omega"]) for name in heads), strict=True)
    )
    return _written([*_CURVE, *heads.values()], rows)


def _table(heads: Mapping[str, str], rows: Iterable[Record]) -> str:
    return _written(heads.values(), ([_cell(row.get(name)) for name in heads] for row in rows))


def _written(head: Iterable[str], rows: Iterable[list[Any]]) -> str:
    """Write CSV; its writer gives every digit of a double, and nothing for None."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Make what a spreadsheet would run as a formula text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        value = "; ".join(map(str, value))
    return neutralised(value) if isinstance(value, str) and value not in ("inf", "-inf") else value


_ESCAPES = str.maketrans(
    {letter: f"\\{letter}" for letter in "&%$#_{}"}
    | {
        letter: rf"\text{name}{{}}"
        for letter, name in {
            "\\": "backslash", "~": "asciitilde", "^": "asciicircum", "<": "less", ">": "greater", "|": "bar",
        }.items()
    }
)  # fmt: skip
_LOWERED = {raised: plain for plain, raised in SUPERSCRIPT.items()}
_WIDENED = {"marginal": "", "bonferroni": ", widened so that {} hold together"}


def latex_tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables of intervals for LaTeX with booktabs rules, by file name."""
    tables = {}
    for table in interval_tables(document):
        suffix = [] if table["joint"] == "marginal" else [table["joint"]]
        names = [table["parameter"], *suffix]
        tables[f"intervals_{'_'.join(names)}.tex"] = _latex(document, table, "-".join(names))
    return tables


def _latex(document: Mapping[str, Any], table: Record, label: str) -> str:
    columns, quantities = table["columns"], quantities_of(document)
    symbol = quantities[table["parameter"]].symbol.translate(_ESCAPES)
    unit = table["unit"].translate(_ESCAPES).replace("·", r"\,")
    one = str(document["data"]["words"]["environment"][0]).translate(_ESCAPES)
    both = " and ".join(quantity.label for quantity in quantities.values()).translate(_ESCAPES)
    heads = " & ".join(rf"\multicolumn{{2}}{{c}}{{{c['method']}, {c['family']}}}" for c in columns)
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{Adjusted {symbol if len(symbol) > 1 else f'${symbol}$'}{f' in {unit}' if unit else ''}: "
        rf"limits by {one}, kind and method{_WIDENED[table['joint']].format(both)}.}}",
        rf"\label{{tab:intervals-{label}}}",
        rf"\begin{{tabular}}{{llr{'rr' * len(columns)}}}",
        r"\toprule",
        rf"& & & {heads} \\",
        "".join(rf"\cmidrule(lr){{{4 + 2 * i}-{5 + 2 * i}}}" for i in range(len(columns))),
        f"{one[:1].upper()}{one[1:]} & Kind & Reference" + " & lower & upper" * len(columns) + r" \\",
    ]
    environment = None
    for row in table["rows"]:
        name = ""
        if row["environment"] != environment:
            environment = row["environment"]
            name = environment.translate(_ESCAPES)
            lines.append(r"\midrule")
        cells = [name, row["kind"], _latex_number(document, row["reference"])]
        for pointer in row["cells"]:
            cells += [
                _latex_number(document, f"{pointer}/{limit}") if pointer else ""
                for limit in ("lower", "upper")
            ]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _latex_number(document: Mapping[str, Any], pointer: str) -> str:
    text = number(document, pointer, style="fixed").text
    if text == "–":
        return "--"
    mantissa, _, power = text.partition(" × 10")
    digits = mantissa.replace("−", "-").replace("∞", r"\infty")
    return rf"${digits} \times 10^{{{power.translate(_LOWERED)}}}$" if power else f"${digits}$"
