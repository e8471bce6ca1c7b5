"""The benchmark as one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from percept.report.numbers import rounded
from percept.report.page import Plate

__all__ = ["render"]

_SECTIONS = (
    ("result", "Result"),
    ("error", "Run time against error"),
    ("ratios", "Time to a given error"),
    ("measured", "Everything measured"),
    ("whole", "Whole commands"),
    ("reference", "What errors are measured against"),
    ("machine", "Machine and versions"),
)


def render(document: Mapping[str, Any], plates: Mapping[str, Plate], *, date: str) -> str:
    """Render the page.

    Parameters
    ----------
    document : mapping
        As `percept.bench.peers.document.build_document` returns it.
    plates : mapping of str to Plate
        Its figures, by name.
    date : str
        Printed at the head.

    Returns
    -------
    str
        HTML.
    """

    def figure(name: str) -> Markup:
        return Markup(plates[name].svg)

    def shown(value: float | str | None, digits: int = 3) -> Markup:
        if value is None:
            return Markup('<span class="none">–</span>')
        return Markup('<data value="{}">{}</data>').format(value, rounded(float(value), digits))

    names = {one["name"]: one for one in document["engines"]}
    return (
        _environment()
        .get_template("benchmark.html.j2")
        .render(
            document=document,
            names=names,
            levels=list(dict.fromkeys(row["level"] for row in document["reached"])),
            series=list(dict.fromkeys((row["engine"], row["how"]) for row in document["reached"])),
            at={(row["engine"], row["how"], row["level"]): row for row in document["reached"]},
            sections=_SECTIONS,
            plates=plates,
            figure=figure,
            n=shown,
            date=date,
            style=_style(),
        )
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("percept.bench.peers"), PackageLoader("percept.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = str
    return environment


@cache
def _style() -> Markup:
    shared = resources.files("percept.report").joinpath("templates", "page.css")
    return Markup(shared.read_text(encoding="utf-8"))
