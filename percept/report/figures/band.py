"""Bands against impedance or references, with the law that is ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.boundary.band import law_band, size_name
from percept.report.figures.canvas import COLOURS, MARKERS, WIDE, Drawing, legend, log_scale, panels
from percept.report.select import METHOD_NAMES, METHODS, distinct, families_of, first, matching
from percept.results import Band, Results
from percept.sessions.quantities import Quantity

__all__ = ["band_drawings", "draw_band"]

_LAWS = {"weber": "Weber’s law", "offset": "Weber’s law with an offset", "power": "a power law"}
#: Laws are drawn a little beyond the sizes they were fitted to, a factor.
_BEYOND = 1.5
_LAW_POINTS = 80
_SIZE = (WIDE / 2, 66.0)  # mm


def draw_band(
    ax: Axes,
    band: Band,
    parameter: str | None,
    families: Sequence[str],
    quantities: Mapping[str, Quantity],
) -> None:
    """Draw the next user's bands of both methods as points, and the law that is ahead.

    Parameters
    ----------
    ax : Axes
        To draw on; both axes become logarithmic.
    band : Band
        With rows of the parameter.
    parameter : str or None
        Whose bands; None for those of abs(Z_e).
    families : sequence of str
        In order of preference.
    quantities : mapping of str to Quantity
        By parameter.
    """
    size = size_name(parameter)
    rows = matching(band.rows, parameter=parameter)
    own = []
    for method in METHODS:
        row = first(matching(rows, method=method), family=families)
        if row is None:
            continue
        own = matching(rows, method=method, family=row.family)
        x = np.array([getattr(one, size) for one in own])
        y = np.array([one.band for one in own])
        label = f"{METHOD_NAMES[method]} ({row.family})"
        ax.plot(x, y, MARKERS[method], markersize=4, color=COLOURS[method], label=label)
        laws = matching(band.laws, method=method, family=row.family, parameter=parameter)
        if laws and (method == "bayesian" or len(distinct(rows, "method")) == 1):
            law = max(laws, key=lambda one: one.best)
            grid = np.geomspace(x.min() / _BEYOND, x.max() * _BEYOND, _LAW_POINTS)
            values = np.array([[estimate.value for estimate in law.parameters.values()]])
            line = law_band(law.model, values, grid)[0]
            ax.plot(grid, line, color=COLOURS[method], linewidth=0.9, label=_LAWS[law.model])
    for one in own:
        ax.annotate(
            one.environment,
            (getattr(one, size), one.band),
            xytext=(4, -8),
            textcoords="offset points",
            fontsize="small",
        )
    log_scale(ax, plain=True)
    unit = "N·s/m" if parameter is None else quantities[parameter].unit
    in_unit = f" ({unit})" if unit else ""
    what = "|Zₑ|" if parameter is None else f"reference {quantities[parameter].words}"
    ax.set_xlabel(f"{what}{in_unit}")
    ax.set_ylabel(f"width of the band{in_unit}")


def band_drawings(results: Results) -> list[Drawing]:
    """Return a figure of bands for the impedance, or for each parameter."""
    band = results.band
    if band is None:
        return []
    drawings = []
    for parameter in distinct(band.rows, "parameter"):
        what = "|Z_e|" if parameter is None else results.data.quantities[parameter].words

        def draw(figure: Figure, parameter: str | None = parameter) -> None:
            (ax,) = panels(figure)
            draw_band(ax, band, parameter, families_of(results), results.data.quantities)
            legend([ax], ncols=2)

        drawings.append(
            Drawing(
                name="band" if parameter is None else f"band_{parameter}",
                title=f"Band of {what}, next {results.data.words.user[0]}",
                description="Width of the interval of the next"
                f" {results.data.words.user[0]} against the size. Line: the law that is ahead.",
                size=_SIZE,
                draw=draw,
            )
        )
    return drawings
