"""The tables of a report as files: CSV of records with all digits; LaTeX and Word of the page."""

from __future__ import annotations

import csv
import dataclasses
import html
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from percept.files import inert
from percept.report.basics import SUPERSCRIPT, Cell, Section, Table
from percept.results import TABLES, Results


def csv_tables(results: Results) -> dict[str, str]:
    """Return the tables of a report by file name.

    Parameters
    ----------
    results : Results
        What the tables are of.

    Returns
    -------
    dict of str to str
        CSV with a row per record, or per frequency of a curve. Columns are called as the fields of
        report.json; a field of a record within a record as PART_FIELD. The outcome of what cannot
        be rendered says so. A table without rows is absent.
    """
    tables: dict[str, Sequence[Any]] = {name: getattr(results, name) or () for name in TABLES}
    tables["data"] = results.data.cells
    tables["subjects"] = results.data.people
    tables["band"] = results.band.rows if results.band else ()
    tables["memberships"] = results.coupling.memberships if results.coupling else ()
    rows = {name: [dict(_flat(record)) for record in records] for name, records in tables.items()}
    cannot = {
        (row.environment, row.coupled) for row in results.rendering or () if row.verdict == "cannot"
    }
    for row in rows["verdicts"]:
        if (row["environment"], row["coupled"]) in cannot:
            row |= {name: "cannot be rendered" for name in row if name.endswith("outcome")}
    return {f"{name}.csv": _csv(of_table) for name, of_table in rows.items() if of_table}


def _csv(rows: Sequence[dict[str, object]]) -> str:
    """Write rows; columns that only some of them have stand where they first come."""
    heads = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for row in rows:
        lengths = {len(one) for one in row.values() if isinstance(one, np.ndarray)}
        columns = [_column(row.get(name), max(lengths, default=1)) for name in heads]
        writer.writerows(zip(*columns, strict=True))
    return text.getvalue()


def _column(value: object, length: int) -> list[object]:
    """Write a curve, or one value as often as a curve beside it has points."""
    if isinstance(value, np.ndarray):
        return list(map(_cell, value.tolist()))
    return [_cell(value)] * length


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Give the parts of a record by name, each of several records as one part."""
    if isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
        value = {str(index): part for index, part in enumerate(value)}
    elif dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _flat(part, f"{name}_{key}" if name else key)
    else:
        yield name, value


def _cell(value: object) -> object:
    """Write a value: nothing for None and NaN, and what a spreadsheet would run as text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, tuple):
        value = "; ".join(map(str, value))
    return inert(value) if isinstance(value, str) else value


_TEX = {
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
    "−": "$-$",
    "×": r"$\times$",
    "∞": r"$\infty$",
    "·": r"$\cdot$",
    "²": "$^2$",
    "\u202f": r"\,",
    "±": r"$\pm$",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
    "σ": r"$\sigma$",
    "γ": r"$\gamma$",
    "ε": r"$\varepsilon$",
    "η": r"$\eta$",
    "ω": r"$\omega$",
    "κ": r"$\kappa$",
    "†": r"$\dagger$",
}
_TEX_CHARACTERS = str.maketrans(_TEX)
#: Digits that `rounded` writes above the line.
_RAISED = {raised: f"$^{{{chr(plain)}}}$" for plain, raised in SUPERSCRIPT.items()}


def paste_tables(sections: Iterable[Section], *, simulated: bool) -> dict[str, str]:
    """Return the named tables of sections by file name.

    Parameters
    ----------
    sections : iterable of Section
        Of a page.
    simulated : bool
        Whether the data are simulated; captions then say so.

    Returns
    -------
    dict of str to str
        Each table as ``NAME.tex`` (needs booktabs) and as ``NAME.html``.
    """
    files = {}
    for table in _named_tables(sections):
        caption = f"{table.caption} Simulated data." if simulated else table.caption
        rows = [list(table.heads), *([_text(cell) for cell in row] for row in table.rows)]
        files[f"{table.name}.tex"] = _latex(caption, rows)
        files[f"{table.name}.html"] = _word(caption, rows)
    return files


def _named_tables(sections: Iterable[Section]) -> Iterator[Table]:
    """Give the tables that have a name, and more rows than one."""
    for section in sections:
        for table in section.tables:
            if table.name and len(table.rows) > 1:
                yield table
        yield from _named_tables(section.parts)


def _text(cell: Cell) -> str:
    """Write a cell as on the page."""
    return "".join(part if isinstance(part, str) else part.text for part in cell)


def _latex(caption: str, rows: list[list[str]]) -> str:
    """Write a table environment in booktabs' style; the first row has the heads."""
    written = [rf"{' & '.join(map(_tex, row))} \\" for row in rows]
    lines = [
        r"\begin{table}",
        rf"\caption{{{_tex(caption)}}}",
        rf"\begin{{tabular}}{{l{'r' * (len(rows[0]) - 1)}}}",
        r"\toprule",
        written[0],
        r"\midrule",
        *written[1:],
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _tex(text: str) -> str:
    """Write text for LaTeX; what would be a command there is text."""
    written = text.translate(_TEX_CHARACTERS).translate(_RAISED)
    # At the head of a row, a bracket or a star would belong to the line break before it.
    return f"{{}}{written}" if written.startswith(("[", "*")) else written


def _word(caption: str, rows: list[list[str]]) -> str:
    """Write a page of one table, which word processors open as a table."""
    lines = []
    for index, row in enumerate(rows):
        tag = "td" if index else "th"
        cells = "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in row)
        lines.append(f"<tr>{cells}</tr>")
    title = html.escape(caption)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"</head><body>\n<p>{title}</p>\n<table border>\n" + "\n".join(lines) + "\n</table>\n"
        "</body></html>\n"
    )
