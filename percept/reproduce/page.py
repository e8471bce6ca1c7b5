"""The reproduction as one HTML file that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from percept.report.numbers import rounded
from percept.report.page import Plate
from percept.reproduce.claims import Claim

__all__ = ["render"]

_SECTIONS = (
    ("verdicts", "Verdicts"),
    ("table", "Table 1"),
    ("claims", "Claim by claim"),
    ("figures", "The figures"),
    ("devices", "The device behind them"),
    ("future", "A coupling that follows the environment"),
    ("unjudged", "What cannot be judged"),
    ("provenance", "Provenance"),
)


def render(
    document: Mapping[str, Any], claims: Sequence[Claim], plates: Mapping[str, Plate], *, date: str
) -> str:
    """Render the page.

    Parameters
    ----------
    document : mapping
        As `percept.reproduce.document.build_document` returns it.
    claims : sequence of Claim
        Those of the document.
    plates : mapping of str to Plate
        The figures, by name.
    date : str
        Printed at the head.

    Returns
    -------
    str
        HTML.
    """

    def figure(name: str) -> Markup:
        return Markup(plates[name].svg)

    def shown(value: float | str | None, digits: int = 5) -> Markup:
        if value is None:
            return Markup('<span class="none">–</span>')
        return Markup('<data value="{}">{}</data>').format(value, rounded(float(value), digits))

    return (
        _environment()
        .get_template("reproduction.html.j2")
        .render(
            document=document,
            claims=claims,
            by_name={claim.name: claim for claim in claims},
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
        loader=ChoiceLoader([PackageLoader("percept.reproduce"), PackageLoader("percept.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = _symbols
    return environment


@cache
def _style() -> Markup:
    shared = resources.files("percept.report").joinpath("templates", "page.css")
    own = resources.files("percept.reproduce").joinpath("templates", "reproduction.css")
    return Markup(shared.read_text(encoding="utf-8") + own.read_text(encoding="utf-8"))


def _symbols(text: str) -> Markup:
    """Set indices as indices: Z_h, Z_h_vc, b_d and their like; the rest is escaped."""
    found = re.sub(r"\b([Zkbm])_(h_vc|eff|[hecd])(?![a-z])", _index, str(escape(text)))
    return Markup(found.replace("k_cT", "k<sub>c</sub>T"))


def _index(match: re.Match[str]) -> str:
    return f"{match[1]}<sub>{match[2].replace('_', ',')}</sub>"
