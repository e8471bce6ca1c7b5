"""The reproduction as one HTML file that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from percept.report.rendering import Plate
from percept.report.standalone import render_standalone
from percept.reproduce.claims import Claim

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
    """Render the page."""
    return render_standalone(
        "percept.reproduce",
        "reproduction.html.j2",
        plates,
        digits=5,
        symbols=_symbols,
        styles=("reproduction.css",),
        document=document,
        claims=claims,
        by_name={claim.name: claim for claim in claims},
        sections=_SECTIONS,
        date=date,
    )


def _symbols(text: str) -> Markup:
    """Set indices as indices: Z_h, Z_h_vc, b_d and their like; the rest is escaped."""
    found = re.sub(r"\b([Zkbm])_(h_vc|eff|[hecd])(?![a-z])", _index, str(escape(text)))
    return Markup(found.replace("k_cT", "k<sub>c</sub>T"))


def _index(match: re.Match[str]) -> str:
    return f"{match[1]}<sub>{match[2].replace('_', ',')}</sub>"
