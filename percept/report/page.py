"""The report's page from its sections: it needs nothing else."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib import resources

from jinja2 import FunctionLoader, StrictUndefined
from jinja2.sandbox import SandboxedEnvironment
from markupsafe import Markup, escape

from percept.provenance import commit_of_code
from percept.report.numbers import number
from percept.report.sections import Plot, Section, Table, Value
from percept.report.select import title_of
from percept.results import Findings, Results

__all__ = ["Places", "render_page"]

_PACKAGE = "percept.report"
#: What stands on a page where there is no number.
_NO_NUMBER = Markup('<span class="none">–</span>')
_LONG = 32  # letters of a cell that may be broken
#: How texts of cells are marked.
_TONES = {
    "feels real": "yes",
    "within": "yes",
    "does not feel real": "no",
    "beyond": "no",
    "cannot be rendered": "no",
    "not decided": "none",
    "not rendered": "none",
    "too little data": "none",
    "–": "none",
}


def render_page(
    results: Results,
    found: Findings,
    sections: Sequence[Section],
    plots: Mapping[str, Plot],
    *,
    date: str,
    files: Collection[str] = (),
) -> str:
    """Render the page: numbers know their place in report.json, tables link to `files`."""
    places = Places(results, found)

    def written(value: Value) -> Markup:
        shown = number(value.exact, digits=value.digits, style=value.style)
        if not shown.exact:
            return _NO_NUMBER
        return Markup('<data value="{}" data-at="{}">{}</data>').format(
            shown.exact, places.pointer(value.record, *value.steps), shown.text
        )

    script = _asset("page.js")
    environment = _environment()
    environment.filters["symbols"] = _symbols
    return environment.get_template("page.html.j2").render(
        results=results,
        sections=[section for section in sections if section.filled],
        files=files,
        title=results.provenance.scene["report"].get("title") or title_of(results),
        words=results.provenance.scene["report"],
        date=date,
        commit=commit_of_code(),
        n=written,
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


def _environment() -> SandboxedEnvironment:
    """Return percept's own templates."""

    def load(name: str) -> str | None:
        file = resources.files(_PACKAGE).joinpath("templates", name)
        return file.read_text(encoding="utf-8") if file.is_file() else None

    return SandboxedEnvironment(
        loader=FunctionLoader(load),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _policy(*scripts: str) -> str:
    """Return a content security policy: these scripts run, and nothing is fetched or sent.

    A script runs only if its text stands in the page byte for byte.
    """
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests] or ["'none'"]
    # Figures are full of style attributes, which have no hashes.
    return (
        f"default-src 'none'; script-src {' '.join(allowed)}; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _asset(name: str) -> Markup:
    """Return a style sheet or script, as it stands."""
    return Markup(resources.files(_PACKAGE).joinpath("templates", name).read_text(encoding="utf-8"))


def _symbols(text: str) -> Markup:
    """Set the subscripts of Z_h and its like, and escape the rest."""
    return Markup(re.sub(r"Z_(h,vc|h|e|c|d)\b", r"Z<sub>\1</sub>", str(escape(text))))


class Places:
    """Where the records of results stand in report.json, by JSON pointer.

    Records are told apart by identity: equal ones may stand at several places.
    """

    def __init__(self, results: Results, summary: Findings) -> None:
        # While these are kept, no other record can be given the identity of one of theirs.
        self._kept = results, summary
        self._pointers = dict(_pointers(results, ""))
        self._pointers |= _pointers(summary, "/summary")

    def pointer(self, record: object, *steps: str | int) -> str:
        """Return the JSON pointer of what stands some steps below a record."""
        return "".join([self._pointers[id(record)], *map(_step, steps)])


def _pointers(value: object, pointer: str) -> Iterator[tuple[int, str]]:
    """Give the pointers of a record or table and of all below it, by identity."""
    if isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _pointers(item, f"{pointer}{_step(index)}")
        return
    parts: Mapping[str, object]
    if dataclasses.is_dataclass(value):
        parts = vars(value)
    elif isinstance(value, Mapping):
        parts = value
    else:
        return
    yield id(value), pointer
    for name, part in parts.items():
        yield from _pointers(part, f"{pointer}{_step(name)}")


def _step(name: str | int) -> str:
    """Write a step of a JSON pointer."""
    return "/" + str(name).replace("~", "~0").replace("/", "~1")
