"""Write a report, or the intervals of a study alone: complete files only, none of the user's removed."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from percept.errors import UsageError
from percept.files import filled_folder
from percept.report.document import build_document
from percept.report.plain import dumps

if TYPE_CHECKING:
    from percept.study import Study

Progress = Callable[[str], None]
_FORMATS = ("svg", "pdf", "png")


def write_report(
    study: Study,
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    why: bool = False,
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
    why : bool
        Say why the methods differ; samples the models between the two.
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
        Where `out_dir` is a file or cannot be written, or a format is unknown.
    PerceptError
        What the study refuses.
    """
    # `fit` needs none of these, and matplotlib is slow to import.
    from percept.report.basis import bibtex
    from percept.report.figures.from_document import drawings
    from percept.report.figures.output import draw_all
    from percept.report.page import render_page
    from percept.report.tables import csv_tables

    step = progress or (lambda _: None)
    for form in formats:
        if form not in _FORMATS:
            raise UsageError(f"figures come as {', '.join(_FORMATS)}.", value=form)
    with filled_folder(out_dir, last="report.html") as folder:
        step("results")
        document = build_document(study, why=why)
        (folder / "report.json").write_text(dumps(document), encoding="utf-8")
        step("tables")
        (folder / "tables").mkdir()
        for name, text in csv_tables(document).items():
            (folder / "tables" / name).write_text(text, encoding="utf-8")
        (folder / "references.bib").write_text(bibtex(document), encoding="utf-8")
        if study.posterior is not None:
            step("posterior")
            study.posterior.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
        step("figures")
        plots = draw_all(drawings(document), folder / "figures", formats=formats)
        step("page")
        files = {path.name for path in (*folder.iterdir(), *(folder / "tables").iterdir())}
        page = render_page(document, plots, date=date or datetime.date.today().isoformat(), files=files)
        (folder / "report.html").write_text(page, encoding="utf-8")
    return Path(out_dir) / "report.html"


def write_fit(study: Study, out_dir: str | Path) -> Path:
    """Write fit.json, in report.json's schema without curves, and posterior.nc.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    out_dir : str or Path
        Folder, made where it does not exist; files of other programs in it stay.

    Returns
    -------
    Path
        ``out_dir/fit.json``.

    Raises
    ------
    UsageError
        Where `out_dir` is a file or cannot be written.
    PerceptError
        What the study refuses.
    """
    with filled_folder(out_dir, last="fit.json") as folder:
        document = build_document(study, curves=False)
        (folder / "fit.json").write_text(dumps(document), encoding="utf-8")
        if study.posterior is not None:
            study.posterior.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    return Path(out_dir) / "fit.json"
