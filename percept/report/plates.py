"""Figures of a page and of its folder, each drawn once for both."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from percept.report.figures.canvas import Drawing
from percept.report.figures.files import Picture
from percept.report.rendering import Plate


@dataclass(frozen=True)
class Drawn:
    """A figure as its files and as the page shows it."""

    files: dict[str, bytes]  # Contents by file name
    plate: Plate

    def write(self, folder: Path) -> None:
        """Write the files; the folder is made where there is something to write."""
        for name, content in self.files.items():
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(content)


def drawn(drawing: Drawing, formats: Sequence[str]) -> Drawn:
    """Draw one figure."""
    picture = Picture(drawing)
    files = {f"{drawing.name}.{form}": picture.file(form) for form in formats}
    return Drawn(files, Plate(drawing.title, drawing.description, picture.inline()))


def draw_plates(
    drawings: Iterable[Drawing], folder: Path, *, formats: Sequence[str] = ("svg",)
) -> dict[str, Plate]:
    """Draw figures, write their files, and return what the page shows."""
    plates = {}
    for drawing in drawings:
        figure = drawn(drawing, formats)
        figure.write(folder)
        plates[drawing.name] = figure.plate
    return plates
