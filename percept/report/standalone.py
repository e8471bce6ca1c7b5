"""What every self-contained page of percept shares: templates, style sheet, figures and rounded numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from percept.report.numbers import rounded
from percept.report.page import Plate

__all__ = ["render_standalone", "sheet"]


def render_standalone(
    package: str,
    template: str,
    plates: Mapping[str, Plate],
    *,
    digits: int,
    symbols: Callable[[str], str] = str,
    styles: tuple[str, ...] = (),
    **values: Any,
) -> str:
    """Render a template of a package that may use those of the report.

    Parameters
    ----------
    package : str
        Package with a folder of templates.
    template : str
        The template's name. It is given `figure`, a figure by name; `n`, a number rounded for reading
        with its exact value beside it; `plates` and `style`.
    plates : mapping of str to Plate
        Figures by name.
    digits : int
        Significant digits of a number where the template names none.
    symbols : callable
        The template's filter of that name.
    styles : tuple of str
        Style sheets of the package, after the report's.
    **values
        What else the template is given.

    Returns
    -------
    str
        HTML.
    """

    def figure(name: str) -> Markup:
        return Markup(plates[name].svg)

    def shown(value: float | str | None, digits: int = digits) -> Markup:
        if value is None:
            return Markup('<span class="none">–</span>')
        return Markup('<data value="{}">{}</data>').format(value, rounded(float(value), digits))

    style = sheet("percept.report", "page.css") + Markup("").join(sheet(package, name) for name in styles)
    environment = _environment(package).overlay()
    environment.filters = {**environment.filters, "symbols": symbols}
    return environment.get_template(template).render(
        plates=plates, figure=figure, n=shown, style=style, **values
    )


@cache
def sheet(package: str, name: str) -> Markup:
    """Return a style sheet of a package's templates, as it stands."""
    return Markup(resources.files(package).joinpath("templates", name).read_text(encoding="utf-8"))


@cache
def _environment(package: str) -> Environment:
    return Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("percept.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
