"""Tables of the page to paste into a paper: as LaTeX, and as HTML that Word opens."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator

from percept.report.numbers import SUPERSCRIPT
from percept.report.sections import Cell, Section, Table

_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$",
    "×": r"$\times$", "∞": r"$\infty$", "·": r"$\cdot$", "²": "$^2$", "\u202f": r"\,",
    "±": r"$\pm$", "<": "$<$", ">": "$>$", "|": "$|$", "σ": r"$\sigma$", "γ": r"$\gamma$",
    "ε": r"$\varepsilon$", "η": r"$\eta$", "ω": r"$\omega$", "κ": r"$\kappa$", "†": r"$\dagger$",
}  # fmt: skip
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
