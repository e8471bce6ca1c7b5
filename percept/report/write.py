"""The page, with its sections in reading order, and the files of a report.

The page needs no other file. Files are complete, and none of the user's is replaced.
"""

from __future__ import annotations

import base64
import datetime
import hashlib
import re
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

from markupsafe import Markup, escape

from percept.errors import UsageError
from percept.files import filled_folder
from percept.provenance import commit_of_code
from percept.report.adjustments import adjustments
from percept.report.basics import Plot, Section, Table, Value, title_of
from percept.report.boundaries import boundaries, comparison
from percept.report.checks import checks, data
from percept.report.display import display
from percept.report.methods import bibtex, methods
from percept.report.overview import findings, summary
from percept.report.tables import csv_tables, paste_tables
from percept.results import Beside, Findings, Results, in_turn

_FORMATS = ("svg", "pdf", "png")
#: What a report may write and replace.
REPORT_FILES = (
    "report.html",
    "report.json",
    "references.bib",
    "posterior.nc",
    *(f"tables/*.{form}" for form in ("csv", "tex", "html")),
    *(f"figures/*.{form}" for form in _FORMATS),
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
    compute: Callable[[], Results],
    *,
    posterior: Callable[[], bytes | None] | None = None,
    formats: Sequence[str] = ("svg",),
    date: str | None = None,
    progress: Callable[[str], None] | None = None,
    beside: Beside = in_turn,
) -> None:
    """Write the page, report.json, tables, figures and the posterior into a folder.

    Parameters
    ----------
    folder : Path
        As `report_folder` gives it.
    compute : callable
        Gives the results of a study, or what was read back from report.json.
    posterior : callable, optional
        Gives the draws as netCDF, to put beside them; None where there are none.
    formats : sequence of {"svg", "pdf", "png"}
        Of the figures' files; none: only those inside the page.
    date : str, optional
        Printed on the page; today where not given. It is in no other file.
    progress : callable, optional
        Called with the name of each step.
    beside : callable
        Imports matplotlib while results are computed, and draws figures while the rest is written,
        as `percept.workers.beside` does.
    """
    step = progress or (lambda _: None)

    def ready_to_draw() -> Callable[[Results], dict[str, Plot]]:
        # Matplotlib is slow to import.
        from percept.report.figures import drawings
        from percept.report.figures.canvas import draw_all

        return lambda drawn: draw_all(drawings(drawn), folder / "figures", formats=formats)

    with beside(ready_to_draw) as begin:
        results = compute()
        plots = begin(results)
        step("writing tables")
        found = findings(results)
        (folder / "report.json").write_text(results.to_json(found), encoding="utf-8")
        (folder / "tables").mkdir()
        sections = build_sections(results, found)
        pasted = paste_tables(sections, simulated=results.data.simulated)
        for name, text in (csv_tables(results) | pasted).items():
            (folder / "tables" / name).write_text(text, encoding="utf-8")
        (folder / "references.bib").write_text(bibtex(results), encoding="utf-8")
        if posterior is not None:
            step("writing the posterior")
            draws = posterior()
            if draws is not None:
                (folder / "posterior.nc").write_bytes(draws)
        step("drawing figures")
        drawn = plots()
        step("writing the page")
        files = {path.name for path in folder.rglob("*")}
        today = datetime.date.today().isoformat()
        page = render_page(results, sections, drawn, date=date or today, files=files)
        (folder / "report.html").write_text(page, encoding="utf-8")


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
            fill_report(folder, lambda: results, formats=formats, date=date, progress=progress)
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
            raise UsageError(
                f"its parts do not fit each other: {error}.",
                file=str(json_file),
                hint="Make the report again from its data.",
            ) from error
        if draws.is_file():
            shutil.copyfile(draws, folder / "posterior.nc")
    return Path(out_dir) / "report.html"


_LONG = 32  # letters of a cell that may be broken
#: How texts of cells are marked.
_TONES = {
    "feels real": "yes",
    "within": "yes",
    "does not feel real": "no",
    "beyond": "no",
    "cannot be rendered": "no",
    "not decided": "none",
    "too little data": "none",
    "–": "none",
}


def build_sections(results: Results, found: Findings) -> list[Section]:
    """Return the answer, the methods against each other, and what is folded."""
    return [
        summary(results, found),
        comparison(results),
        adjustments(results),
        boundaries(results),
        display(results),
        checks(results),
        data(results),
        methods(results, found.paragraph),
    ]


def render_page(
    results: Results,
    sections: Sequence[Section],
    plots: Mapping[str, Plot],
    *,
    date: str,
    files: Collection[str] = (),
) -> str:
    """Render the page; tables link to `files`."""
    # Jinja2 is slow to import.
    from jinja2 import FunctionLoader, StrictUndefined
    from jinja2.sandbox import SandboxedEnvironment

    script = _asset("page.js")
    environment = SandboxedEnvironment(
        loader=FunctionLoader(_asset),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = _symbols
    return environment.get_template("page.html.j2").render(
        results=results,
        sections=[section for section in sections if section.filled],
        files=files,
        title=results.provenance.scene["report"].get("title") or title_of(results),
        words=results.provenance.scene["report"],
        date=date,
        commit=commit_of_code(),
        tone=_tone,
        tones=_TONES,
        plots=plots,
        style=_asset("page.css"),
        script=script,
        policy=_policy(script),
    )


def _tone(table: Table, column: int) -> str:
    """Return the classes of a column: of text, and of text that may be broken."""
    cells = [row[column] for row in table.rows]
    if any(isinstance(part, Value) for cell in cells for part in cell):
        return "number"
    longest = max(len("".join(map(str, cell))) for cell in cells)
    return "text long" if longest > _LONG else "text"


def _policy(script: str) -> str:
    """Return a content security policy: the script runs, and nothing is fetched or sent.

    A script runs only if its text stands in the page byte for byte.
    """
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    # Figures are full of style attributes, which have no hashes.
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _asset(name: str) -> Markup:
    """Return a template, style sheet or script, as it stands."""
    file = resources.files("percept.report").joinpath("templates", name)
    return Markup(file.read_text(encoding="utf-8"))


def _symbols(text: str) -> Markup:
    """Set the subscripts of Z_h and its like, and escape the rest."""
    return Markup(re.sub(r"Z_(h,vc|h|e|c|d)\b", r"Z<sub>\1</sub>", str(escape(text))))
