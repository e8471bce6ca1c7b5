"""Tables of the page to paste into a paper: as LaTeX, and as HTML that Word opens.

They are read from the page, so that each number is written as the reader has seen it.
"""

from __future__ import annotations

import html
import re
from html.parser import HTMLParser

from percept.report.numbers import SUPERSCRIPT

__all__ = ["paste_tables"]

_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$",
    "×": r"$\times$", "∞": r"$\infty$", "·": r"$\cdot$", "²": "$^2$", "\u202f": r"\,",
    "±": r"$\pm$", "<": "$<$", ">": "$>$", "|": "$|$", "σ": r"$\sigma$", "γ": r"$\gamma$",
    "ε": r"$\varepsilon$", "η": r"$\eta$", "ω": r"$\omega$", "κ": r"$\kappa$",
}  # fmt: skip
_TEX_CHARACTERS = str.maketrans(_TEX)
#: Digits that `rounded` writes above the line.
_RAISED = {raised: f"$^{{{chr(plain)}}}$" for plain, raised in SUPERSCRIPT.items()}
#: What begins a table that has a name. Names of the analyst's stand in no tag of the page.
_NAMED = re.compile(r'<p class="caption" id="table-\d+" data-file="([^"]*)">')
#: Elements of a caption that are not of the table: its number, and links to files.
_NOT_PASTED = ("strong", "a")


def paste_tables(page: str, *, simulated: bool) -> dict[str, str]:
    """Return the named tables of a page by file name.

    Parameters
    ----------
    page : str
        As `render_page` makes it.
    simulated : bool
        Whether the data are simulated; captions then say so.

    Returns
    -------
    dict of str to str
        Each table as ``NAME.tex`` (needs booktabs) and as ``NAME.html``.
    """
    files = {}
    _, *parts = _NAMED.split(page)
    for name, rest in zip(parts[::2], parts[1::2], strict=True):
        whole, end, _ = rest.partition("</table>")
        table = _Table()
        table.feed(whole + end)
        caption = table.caption.strip()
        if simulated:
            caption += " Simulated data."
        _, start, body = whole.partition("<table")
        files[f"{name}.tex"] = _latex(caption, table)
        files[f"{name}.html"] = _word(caption, f"{start} border{body}{end}")
    return files


class _Table(HTMLParser):
    """A caption and a table as texts: a cell that spans several is written in the first."""

    def __init__(self) -> None:
        super().__init__()
        self.caption = ""
        self.rows: list[list[str]] = []
        self.heads = 0  # Of the rows
        self._cell = 0
        self._outside = 0  # Open elements that are not pasted
        self._covered: dict[int, int] = {}  # By column: rows that a cell above reaches into

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Open a row or a cell."""
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            spans = dict(attrs)
            self._open(int(spans.get("colspan") or 1), int(spans.get("rowspan") or 1))
        elif tag == "sub":
            self.handle_data("_")
        elif tag in _NOT_PASTED:
            self._outside += 1

    def handle_endtag(self, tag: str) -> None:
        """End what is not pasted, or the rows of heads."""
        if tag in _NOT_PASTED:
            self._outside -= 1
        elif tag == "thead":
            self.heads = len(self.rows)

    def handle_data(self, data: str) -> None:
        """Write text into the caption, or into the cell that is open."""
        text = re.sub(r"[ \n]+", " ", data)
        if not self.rows:
            self.caption += "" if self._outside else text
        elif self.rows[-1]:
            self.rows[-1][self._cell] += text

    def _open(self, columns: int, rows: int) -> None:
        row = self.rows[-1]
        while self._covered.get(len(row), 0):
            self._covered[len(row)] -= 1
            row.append("")
        self._cell = len(row)
        for _ in range(columns):
            self._covered[len(row)] = rows - 1
            row.append("")


def _latex(caption: str, table: _Table) -> str:
    """Write a table environment in booktabs' style."""
    width = max(len(row) for row in table.rows)
    rows = [rf"{' & '.join(_tex(cell.strip()) for cell in row)} \\" for row in table.rows]
    lines = [
        r"\begin{table}",
        rf"\caption{{{_tex(caption)}}}",
        rf"\begin{{tabular}}{{l{'r' * (width - 1)}}}",
        r"\toprule",
        *rows[: table.heads],
        r"\midrule",
        *rows[table.heads :],
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


def _word(caption: str, table: str) -> str:
    """Write a page of one table, which word processors open as a table."""
    title = html.escape(caption)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"</head><body>\n<p>{title}</p>\n{table}\n</body></html>\n"
    )
