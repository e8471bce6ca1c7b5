"""Tables to paste into a paper: as LaTeX, and as HTML that Word opens."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

from percept.errors import capitalised
from percept.report.numbers import SUPERSCRIPT, digits_of, number
from percept.report.sections import Intervals, Matrix, intervals
from percept.report.select import METHOD_NAMES, words_of
from percept.results import OverviewRow, Results

__all__ = ["paste_tables"]

_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$",
    "×": r"$\times$", "∞": r"$\infty$", "·": r"$\cdot$", "²": "$^2$", "\u202f": r"\,",
}  # fmt: skip
_TEX_CHARACTERS = str.maketrans(_TEX)
#: Digits that `rounded` writes above the line.
_RAISED = {raised: f"$^{{{chr(plain)}}}$" for plain, raised in SUPERSCRIPT.items()}


@dataclass(frozen=True)
class _Table:
    """A table of texts."""

    name: str
    caption: str
    heads: list[str]
    rows: list[list[str]]


def paste_tables(results: Results, rows: Sequence[OverviewRow]) -> dict[str, str]:
    """Return the first table and those of the intervals by file name.

    Parameters
    ----------
    results : Results
        What the tables are of.
    rows : sequence of OverviewRow
        Of the first table.

    Returns
    -------
    dict of str to str
        Each table as ``NAME.tex`` (needs booktabs) and as ``NAME.html``, rounded as on the page.
    """
    tables = []
    if rows:
        tables.append(_overview(results, rows))
    section = intervals(results)
    if section is not None and isinstance(section.view, Intervals):
        tables += [_intervals(results, matrix) for matrix in section.view.matrices]
    files = {}
    for table in tables:
        files[f"{table.name}.tex"] = _latex(table)
        files[f"{table.name}.html"] = _page(table)
    return files


def _overview(results: Results, rows: Sequence[OverviewRow]) -> _Table:
    """Return references, estimates, biases and the next user's range."""
    words = words_of(results)
    lines = []
    for row in rows:
        style = "bias" if row.relative else "difference"
        digits = digits_of(row.estimate, row.user_lower, row.user_upper)
        bias = [
            number(value, digits=digits, style=style).text
            for value in (row.bias, row.bias_lower, row.bias_upper)
        ]
        lines.append(
            [
                row.environment,
                f"{row.parameter} ({row.unit})" if row.unit else row.parameter,
                number(row.reference, style="short").text,
                number(row.estimate, digits=digits).text,
                bias[0],
                f"{bias[1]} to {bias[2]}",
                _limits(row.user_lower, row.user_upper),
            ]
        )
    heads = [
        capitalised(words.environment),
        "Quantity",
        "Reference",
        "Estimate",
        "Bias",
        "Interval of the bias",
        f"Next {words.user}",
    ]
    level = number(rows[0].level, style="short percent").text
    caption = f"What {words.users} set, with {level} intervals ({METHOD_NAMES[rows[0].method]})."
    return _Table("overview", _with_origin(caption, results), heads, lines)


def _intervals(results: Results, matrix: Matrix) -> _Table:
    """Return the limits of one quantity, by kind and method."""
    rows = []
    for line in matrix.grid.lines:
        row = [line.environment]
        for cell in line.cells:
            row.append("–" if cell is None else _limits(cell.lower, cell.upper))
        rows.append(row)
    unit = f" in {matrix.unit}" if matrix.unit else ""
    caption = f"{matrix.title}{unit}: limits by kind and method ({matrix.grid.family})."
    heads = [capitalised(words_of(results).environment)]
    for column in matrix.grid.columns:
        heads.append(f"{column.kind}, {METHOD_NAMES[column.method]}")
    name = f"intervals_{matrix.parameter}"
    return _Table(name, _with_origin(caption, results), heads, rows)


def _with_origin(caption: str, results: Results) -> str:
    return f"{caption} Simulated data." if results.data.simulated else caption


def _limits(lower: float | None, upper: float | None) -> str:
    """Write two limits with the digits of the page."""
    texts = [number(end, digits=digits_of(end, lower, upper)).text for end in (lower, upper)]
    return " to ".join(texts)


def _latex(table: _Table) -> str:
    """Write a table environment in booktabs' style."""
    lines = [
        r"\begin{table}",
        rf"\caption{{{_tex(table.caption)}}}",
        rf"\begin{{tabular}}{{l{'r' * (len(table.heads) - 1)}}}",
        r"\toprule",
        rf"{' & '.join(map(_tex, table.heads))} \\",
        r"\midrule",
        *(rf"{' & '.join(map(_tex, row))} \\" for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _tex(text: str) -> str:
    """Write text for LaTeX; what would be a command there is text."""
    written = text.translate(_TEX_CHARACTERS).translate(_RAISED)
    # A row that begins with a bracket would be an option of the line break before it.
    return f"{{}}{written}" if written.startswith("[") else written


def _page(table: _Table) -> str:
    """Write a page of one table, which word processors open as a table."""
    heads = "".join(f"<th>{html.escape(head)}</th>" for head in table.heads)
    body = ""
    for row in table.rows:
        cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in row)
        body += f"<tr>{cells}</tr>\n"
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(table.caption)}</title></head><body>\n"
        f'<table border="1"><caption>{html.escape(table.caption)}</caption>\n'
        f"<tr>{heads}</tr>\n{body}</table>\n</body></html>\n"
    )
