"""The figure of the band law that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.band import Widths, draw_band
from percept.report.figures.canvas import Drawing, Figure, legend_below, panels
from percept.report.select import KINDS, METHOD_NAMES, METHODS, array, family_of, first, matching

FloatArray = NDArray[np.float64]
_LAW_NAMES = {"weber": "Weber", "offset": "Weber with offset", "power": "power law"}


def band_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return the figure of bands and laws, of the first kind there is, in the study's family."""
    band = document["band"]
    if not band or not band.get("rows"):
        return []
    kind = next(kind for kind in KINDS if matching(band["rows"], kind=kind))
    seen = array([row["impedance"] for row in band["rows"]])
    grid = np.geomspace(seen.min() / 1.5, seen.max() * 1.5, 80)
    found = (_widths(band, method, kind, family_of(document), grid) for method in METHODS)
    series = [widths for widths in found if widths is not None]
    with_laws = ", with the fitted laws" if any(one.laws for one in series) else ""
    return [
        Drawing(
            "band",
            f"Band against impedance, kind {kind}",
            "Width of the band of abs(Z_e) against the environment's own impedance at "
            f"{band['omega']:g} rad/s{with_laws}. The numbers are in the table.",
            (120.0, 100.0),
            partial(_draw, grid, series),
        )
    ]


def _widths(band: Mapping[str, Any], method: str, kind: str, family: str, grid: FloatArray) -> Widths | None:
    families = (family, "lognormal", "normal")
    chosen = first(matching(band["rows"], method=method, kind=kind), family=families)
    if chosen is None:
        return None
    rows = matching(band["rows"], method=method, kind=kind, family=chosen["family"])
    laws = matching(band["laws"], method=method, kind=kind, family=chosen["family"])
    return Widths(
        label=f"{METHOD_NAMES[method]} ({chosen['family']})",
        method=method,
        environments=tuple(row["environment"] for row in rows),
        impedance=array([row["impedance"] for row in rows]),
        band=array([row["band"] for row in rows]),
        laws={_LAW_NAMES.get(law["model"], str(law["model"])): _law(law, grid) for law in laws},
    )


def _law(law: Mapping[str, Any], impedance: FloatArray) -> FloatArray:
    """Return c + w·abs(Z)^p, with what the law leaves out at its neutral value."""
    values = {name: float(part["value"]) for name, part in law["parameters"].items()}
    return values.get("c", 0.0) + values.get("w", 1.0) * impedance ** values.get("p", 1.0)


def _draw(grid: FloatArray, series: list[Widths], figure: Figure) -> None:
    entries = sum(1 + len(one.laws) for one in series)
    (ax,) = panels(figure, left=16, top=3, bottom=13 + 4.2 * -(-entries // 2))
    draw_band(ax, grid, series)
    legend_below(ax)
