"""A page in Markdown, its finished work, and what its code says while it runs."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from percept.checkpoint import Checkpoint
from percept.provenance import markdown_table

#: Beside the page that is made of it.
_FINISHED = "finished.jsonl"


class Page:
    """A title with paragraphs and tables below it.

    Parameters
    ----------
    title : str
        Of the page.
    *paragraphs : str
        That come first.
    right : bool
        Whether everything on the page is as it should be.
    """

    def __init__(self, title: str, *paragraphs: str, right: bool = True) -> None:
        self.parts = [f"# {title}", *paragraphs]
        self.right = right

    def add(self, text: str) -> None:
        """Add a paragraph, a heading or a figure."""
        self.parts.append(text)

    def table(self, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Add a table; numbers are rounded to four digits."""
        cells = [[cell(value) for value in row] for row in rows]
        self.parts.append(markdown_table(heads, cells).rstrip())

    def figure(self, folder: Path, name: str, figure: Figure, says: str) -> None:
        """Write a figure into `figures` of the page's folder, and add it with what it says."""
        path = folder / "figures" / f"{name}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        # Equal figures are equal files.
        with rc_context({"svg.hashsalt": name}):
            figure.savefig(path, metadata={"Date": None})
        self.parts.append(f"![{name}](figures/{path.name})\n\n{says}")

    @property
    def text(self) -> str:
        """The page in Markdown."""
        return "\n\n".join(self.parts) + "\n"


def cell(value: object) -> str:
    """Write a value of a table."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(cell, value))
    return str(value).replace("|", "\\|")


def store(folder: Path | None, plan: str) -> Checkpoint:
    """Return what the folder of a page keeps of a plan; without a folder nothing is kept."""
    path = folder / _FINISHED if folder else None
    return Checkpoint(path, plan, what="finished")


def say(line: str) -> None:
    """Tell on standard error what is worked on."""
    print(line, file=sys.stderr, flush=True)
