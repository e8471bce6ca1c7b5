"""Write a report with its tables, or intervals alone: complete files only, none of the user's removed."""

from __future__ import annotations

import datetime
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from percept.errors import UsageError
from percept.files import FolderFiles, filled_folder, warned
from percept.report.document import document_of
from percept.report.select import Record, matching, quantities_of
from percept.results import Results, dumps

if TYPE_CHECKING:
    from xarray import DataTree

_FORMATS = ("svg", "pdf", "png")
_TABLES = (
    "intervals_*", "data_*", "band_*", "band", "boundaries", "contrast", "comparison", "realism",
)  # fmt: skip
_FIGURES = (
    "overview_*", "boundaries", "ratios", "boundaries_close", "stability", "design", "band",
    "band_*",
)  # fmt: skip
#: What a report may write and replace.
REPORT_FILES = FolderFiles(
    "report.html",
    (
        "report.html",
        "report.json",
        "references.bib",
        "posterior.nc",
        *(f"tables/{name}.csv" for name in _TABLES),
        *(f"figures/{name}.{form}" for name in _FIGURES for form in _FORMATS),
    ),
)
FIT_FILES = FolderFiles("fit.json", ("fit.json", "posterior.nc"))
_INTERVAL = (
    "environment", "kind", "method", "family", "joint", "level", "share", "confidence", "lower", "upper",
    "estimate", "reference", "n", "covers",
)  # fmt: skip
_DATA = ("environment", "n", "reference", "mean", "sd")
_BAND = ("environment", "method", "kind", "family")
_CURVE = ("environment", "kind", "method", "family", "joint", "shape", "level")
#: Beginnings of what a spreadsheet runs, spaces before them passed over; some take wide forms too.
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
#: Columns in the unit of their table; heads name it.
_IN_UNIT = ("lower", "upper", "estimate", "reference", "mean", "sd", "coupled", "impedance", "band")


@contextmanager
def report_folder(
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    force: bool = False,
    say: Callable[[str], None] | None = None,
) -> Iterator[Path]:
    """Give an empty folder for a report; its files move to `out_dir` at the end, the page last.

    Parameters
    ----------
    out_dir : str or Path
        Folder, made where it does not exist.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files.
    force : bool
        Replace also files of the report's names that no earlier run wrote.
    say : callable, optional
        Told of each edited file that is kept as NAME.bak; a warning by default.

    Yields
    ------
    Path
        The folder to fill.

    Raises
    ------
    UsageError
        Where `out_dir` is a file or cannot be written, where a name in it is taken by a file that
        no earlier run wrote, or where a format is unknown.
    """
    for form in formats:
        if form not in _FORMATS:
            raise UsageError(f"figures come as {', '.join(_FORMATS)}.", value=form)
    with filled_folder(out_dir, REPORT_FILES, force=force, say=say or warned) as folder:
        yield folder


def fill_report(
    folder: Path,
    results: Results,
    *,
    posterior: DataTree | None = None,
    formats: Sequence[str] = ("svg",),
    date: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write the page, report.json, tables, figures and the posterior into a folder.

    Parameters
    ----------
    folder : Path
        As `report_folder` gives it.
    results : Results
        Of a study, or read back from report.json.
    posterior : DataTree, optional
        Draws to put beside them.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files; none: only those inside the page.
    date : str, optional
        Printed on the page; today where not given. It is in no other file.
    progress : callable, optional
        Called with the name of each step.
    """
    # A fit needs none of these, and matplotlib is slow to import.
    from percept.report.basis import bibtex
    from percept.report.figures.of_results import drawings
    from percept.report.figures.output import draw_all
    from percept.report.page import render_page

    step = progress or (lambda _: None)
    step("tables")
    document = document_of(results)
    (folder / "report.json").write_text(dumps(document), encoding="utf-8")
    (folder / "tables").mkdir()
    for name, text in csv_tables(document).items():
        (folder / "tables" / name).write_text(text, encoding="utf-8")
    (folder / "references.bib").write_text(bibtex(document), encoding="utf-8")
    if posterior is not None:
        step("posterior")
        write_posterior(posterior, folder / "posterior.nc")
    step("figures")
    plots = draw_all(drawings(results), folder / "figures", formats=formats)
    step("page")
    files = {path.name for path in (*folder.iterdir(), *(folder / "tables").iterdir())}
    today = datetime.date.today().isoformat()
    page = render_page(document, plots, date=date or today, files=files)
    (folder / "report.html").write_text(page, encoding="utf-8")


@contextmanager
def fit_folder(
    out_dir: str | Path, *, force: bool = False, say: Callable[[str], None] | None = None
) -> Iterator[Path]:
    """Give an empty folder for fit.json and posterior.nc; as `report_folder` otherwise."""
    with filled_folder(out_dir, FIT_FILES, force=force, say=say or warned) as folder:
        yield folder


def fill_fit(folder: Path, results: Results, *, posterior: DataTree | None = None) -> None:
    """Write fit.json, in report.json's schema, and the posterior into a folder."""
    (folder / "fit.json").write_text(dumps(document_of(results)), encoding="utf-8")
    if posterior is not None:
        write_posterior(posterior, folder / "posterior.nc")


def rewrite_report(
    json_file: str | Path,
    out_dir: str | Path,
    *,
    formats: Sequence[str] = ("svg",),
    date: str | None = None,
    progress: Callable[[str], None] | None = None,
    force: bool = False,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Make page, tables and figures again from a report.json, without data or sampling.

    Parameters
    ----------
    json_file : str or Path
        A report.json; a posterior.nc beside it goes along.
    out_dir : str or Path
        Folder, made where it does not exist.
    formats, date, progress, force, say
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
    with report_folder(out_dir, formats=formats, force=force, say=say) as folder:
        fill_report(folder, results, formats=formats, date=date, progress=progress)
        if draws.is_file():
            shutil.copyfile(draws, folder / "posterior.nc")
    return Path(out_dir) / "report.html"


def write_posterior(posterior: DataTree, path: Path) -> None:
    """Write a posterior as netCDF.

    It is put together in memory: where HDF5 itself runs into a full disk, closing its file ends the
    process.
    """
    path.write_bytes(posterior.to_netcdf(None, engine="h5netcdf"))


def csv_tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables of a document as CSV, by file name."""
    band, tables = (document["band"] or {"rows": ()})["rows"], {}
    for name, quantity in quantities_of(document).items():
        for kind, records, columns in (
            ("intervals", document["intervals"], _INTERVAL),
            ("data", document["data"]["cells"], _DATA),
            ("band", band, (*_BAND, "reference", "band", "relative")),
        ):
            if rows := matching(records, parameter=name):
                tables[f"{kind}_{name}"] = _csv(rows, columns, quantity.unit)
    if rows := matching(band, parameter=None):
        tables["band"] = _csv(rows, (*_BAND, "impedance", "band", "relative"), "N·s/m")
    if document["boundaries"]:
        tables["boundaries"] = _curves(document["boundaries"])
    records = {
        "contrast": document["contrast"],
        "comparison": document["comparison"],
        "realism": (document["coupling"] or {}).get("realism"),
    }
    tables |= {name: _csv(rows, tuple(rows[0])) for name, rows in records.items() if rows}
    return {f"{name}.csv": text for name, text in tables.items()}


def _csv(rows: Iterable[Record], columns: Iterable[str], unit: str = "") -> str:
    """Write columns of records with every digit of a double, and nothing for None."""
    heads = [f"{name} ({unit})" if unit and name in _IN_UNIT else name for name in columns]
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    return pd.DataFrame(cells, columns=heads, dtype=object).to_csv(index=False, lineterminator="\n")


def _curves(records: Iterable[Record]) -> str:
    """Write a row per curve and frequency."""
    columns = ("omega (rad/s)", "lower", "upper", "reference", "coupled")
    rows = []
    for record in records:
        labels = {label: record[label] for label in _CURVE}
        none = [None] * len(record["omega"])
        curves = (record.get(name.removesuffix(" (rad/s)")) or none for name in columns)
        rows += [
            labels | dict(zip(columns, point, strict=True)) for point in zip(*curves, strict=True)
        ]
    return _csv(rows, (*_CURVE, *columns), "N·s/m")


def _cell(value: Any) -> Any:
    """Make what a spreadsheet would run as a formula text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        value = "; ".join(map(str, value))
    if not isinstance(value, str) or value in ("inf", "-inf"):
        return value
    runs = value.lstrip().startswith(_FORMULA) or value.startswith(("\t", "\r"))
    return f"'{value}" if runs else value
