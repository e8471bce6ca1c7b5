"""The report's page from its results: it needs nothing else."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import re
from collections.abc import Collection, Iterator, Mapping
from importlib import resources
from typing import TYPE_CHECKING

from jinja2 import FunctionLoader, StrictUndefined
from jinja2.sandbox import SandboxedEnvironment
from markupsafe import Markup, escape

from percept.errors import capitalised
from percept.provenance import commit_of_code
from percept.report.numbers import digits_of, number, percentage
from percept.report.sections import build_sections
from percept.report.select import gives_means, listed, makes_impedance, title_of, words_of
from percept.results import Findings, Results

if TYPE_CHECKING:
    from percept.report.figures.canvas import Drawing

__all__ = ["Places", "render_page"]

_PACKAGE = "percept.report"
#: What stands on a page where there is no number.
_NO_NUMBER = Markup('<span class="none">–</span>')


def render_page(
    results: Results,
    summary: Findings,
    plots: Mapping[str, Drawing],
    *,
    date: str,
    files: Collection[str] = (),
) -> str:
    """Render the page: numbers know their place in report.json, tables link to `files`."""
    places = Places(results, summary)

    def written(record: object, *steps: str | int, digits: int = 5, style: str = "plain") -> Markup:
        shown = number(places.value(record, *steps), digits=digits, style=style)
        if not shown.exact:
            return _NO_NUMBER
        return Markup('<data value="{}" data-at="{}">{}</data>').format(
            shown.exact, places.pointer(record, *steps), shown.text
        )

    script = _asset(_PACKAGE, "page.js")
    environment = _environment()
    environment.filters["symbols"] = _symbols
    environment.filters["listed"] = listed
    environment.filters["percentage"] = percentage
    return environment.get_template("page.html.j2").render(
        results=results,
        scene=results.provenance.scene,
        summary=summary,
        files=files,
        title=results.provenance.scene["report"].get("title") or title_of(results),
        impedance=makes_impedance(results),
        means=gives_means(results),
        noun=words_of(results),
        sections=build_sections(results, summary),
        date=date,
        commit=commit_of_code(),
        n=written,
        digits_of=digits_of,
        plots=plots,
        style=_asset(_PACKAGE, "page.css"),
        script=script,
        policy=_policy(script),
    )


def _environment() -> SandboxedEnvironment:
    """Return percept's own templates."""

    def load(name: str) -> str | None:
        file = resources.files(_PACKAGE).joinpath("templates", name)
        return file.read_text(encoding="utf-8") if file.is_file() else None

    environment = SandboxedEnvironment(
        loader=FunctionLoader(load),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["initial"] = capitalised
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "separators": (",", ":")}
    return environment


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


def _asset(package: str, name: str) -> Markup:
    """Return a style sheet or script of a package's templates, as it stands."""
    return Markup(resources.files(package).joinpath("templates", name).read_text(encoding="utf-8"))


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

    def value(self, record: object, *steps: str | int) -> object:
        """Return what stands some steps below a record; None where a table lacks it."""
        for step in steps:
            if isinstance(record, Mapping):
                record = record.get(step)
            elif isinstance(record, tuple) and isinstance(step, int):
                record = record[step]
            else:
                record = getattr(record, str(step))
        return record

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
