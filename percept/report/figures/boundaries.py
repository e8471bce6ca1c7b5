"""Boundaries over the angular frequency, and bands over the size of what was tested."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.boundary.band import law_band, size_name
from percept.report.basics import (
    METHOD_NAMES,
    METHODS,
    distinct,
    families_from,
    family_of,
    first,
    is_rendered,
    matching,
    present,
    unwidened,
)
from percept.report.biases import drawn_said, foremost
from percept.report.decisions import FEELINGS
from percept.report.figures.canvas import (
    COLOURS,
    REFERENCE_DASHES,
    Drawing,
    draw_interval,
    legend,
    log_scale,
    method_legend,
    panels,
    shortened,
)
from percept.results import Band, Boundary, Results
from percept.sessions.quantities import Quantity

_COUPLED_DASHES = (0, (2.5, 1.5))
#: The next user's boundary is what the paper's rule asks about.
_WHOM = {
    "user": "the next {0.user}",
    "mean": "the average {0.user}",
    "share": "a share of all {0.users}",
}
#: Shapes that both methods have, the exact one first.
_SHAPES = ("envelope", "pointwise")
_COLUMNS = 3  # panels side by side
_PANEL_HEIGHT = 38.0  # mm, with its labels
_LEGEND_HEIGHT = 12.0  # mm
_TITLE = 18  # letters
_VERDICT = 11  # letters in a line


def draw_magnitude(ax: Axes, boundaries: Sequence[Boundary], *, log: bool = True) -> None:
    """Draw boundaries, the reference and the coupled impedance, in the manner of Fig. 7.

    Parameters
    ----------
    ax : Axes
        To draw on.
    boundaries : sequence of Boundary
        Of one environment: classical limits are lines, Bayesian ones a filled band.
    log : bool
        Whether both axes are logarithmic.
    """
    for one in boundaries:
        colour = COLOURS[one.method]
        averaged = ", over devices" if one.device_share is not None else ""
        label = f"{METHOD_NAMES[one.method]}, {one.shape} ({one.family}){averaged}"
        width = 1.2
        if one.method == "bayesian":
            width = 0.6
            ax.fill_between(
                one.omega, one.lower, one.upper, color=colour, alpha=0.25, linewidth=0, label=label
            )
            label = ""
        ax.plot(one.omega, one.lower, color=colour, linewidth=width, label=label)
        ax.plot(one.omega, one.upper, color=colour, linewidth=width)
    shown = boundaries[0]
    dashes = REFERENCE_DASHES
    ax.plot(shown.omega, shown.reference, color=COLOURS["ink"], linestyle=dashes, label="reference")
    if shown.coupled is not None:
        label = "through the coupling"
        colour = COLOURS["coupled"]
        ax.plot(shown.omega, shown.coupled, color=colour, linestyle=_COUPLED_DASHES, label=label)
    ax.set_xlim(shown.omega[0], shown.omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("|Zₕ| (N·s/m)")
    if log:
        log_scale(ax, "x", plain=True)
        log_scale(ax, "y")
    else:
        ax.locator_params(nbins=3)


def _draw_ratios(ax: Axes, boundaries: Sequence[Boundary]) -> None:
    """Draw boundaries and the coupled impedance over the reference, on an axis that holds them."""
    ratios = []
    for one in boundaries:
        ratios.append(
            replace(
                one,
                lower=one.lower / one.reference,
                upper=one.upper / one.reference,
                reference=np.ones_like(one.reference),
                coupled=None if one.coupled is None else one.coupled / one.reference,
            )
        )
    draw_magnitude(ax, ratios)
    log_scale(ax, "y", plain=True)
    ax.set_ylabel("|Zₕ| / reference’s |Zₕ|")


def curve_drawings(results: Results) -> list[Drawing]:
    """Return boundaries over the reference with the verdicts, and the scene's close views."""
    shown = foremost(results)
    main = [record for record in unwidened(results.boundaries) if record.environment in shown]
    if not main:
        return []
    kind = present(_WHOM, main, "kind")[0]
    whom = _WHOM[kind].format(results.data.words)
    drawings = [
        Drawing(
            name="ratios",
            title=f"What {whom} takes for the reference, over the reference’s |Z_h|",
            description=drawn_said(results),
            height=_height(distinct(main, "environment")),
            draw=partial(_draw_boundaries, results=results, boundaries=main, kind=kind),
        )
    ]
    close = matching(results.close, kind=kind)
    if close:
        drawings.append(
            Drawing(
                name="boundaries_close",
                title=f"Boundaries of |Z_h| for {whom}, close views",
                description="",
                height=_height(distinct(close, "environment")),
                draw=partial(_draw_boundaries, results=results, boundaries=close, kind=kind),
            )
        )
    return drawings


def _height(names: Sequence[str]) -> float:
    rows = -(-len(names) // _COLUMNS)
    return _LEGEND_HEIGHT + _PANEL_HEIGHT * rows


def _draw_boundaries(
    figure: Figure, results: Results, boundaries: Sequence[Boundary], kind: str
) -> None:
    """Draw a panel per environment, each on axes of its own; close views as they are."""
    names = distinct(boundaries, "environment")
    axes = panels(figure, len(names), columns=min(len(names), _COLUMNS))
    titles = shortened(names, _TITLE)
    families = families_from(family_of(results))
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        alike = alike_boundaries(matching(boundaries, environment=name), kind, families)
        if boundaries[0] in results.close:
            draw_magnitude(ax, alike, log=False)
            ax.set_title(titles[index])
        else:
            _draw_ratios(ax, alike)
            # A panel is some 20 mm wide.
            verdict = textwrap.fill(_verdict(results, name), _VERDICT)
            ax.set_title(f"{titles[index]}\n{verdict}".strip(), fontsize="medium")
        if index % _COLUMNS:
            ax.set_ylabel("")
        if index < len(names) - _COLUMNS:
            ax.set_xlabel("")
    legend(axes, ncols=2)


def _verdict(results: Results, name: str) -> str:
    """Return the verdict on the display, through the coupling where there is one."""
    coupled = bool(matching(results.verdicts, coupled=True))
    verdict = first(matching(results.verdicts, environment=name, coupled=coupled))
    if not is_rendered(results, name, coupled=coupled):
        return "cannot be rendered"
    return FEELINGS[verdict.outcome] if verdict else ""


def alike_boundaries(
    boundaries: Sequence[Boundary], kind: str, families: Sequence[str]
) -> list[Boundary]:
    """Return the boundaries of both methods in one family and one shape, the Bayesian first."""
    shapes = list(_SHAPES)
    if any(boundary.device_share is not None for boundary in boundaries):
        # An envelope leaves out what is not known of the device.
        shapes.reverse()
    for shape in shapes:
        candidates = matching(boundaries, kind=kind, shape=shape)
        found = []
        for method in reversed(METHODS):
            boundary = first(matching(candidates, method=method), family=families)
            if boundary is not None:
                found.append(boundary)
        if found:
            return found
    return []


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
        of_parameter = matching(results.band.rows, parameter=parameter)
        if len(distinct(of_parameter, size_name(parameter))) < 2:
            continue  # Levels of a factor at one reference
        what = "|Z_e|" if parameter is None else results.data.quantities[parameter].words
        drawings.append(
            Drawing(
                name="band" if parameter is None else f"band_{parameter}",
                title=f"Band of {what}, next {user}",
                description=f"Width of the interval of the next {user} against the size, with its"
                " own limits. Line: the law that is ahead.",
                height=_HEIGHT,
                draw=partial(_draw_bands, results=results, parameter=parameter),
            )
        )
    return drawings


def _draw_bands(figure: Figure, results: Results, parameter: str | None) -> None:
    (ax,) = panels(figure)
    assert results.band is not None
    families = families_from(family_of(results))
    draw_band(ax, results.band, parameter, families, results.data.quantities)
    legend([ax], ncols=3)
