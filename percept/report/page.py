"""The report's page: its sections in reading order, and HTML that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from importlib import resources

from jinja2 import FunctionLoader, StrictUndefined
from jinja2.sandbox import SandboxedEnvironment
from markupsafe import Markup, escape

from percept.provenance import commit_of_code
from percept.report.adjustments import adjustments
from percept.report.basics import Plot, Section, Table, Value, title_of
from percept.report.boundaries import boundaries, comparison
from percept.report.checks import checks, data
from percept.report.display import display
from percept.report.methods import methods
from percept.report.overview import summary
from percept.results import Findings, Results

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
