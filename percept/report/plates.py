"""Figures of a page and of its folder, each drawn once for both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from percept.report.figures.canvas import Drawing
from percept.report.figures.files import Picture
from percept.report.rendering import Plate

__all__ = ["Drawn", "draw_plates", "drawn"]


@dataclass(frozen=True)
class Drawn:
    """A figure as its files and as the page shows it.

    Attributes
    ----------
    files : dict of str to bytes
        Contents by file name.
    plate : Plate
    """

    files: dict[str, bytes]
    plate: Plate

    def write(self, folder: Path) -> None:
        """Write the files; the folder is made where there is something to write."""
        for name, content in self.files.items():
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(content)


def drawn(drawing: Drawing, formats: Sequence[str]) -> Drawn:
    """Draw one figure.

    Parameters
    ----------
    drawing : Drawing
    formats : sequence of {"svg", "pdf", "png"}
        Of the files.

    Returns
    -------
    Drawn

    Raises
    ------
    UsageError
        An unknown format.
    """
    picture = Picture(drawing)
    files = {f"{drawing.name}.{form}": picture.file(form) for form in formats}
    return Drawn(files, Plate(drawing.title, drawing.description, picture.inline()))


def draw_plates(
    drawings: Iterable[Drawing], folder: Path, *, formats: Sequence[str] = ("svg",)
) -> dict[str, Plate]:
    """Draw figures, write their files, and return what the page shows.

    Parameters
    ----------
    drawings : iterable of Drawing
        With names that differ.
    folder : Path
        For the files; made where it does not exist and there is something to write.
    formats : sequence of {"svg", "pdf", "png"}
        Of the files.

    Returns
    -------
    dict of str to Plate
        By the name of the drawing.

    Raises
    ------
    UsageError
        An unknown format.
    """
    plates = {}
    for drawing in drawings:
        figure = drawn(drawing, formats)
        figure.write(folder)
        plates[drawing.name] = figure.plate
    return plates
