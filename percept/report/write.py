"""Write a report: complete files only, none of the user's removed."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from percept.files import filled_folder
from percept.html import needed_browser, print_pdf
from percept.report.document import build_document
from percept.report.formats import check_formats
from percept.report.plain import Digits, dumps

if TYPE_CHECKING:
    from percept.study import Study

Progress = Callable[[str], None]


def write_report(
    study: Study,
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    pdf: bool = False,
    date: str | None = None,
    progress: Progress | None = None,
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
    step = progress or (lambda _: None)
    check_formats(formats)
    if pdf:
        needed_browser()
    with filled_folder(out_dir, last="report.html") as folder:
        step("results")
        document = build_document(study)
        _fill(folder, study, document, formats, date or datetime.date.today().isoformat(), step)
        if pdf:
            step("pdf")
            print_pdf(folder / "report.html", folder / "report.pdf")
    return Path(out_dir) / "report.html"


def _fill(
    folder: Path, study: Study, document: dict[str, object], formats: Sequence[str], date: str, step: Progress
) -> None:
    from percept.report.figures.catalogue import drawings
    from percept.report.latex import latex_tables
    from percept.report.page import render_page
    from percept.report.plates import draw_plates
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
    step("figures")
    plates = draw_plates(drawings(document), folder / "figures", formats=formats)
    step("page")
    (folder / "report.html").write_text(render_page(document, plates, date=date), encoding="utf-8")
