"""Boundaries over the angular frequency, and bands over the size of what was tested."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.boundary.band import law_band, size_name
from percept.report.basics import (
    METHOD_NAMES,
    METHODS,
    NOTHING,
    best,
    bracketed,
    distinct,
    families_from,
    family_of,
    grouped,
    matching,
    present,
    unwidened,
)
from percept.report.biases import drawn_said
from percept.report.figures.canvas import (
    COLOURS,
    REFERENCE,
    Drawing,
    draw_interval,
    draw_panels,
    legend,
    log_scale,
    method_legend,
    panels,
    panels_height,
)
from percept.report.overview import displayed
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
_VERDICT = 11  # letters in a line


def draw_magnitude(ax: Axes, boundaries: Sequence[Boundary], *, ratio: bool = False) -> None:
    """Draw boundaries, the reference and the coupled impedance, in the manner of Fig. 7.

    Parameters
    ----------
    ax : Axes
        To draw on; both axes become logarithmic.
    boundaries : sequence of Boundary
        Of one environment: classical limits are lines, Bayesian ones a filled band.
    ratio : bool
        Whether all is drawn over the reference.
    """
    shown = boundaries[0]
    unit = shown.reference if ratio else np.ones_like(shown.reference)
    for one in boundaries:
        colour = COLOURS[one.method]
        averaged = ", over devices" if one.device_share is not None else ""
        label = f"{METHOD_NAMES[one.method]}, {one.shape} ({one.family}){averaged}"
        lower, upper = one.lower / unit, one.upper / unit
        width = 1.2
        if one.method == "bayesian":
            width = 0.6
            ax.fill_between(
                one.omega, lower, upper, color=colour, alpha=0.25, linewidth=0, label=label
            )
            label = ""
        ax.plot(one.omega, lower, color=colour, linewidth=width, label=label)
        ax.plot(one.omega, upper, color=colour, linewidth=width)
    ax.plot(
        shown.omega,
        shown.reference / unit,
        **REFERENCE,
        label="reference",
    )
    if shown.coupled is not None:
        ax.plot(
            shown.omega,
            shown.coupled / unit,
            color=COLOURS["coupled"],
            linestyle=_COUPLED_DASHES,
            label="through the coupling",
        )
    ax.set_xlim(shown.omega[0], shown.omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("|Zₕ| / reference’s |Zₕ|" if ratio else "|Zₕ| (N·s/m)")
    log_scale(ax, "x", plain=True)
    log_scale(ax, "y", plain=ratio)


def curve_drawings(results: Results) -> list[Drawing]:
    """Return the figure of boundaries over the reference, with the verdicts."""
    curves = unwidened(results.boundaries)
    if not curves:
        return []
    kind = present(_WHOM, curves, "kind")[0]
    families = families_from(family_of(results))
    is_coupled = bool(matching(results.verdicts, coupled=True))
    cell_of = displayed(results, coupled=is_coupled)
    names = distinct(curves, "environment")
    columns = min(len(names), _COLUMNS)

    def draw_one(ax: Axes, index: int) -> None:
        of_environment = matching(curves, environment=names[index])
        draw_magnitude(ax, alike_boundaries(of_environment, kind, families), ratio=True)
        # A panel is some 20 mm wide.
        cell = cell_of(names[index])
        verdict = "" if cell == NOTHING else textwrap.fill(str(cell[0]), _VERDICT)
        ax.set_title(f"{ax.get_title()}\n{verdict}".strip(), fontsize="medium")

    return [
        Drawing(
            name="ratios",
            title=f"What {_WHOM[kind].format(results.data.words)} takes for the reference, over"
            " the reference’s |Z_h|",
            description=drawn_said(results),
            height=panels_height(len(names), columns),
            draw=lambda figure: draw_panels(figure, names, columns, draw_one),
        )
    ]


def alike_boundaries(
    boundaries: Sequence[Boundary], kind: str, families: Sequence[str]
) -> list[Boundary]:
    """Return the boundaries of both methods in one family and one shape, the Bayesian first."""
    shapes = _SHAPES
    if any(boundary.device_share is not None for boundary in boundaries):
        # An envelope leaves out what is not known of the device.
        shapes = _SHAPES[::-1]
    of_kind = matching(boundaries, kind=kind)
    shape = next(iter(present(shapes, of_kind, "shape")), "")
    by_method = grouped(matching(of_kind, shape=shape), "method")
    return [best(by_method[method], families) for method in METHODS[::-1] if method in by_method]


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
        Quantity of the bands; None for abs(Z_e).
    families : sequence of str
        In order of preference.
    quantities : mapping of str to Quantity
        By parameter.
    """
    size = size_name(parameter)
    of_parameter = matching(band.rows, parameter=parameter)
    for method in present(METHODS, of_parameter, "method"):
        rows = matching(of_parameter, method=method)
        family = best(rows, families).family
        chosen = [one for one in matching(rows, family=family) if np.isfinite(one.band)]
        sizes = [getattr(one, size) for one in chosen]
        laws = matching(band.laws, method=method, family=family, parameter=parameter)
        for one, place in zip(chosen, sizes, strict=True):
            ends = [one.band_lower or one.band, one.band_upper or one.band]
            draw_interval(
                ax, place * _APART[method], ends, one.band, method, width=1.2, upright=True
            )
    if laws:
        law = max(laws, key=lambda one: one.best)
        grid = np.geomspace(min(sizes) / _BEYOND, max(sizes) * _BEYOND, _LAW_POINTS)
        values = np.array([[estimate.value for estimate in law.parameters.values()]])
        line = law_band(law.model, values, grid)[0]
        ax.plot(grid, line, color=COLOURS[method], linewidth=0.9, label=_LAWS[law.model])
    for one in chosen:
        ax.annotate(
            one.environment,
            (getattr(one, size), one.band),
            xytext=(6, -7),
            textcoords="offset points",
            fontsize="small",
        )
    method_legend(ax, of_parameter)
    ax.margins(x=0.1)
    log_scale(ax, plain=True)
    what, unit = "|Zₑ|", "N·s/m"
    if parameter is not None:
        what = f"reference {quantities[parameter].words}"
        unit = quantities[parameter].unit
    ax.set_xlabel(what + bracketed(unit))
    ax.set_ylabel(f"width of the band{bracketed(unit)}")


def band_drawings(results: Results) -> list[Drawing]:
    """Return a figure of bands for the impedance, or for each parameter."""
    band = results.band
    if band is None:
        return []
    drawings = []
    for parameter, rows in grouped(band.rows, "parameter").items():
        # Levels of a factor may have one reference.
        if len(distinct(rows, size_name(parameter))) > 1:
            drawings.append(_band_drawing(results, band, parameter))
    return drawings


def _band_drawing(results: Results, band: Band, parameter: str | None) -> Drawing:
    """Return the figure of the bands of one parameter."""
    quantities = results.data.quantities
    user = results.data.words.user
    what = "|Z_e|" if parameter is None else quantities[parameter].words

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure)
        draw_band(ax, band, parameter, families_from(family_of(results)), quantities)
        legend([ax], ncols=3)

    return Drawing(
        name="band" if parameter is None else f"band_{parameter}",
        title=f"Band of {what}, next {user}",
        description=f"Width of the interval of the next {user} against the size, with its own"
        " limits. Line: the law that is ahead.",
        height=_HEIGHT,
        draw=draw,
    )
