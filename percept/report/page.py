"""Pages that need nothing else: the report's from its document, and others in its style."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

from jinja2 import FunctionLoader, StrictUndefined
from jinja2.sandbox import SandboxedEnvironment
from markupsafe import Markup, escape

from percept.provenance import commit_of_code
from percept.report.numbers import number, rounded
from percept.report.sections import build_sections
from percept.report.select import title_of

if TYPE_CHECKING:
    from percept.report.figures.canvas import Drawing

__all__ = ["render_page", "render_standalone"]

_PACKAGE = "percept.report"
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

    words = document["data"]["words"]
    script = _asset(_PACKAGE, "page.js")
    environment = _environment(_PACKAGE)
    environment.filters["symbols"] = _symbols
    return environment.get_template("page.html.j2").render(
        document=document,
        files=files,
        title=document["provenance"]["scene"]["report"].get("title") or title_of(document),
        noun=_nouns(words),
        sections=build_sections(document),
        date=date,
        commit=commit_of_code(),
        n=written,
        plots=plots,
        style=_asset(_PACKAGE, "page.css"),
        script=script,
        policy=_policy(script),
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
    return environment.get_template(template).render(
        plots=plots, n=written, style=style, policy=_policy(), **values
    )


def _environment(*packages: str) -> SandboxedEnvironment:
    """Return the templates of packages, looked for in this order; their source is percept's alone."""

    def load(name: str) -> str | None:
        files = (resources.files(package).joinpath("templates", name) for package in packages)
        return next((file.read_text(encoding="utf-8") for file in files if file.is_file()), None)

    environment = SandboxedEnvironment(
        loader=FunctionLoader(load),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["initial"] = _initial
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


def _nouns(words: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return what the study calls environments and subjects: one, several, and one with its article."""
    nouns: dict[str, str] = {}
    for usual, (singular, plural) in words.items():
        article = "an" if singular[:1].lower() in set("aeiou") else "a"
        nouns |= {usual: singular, f"{usual}s": plural, f"a_{usual}": f"{article} {singular}"}
    return nouns


def _initial(text: str) -> str:
    """Capitalise the first letter, and leave the others as they are."""
    return text[:1].upper() + text[1:]


def _asset(package: str, name: str) -> Markup:
    """Return a style sheet or script of a package's templates, as it stands."""
    return Markup(resources.files(package).joinpath("templates", name).read_text(encoding="utf-8"))


def _symbols(text: str) -> Markup:
    """Set the subscripts of Z_h and its like, and escape the rest."""
    return Markup(re.sub(r"Z_(h,vc|h|e|c|d)\b", r"Z<sub>\1</sub>", str(escape(text))))
