"""Pages that need nothing else: the report's from its document, and others in its style."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

from percept.provenance import commit_of_code
from percept.report.numbers import number, rounded
from percept.report.sections import build_sections
from percept.report.select import title_of, worded

if TYPE_CHECKING:
    from percept.report.figures.canvas import Drawing

_PACKAGE = "percept.report"
#: Tags and expressions of a template, which the study's words leave alone.
_MARKUP = re.compile(r"(\{\{.*?\}\}|\{%.*?%\}|<[^>]*>)", re.DOTALL)
#: What stands on a page where there is no number.
_NO_NUMBER = Markup('<span class="none">–</span>')


def render_page(
    document: Mapping[str, Any],
    plots: Mapping[str, Drawing],
    *,
    date: str,
    files: Collection[str] = (),
) -> str:
    """Render the page of a document: numbers know their pointers, tables link to their own of the `files`."""

    def written(pointer: str, *, digits: int = 5, style: str = "plain") -> Markup:
        shown = number(document, pointer, digits=digits, style=style)
        if not shown.exact:
            return _NO_NUMBER
        return Markup('<data value="{}" data-at="{}">{}</data>').format(
            shown.exact, pointer, shown.text
        )

    nouns = document["data"]["words"]
    environment = _environment(_PACKAGE, nouns=nouns)
    environment.filters["symbols"] = lambda text: _symbols(worded(text, nouns))
    return environment.get_template("page.html.j2").render(
        document=document,
        files=files,
        title=document["provenance"]["scene"]["report"].get("title") or title_of(document),
        nouns=nouns,
        sections=build_sections(document),
        date=date,
        commit=commit_of_code(),
        n=written,
        plots=plots,
        style=_asset(_PACKAGE, "page.css"),
        script=_asset(_PACKAGE, "page.js"),
    )


def render_standalone(
    package: str,
    template: str,
    plots: Mapping[str, Drawing],
    *,
    digits: int,
    symbols: Callable[[str], str] = str,
    styles: Iterable[str] = (),
    **values: Any,
) -> str:
    """Render a template of a package that may use the report's: rounded numbers, exact in `value`."""

    def written(value: float | str | None, digits: int = digits) -> Markup:
        if value is None:
            return _NO_NUMBER
        return Markup('<data value="{}">{}</data>').format(value, rounded(float(value), digits))

    environment = _environment(package, _PACKAGE)
    environment.filters["symbols"] = symbols
    style = _asset(_PACKAGE, "page.css") + Markup("").join(_asset(package, name) for name in styles)
    return environment.get_template(template).render(plots=plots, n=written, style=style, **values)


def _environment(*packages: str, nouns: Mapping[str, Sequence[str]] | None = None) -> Environment:
    """Return the templates of packages, looked for in this order, with their own text in a study's words."""

    def load(name: str) -> str | None:
        files = (resources.files(package).joinpath("templates", name) for package in packages)
        source = next((file.read_text(encoding="utf-8") for file in files if file.is_file()), None)
        if source is None or nouns is None:
            return source
        parts = _MARKUP.split(source)
        parts[::2] = [worded(text, nouns) for text in parts[::2]]
        return "".join(parts)

    environment = Environment(
        loader=FunctionLoader(load),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "separators": (",", ":")}
    return environment


def _asset(package: str, name: str) -> Markup:
    """Return a style sheet or script of a package's templates, as it stands."""
    return Markup(resources.files(package).joinpath("templates", name).read_text(encoding="utf-8"))


def _symbols(text: str) -> Markup:
    """Set the indices of Z_h and its like as indices; the rest is escaped."""
    return Markup(re.sub(r"Z_(h,vc|h|e|c|d)\b", r"Z<sub>\1</sub>", str(escape(text))))
