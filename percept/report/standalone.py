"""Pages of their own beside the report's, in its style: rounded numbers with their exact values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from markupsafe import Markup

from percept.report.numbers import rounded
from percept.report.rendering import NO_NUMBER, Plate, asset, figures, templates

_REPORT = "percept.report"


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
    """Render a template of a package that may use those of the report."""

    def shown(value: float | str | None, digits: int = digits) -> Markup:
        if value is None:
            return NO_NUMBER
        return Markup('<data value="{}">{}</data>').format(value, rounded(float(value), digits))

    style = asset(_REPORT, "page.css") + Markup("").join(asset(package, name) for name in styles)
    environment = templates(package, _REPORT).overlay()
    environment.filters = {**environment.filters, "symbols": symbols}
    return environment.get_template(template).render(
        plates=plates, figure=figures(plates), n=shown, style=style, **values
    )
