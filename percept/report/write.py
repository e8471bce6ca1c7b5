"""Write a report: complete files only, and none of the user's replaced."""

from __future__ import annotations

import datetime
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

from percept.errors import UsageError
from percept.files import FolderFiles, filled_folder
from percept.report.basics import Plot
from percept.report.overview import findings
from percept.report.tables import csv_tables
from percept.results import Beside, Results

_FORMATS = ("svg", "pdf", "png")
#: What a report may write and replace.
REPORT_FILES = FolderFiles(
    "report.html",
    (
        "report.html",
        "report.json",
        "references.bib",
        "posterior.nc",
        *(f"tables/*.{form}" for form in ("csv", "tex", "html")),
        *(f"figures/*.{form}" for form in _FORMATS),
    ),
)


@contextmanager
def report_folder(
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    force: bool = False,
) -> Iterator[Path]:
    """Give an empty folder for a report; its files move to `out_dir` at the end, the page last.

    Parameters
    ----------
    out_dir : str or Path
        Folder, made where it does not exist.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files.
    force : bool
        Write also into a folder with files that percept did not write.

    Yields
    ------
    Path
        The folder to fill.

    Raises
    ------
    UsageError
        Where `out_dir` is a file or cannot be written, where it holds files that percept did not
        write, or where a format is unknown.
    """
    for form in formats:
        if form not in _FORMATS:
            raise UsageError(f"figures come as {', '.join(_FORMATS)}.", value=form)
    with filled_folder(out_dir, REPORT_FILES, force=force) as folder:
        yield folder


def fill_report(
    folder: Path,
    results: Results,
    *,
    posterior: Callable[[], bytes | None] | None = None,
    formats: Sequence[str] = ("svg",),
    date: str | None = None,
    progress: Callable[[str], None] | None = None,
    beside: Beside = nullcontext,
) -> None:
    """Write the page, report.json, tables, figures and the posterior into a folder.

    Parameters
    ----------
    folder : Path
        As `report_folder` gives it.
    results : Results
        Of a study, or read back from report.json.
    posterior : callable, optional
        Gives the draws as netCDF, to put beside them; None where there are none.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files; none: only those inside the page.
    date : str, optional
        Printed on the page; today where not given. It is in no other file.
    progress : callable, optional
        Called with the name of each step.
    beside : callable
        Draws the figures while the rest is written, as `percept.workers.beside` does.
    """
    # Matplotlib and Jinja2 are slow to import.
    from percept.report.methods import bibtex
    from percept.report.page import build_sections, render_page
    from percept.report.tables import paste_tables

    step = progress or (lambda _: None)
    step("writing tables")
    summary = findings(results)

    def draw() -> dict[str, Plot]:
        from percept.report.figures import drawings
        from percept.report.figures.canvas import draw_all

        step("drawing figures")
        return draw_all(drawings(results), folder / "figures", formats=formats)

    with beside(draw) as plots:
        (folder / "report.json").write_text(results.to_json(summary), encoding="utf-8")
        (folder / "tables").mkdir()
        sections = build_sections(results, summary)
        _write_tables(folder, csv_tables(results))
        _write_tables(folder, paste_tables(sections, simulated=results.data.simulated))
        (folder / "references.bib").write_text(bibtex(results), encoding="utf-8")
        if posterior is not None:
            step("writing the posterior")
            draws = posterior()
            if draws is not None:
                (folder / "posterior.nc").write_bytes(draws)
        drawn = plots()
        step("writing the page")
        files = {path.name for path in (*folder.iterdir(), *(folder / "tables").iterdir())}
        today = datetime.date.today().isoformat()
        page = render_page(results, sections, drawn, date=date or today, files=files)
        (folder / "report.html").write_text(page, encoding="utf-8")


def _write_tables(folder: Path, tables: Mapping[str, str]) -> None:
    """Write tables by file name."""
    for name, text in tables.items():
        (folder / "tables" / name).write_text(text, encoding="utf-8")


def rewrite_report(
    json_file: str | Path,
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    date: str | None = None,
    progress: Callable[[str], None] | None = None,
    force: bool = False,
) -> Path:
    """Make page, tables and figures again from a report.json, without data or sampling.

    Parameters
    ----------
    json_file : str or Path
        A report.json; a posterior.nc beside it goes along.
    out_dir : str or Path
        Folder, made where it does not exist.
    formats, date, progress, force
        As `fill_report` and `report_folder` take them.

    Returns
    -------
    Path
        The page, ``out_dir/report.html``; equal to the one made at once but for the date.

    Raises
    ------
    UsageError
        Where `json_file` cannot be read or is no report, and as `report_folder`.
    """
    results = Results.load(json_file)
    draws = Path(json_file).with_name("posterior.nc")
    with report_folder(out_dir, formats=formats, force=force) as folder:
        try:
            fill_report(folder, results, formats=formats, date=date, progress=progress)
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
            raise UsageError(
                f"its parts do not fit each other: {error}.",
                file=str(json_file),
                hint="Make the report again from its data.",
            ) from error
        if draws.is_file():
            shutil.copyfile(draws, folder / "posterior.nc")
    return Path(out_dir) / "report.html"
