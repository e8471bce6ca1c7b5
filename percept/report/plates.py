"""Figures of a page and of its folder, each drawn once for both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from percept.report.figures.canvas import Drawing
from percept.report.figures.files import Picture
from percept.report.page import Plate

__all__ = ["draw_plates"]


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
        picture = Picture(drawing)
        for form in formats:
            folder.mkdir(exist_ok=True)
            (folder / f"{drawing.name}.{form}").write_bytes(picture.file(form))
        plates[drawing.name] = Plate(drawing.title, drawing.description, picture.inline())
    return plates
