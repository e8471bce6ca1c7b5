"""Write a report: complete files only, none of the user's removed."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from percept.report.document import build_document
from percept.report.folder import filled_folder
from percept.report.formats import check_formats
from percept.report.pdf import needed_browser, print_pdf
from percept.report.plain import Digits, dumps

if TYPE_CHECKING:
    from percept.processes import Processes
    from percept.report.plates import Drawn
    from percept.report.rendering import Plate
    from percept.study import Study

__all__ = ["write_report"]

Progress = Callable[[str], None]
_DRAWING = ("percept.report.plates", "matplotlib.backends.backend_svg", "matplotlib.figure")


def write_report(
    study: Study,
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    pdf: bool = False,
    date: str | None = None,
    progress: Progress | None = None,
    processes: int | None = None,
) -> Path:
    """Write the page, report.json, tables, figures and the posterior of a study.

    Everything is first written beside `out_dir`, then moved into it file by file, the page last: a run that
    fails leaves nothing behind. Of the files in `out_dir` only those an earlier run wrote are replaced or
    removed.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    out_dir : str or Path
        Folder, made where it does not exist.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files; none: only those inside the page.
    pdf : bool
        Print the page to report.pdf too, by a Chromium of the machine.
    date : str, optional
        Printed on the page; today where not given. It is in no other file.
    progress : callable, optional
        Called with the name of each step.
    processes : int, optional
        1: everything in this process. By default others, where there are more cores, take a part of the work
        and draw the figures while the analysis goes on; the files are the same.

    Returns
    -------
    Path
        The page, ``out_dir/report.html``.

    Raises
    ------
    UsageError
        Where `out_dir` is a file or cannot be written, a format is unknown, or no Chromium prints the PDF.
    PerceptError
        What the study refuses.
    """
    from percept.study.divided import divided

    step = progress or (lambda _: None)
    check_formats(formats)
    if pdf:
        needed_browser()
    with (
        filled_folder(out_dir, last="report.html") as folder,
        divided(study, count=processes, also=_DRAWING) as beside,
    ):
        step("results")
        figures = _Figures(beside, formats)
        document = build_document(study, seen=figures.begin)
        _fill(folder, study, document, figures, date or datetime.date.today().isoformat(), step)
        if pdf:
            step("pdf")
            print_pdf(folder / "report.html", folder / "report.pdf")
    return Path(out_dir) / "report.html"


class _Figures(Mapping[str, "Plate"]):
    """Figures of a document, begun as soon as it has their numbers, and waited for where they are shown."""

    def __init__(self, beside: Processes, formats: Sequence[str]) -> None:
        self._beside, self._formats = beside, tuple(formats)
        self._begun: dict[str, Callable[[], Drawn]] = {}

    def begin(self, document: Mapping[str, Any]) -> None:
        """Have drawn what the document now has numbers for, and had not before."""
        from percept.report.figures.catalogue import drawings
        from percept.report.plates import drawn

        for drawing in drawings(document):
            if drawing.name not in self._begun:
                self._begun[drawing.name] = cache(self._beside.ask(drawn, drawing, self._formats))

    def __getitem__(self, name: str) -> Plate:
        return self._begun[name]().plate

    def __iter__(self) -> Iterator[str]:
        return iter(self._begun)

    def __len__(self) -> int:
        return len(self._begun)

    def write(self, folder: Path) -> None:
        """Write the files."""
        for figure in self._begun.values():
            figure().write(folder)


def _fill(
    folder: Path, study: Study, document: dict[str, object], figures: _Figures, date: str, step: Progress
) -> None:
    from percept.report.latex import latex_tables
    from percept.report.page import render_page
    from percept.report.references import bibtex
    from percept.report.tables import csv_tables
    from percept.study.posterior_file import write_posterior

    digits = Digits()
    (folder / "report.json").write_text(dumps(document, digits=digits), encoding="utf-8")
    step("tables")
    (folder / "tables").mkdir()
    for name, text in (csv_tables(document, digits=digits) | latex_tables(document)).items():
        (folder / "tables" / name).write_text(text, encoding="utf-8")
    (folder / "references.bib").write_text(bibtex(document), encoding="utf-8")
    if study.posterior_groups is not None:
        step("posterior")
        write_posterior(study.posterior_groups, folder / "posterior.nc")
    step("page")
    (folder / "report.html").write_text(render_page(document, figures, date=date), encoding="utf-8")
    step("figures")
    figures.write(folder / "figures")
