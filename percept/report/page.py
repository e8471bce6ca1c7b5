"""The page: parts and figures of a document in one HTML file that needs nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from jinja2 import Environment
from markupsafe import Markup, escape

from percept.report.numbers import number
from percept.report.rendering import NO_NUMBER, Plate, asset, figures, templates
from percept.report.sections import build_parts

_PACKAGE = "percept.report"


def render_page(document: Mapping[str, Any], plates: Mapping[str, Plate], *, date: str) -> str:
    """Render the page of a document."""

    def shown(place: str, *, digits: int = 5, style: str = "plain") -> Markup:
        found = number(document, place, digits=digits, style=style)
        if not found.exact:
            return NO_NUMBER
        return Markup('<data value="{}" data-at="{}">{}</data>').format(found.exact, found.place, found.text)

    template = _environment().get_template("page.html.j2")
    return template.render(
        document=document,
        parts=build_parts(document),
        date=date,
        n=shown,
        figure=figures(plates),
        plates=plates,
        style=asset(_PACKAGE, "page.css"),
        script=asset(_PACKAGE, "page.js"),
    )


@cache
def _environment() -> Environment:
    environment = templates(_PACKAGE).overlay()
    environment.filters = {**environment.filters, "embedded": _embedded, "symbols": _symbols}
    return environment


def _embedded(value: Any) -> Markup:
    """Write JSON that cannot end the script element it stands in."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028"))


def _symbols(text: str) -> Markup:
    """Set the indices of Z_h and its like as indices; the rest is escaped."""
    return Markup(re.sub(r"Z_(h,vc|h|e|c|d)\b", r"Z<sub>\1</sub>", str(escape(text))))
