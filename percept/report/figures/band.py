"""Bands against impedance or references, with the law that is ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.boundary.band import law_band, size_name
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    draw_interval,
    legend,
    log_scale,
    method_legend,
    panels,
)
from percept.report.select import METHODS, distinct, families_from, family_of, first, matching
from percept.results import Band, Results
from percept.sessions.quantities import Quantity

_LAWS = {"weber": "Weber’s law", "offset": "Weber’s law with an offset", "power": "a power law"}
#: Laws are drawn a little beyond the sizes they were fitted to, a factor.
_BEYOND = 1.5
_LAW_POINTS = 80
_HEIGHT = 70.0  # mm
#: A factor by which the methods' points stand apart.
_APART = {"classical": 0.96, "bayesian": 1.04}


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
    of_parameter = matching(band.rows, parameter=parameter)
    drawn = []
    for method in METHODS:
        row = first(matching(of_parameter, method=method), family=families)
        if row is None:
            continue
        drawn.append(method)
        own = matching(of_parameter, method=method, family=row.family)
        laws = matching(band.laws, method=method, family=row.family, parameter=parameter)
        for one in own:
            place = getattr(one, size) * _APART[method]
            ends = [one.band_lower or one.band, one.band_upper or one.band]
            draw_interval(ax, place, ends, one.band, method, width=1.2, upright=True)
    if laws:
        law = max(laws, key=lambda one: one.best)
        sizes = [getattr(one, size) for one in own]
        grid = np.geomspace(min(sizes) / _BEYOND, max(sizes) * _BEYOND, _LAW_POINTS)
        values = np.array([[estimate.value for estimate in law.parameters.values()]])
        line = law_band(law.model, values, grid)[0]
        ax.plot(grid, line, color=COLOURS[drawn[-1]], linewidth=0.9, label=_LAWS[law.model])
    for one in own:
        ax.annotate(
            one.environment, (getattr(one, size), one.band), xytext=(6, -7),
            textcoords="offset points", fontsize="small",
        )  # fmt: skip
    method_legend(ax, drawn)
    ax.margins(x=0.1)
    log_scale(ax, plain=True)
    unit = "N·s/m" if parameter is None else quantities[parameter].unit
    in_unit = f" ({unit})" if unit else ""
    what = "|Zₑ|" if parameter is None else f"reference {quantities[parameter].words}"
    ax.set_xlabel(f"{what}{in_unit}")
    ax.set_ylabel(f"width of the band{in_unit}")


def band_drawings(results: Results) -> list[Drawing]:
    """Return a figure of bands for the impedance, or for each parameter."""
    if results.band is None:
        return []
    user = results.data.words.user
    drawings = []
    for parameter in distinct(results.band.rows, "parameter"):
        what = "|Z_e|" if parameter is None else results.data.quantities[parameter].words
        drawings.append(
            Drawing(
                name="band" if parameter is None else f"band_{parameter}",
                title=f"Band of {what}, next {user}",
                description=f"Width of the interval of the next {user} against the size, with its"
                " own limits. Line: the law that is ahead.",
                height=_HEIGHT,
                draw=partial(_draw, results=results, parameter=parameter),
            )
        )
    return drawings


def _draw(figure: Figure, results: Results, parameter: str | None) -> None:
    (ax,) = panels(figure)
    assert results.band is not None
    families = families_from(family_of(results))
    draw_band(ax, results.band, parameter, families, results.data.quantities)
    legend([ax], ncols=3)
