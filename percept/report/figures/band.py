"""Bands against impedance or references, with their laws: on axes, and as figures of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.boundary.band import law_band
from percept.report.figures.canvas import (
    COLOURS,
    GROUND,
    MARKERS,
    Drawing,
    Frame,
    legend,
    log_scale,
    panels,
    row_labels,
)
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    distinct,
    families_of,
    first,
    matching,
    words_of,
)
from percept.results import Band, BandLaw, BandRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["BandSeries", "Widths", "band_drawings", "band_series", "draw_band"]

FloatArray = NDArray[np.float64]
T = TypeVar("T", BandRow, BandLaw)

_LAWS = {"weber": "Weber", "offset": "Weber with offset", "power": "power law"}
_LAW_DASHES = ("solid", (0, (6, 2)), (0, (2, 1.5)))
_NAME_WIDTH = 26.0  # mm
_POINTS = 72.0  # per inch
_NAME_SIZE = 6.5  # points
_NAME_HEIGHT = 8.0  # points, with room
_LETTER = 4.2  # points, the width of a letter on the wide side
#: Places of a name beside its point, in points. Bands grow with the size: below on the right and
#: above on the left is room.
_NAME_PLACES = ((4, -8), (-4, 4), (4, -17), (-4, 13), (4, 4), (-4, -8))
#: Laws are drawn a little beyond the sizes they were fitted to, a factor.
_BEYOND = 1.5
_LAW_POINTS = 80
_SIZE = (150.0, 58.0)  # mm


@dataclass(frozen=True, eq=False)
class Widths:
    """Bands of one method."""

    label: str  # For the legend
    method: str
    environments: tuple[str, ...]
    size: FloatArray  # (n,) Impedance, or reference of a quantity
    band: FloatArray  # (n,) In the same unit
    laws: Mapping[str, FloatArray]  # (m,) Fitted band by the law's name, at the sizes drawn


@dataclass(frozen=True, eq=False)
class BandSeries:
    """What a figure of bands is drawn from."""

    sizes: FloatArray  # (m,) Where laws are drawn
    widths: tuple[Widths, ...]  # By method
    axis: str  # What the bands are against, in words
    unit: str  # Of sizes and bands


def draw_band(ax: Axes, series: BandSeries) -> None:
    """Draw bands against sizes on logarithmic axes, with the fitted laws."""
    for widths in series.widths:
        colour = COLOURS[widths.method]
        ax.plot(
            widths.size, widths.band, MARKERS[widths.method], markersize=4, color=colour,
            label=widths.label,
        )  # fmt: skip
        for (name, curve), dashes in zip(widths.laws.items(), _LAW_DASHES, strict=False):
            label = f"{METHOD_NAMES[widths.method]}: {name}"
            ax.plot(series.sizes, curve, color=colour, linewidth=0.9, linestyle=dashes, label=label)
    log_scale(ax)
    _name_points(ax, series.widths[0])
    unit = f" ({series.unit})" if series.unit else ""
    ax.set_xlabel(f"{series.axis}{unit}")
    ax.set_ylabel(f"band{unit}")


def _name_points(ax: Axes, widths: Widths) -> None:
    """Write the environments' names beside their points, clear of the names before them."""
    names = row_labels(widths.environments, most=_NAME_WIDTH)
    figure = ax.get_figure(root=True)
    assert figure is not None
    ax.autoscale_view()
    places = ax.transData.transform(np.column_stack([widths.size, widths.band]))
    points = places * _POINTS / figure.dpi
    taken: list[tuple[float, float, float]] = []  # Left, right and lower edge of names
    for name, (x, y), size, band in zip(names, points, widths.size, widths.band, strict=True):
        length = _LETTER * len(name)
        for right, up in _NAME_PLACES:
            left = x + right if right > 0 else x + right - length
            free = all(
                left > end or left + length < start or abs(y + up - lower) > _NAME_HEIGHT
                for start, end, lower in taken
            )
            if free:
                break
        taken.append((left, left + length, y + up))
        side: Literal["left", "right"] = "left" if right > 0 else "right"
        ax.annotate(
            name, (size, band), xytext=(right, up), textcoords="offset points", ha=side,
            fontsize=_NAME_SIZE, bbox=GROUND,
        )  # fmt: skip


def band_drawings(results: Results) -> list[Drawing]:
    """Return a figure of bands and laws for the impedance, or for each parameter."""
    if results.band is None:
        return []
    parameters = distinct(results.band.rows, "parameter")
    return [_band_drawing(results, results.band, parameter) for parameter in parameters]


def _band_drawing(results: Results, band: Band, parameter: str | None) -> Drawing:
    """Return the figure of bands and laws."""
    quantities = results.data.quantities
    series = band_series(band, parameter, families_of(results), quantities)
    if parameter is None:
        name = "band"
        title = "Band against impedance"
        environment = words_of(results).environment
        omega = band.omega or 0.0
        said = f"|Z_e| against the {environment}’s own impedance at {omega:g} rad/s"
    else:
        quantity = quantities[parameter]
        name = f"band_{parameter}"
        title = f"Band of {quantity.words} against its reference"
        said = f"{quantity.label} against its reference"
    if any(widths.laws for widths in series.widths):
        said += ", with the fitted laws"

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=16, top=3, right=48))
        draw_band(ax, series)
        legend(ax, loc="center right", ncols=1)

    return Drawing(
        name=name,
        title=f"{title}, next {results.data.words.user[0]}",
        description=f"Width of the band of {said}.",
        size=_SIZE,
        draw=draw,
    )


def band_series(
    band: Band,
    parameter: str | None,
    families: Sequence[str],
    quantities: Mapping[str, Quantity],
) -> BandSeries:
    """Return bands of the next user, in the first family of each method."""
    rows = matching(band.rows, parameter=parameter)
    sizes = np.array([_size(row) for row in rows])
    grid = np.geomspace(sizes.min() / _BEYOND, sizes.max() * _BEYOND, _LAW_POINTS)
    widths: list[Widths] = []
    for method in METHODS:
        row = first(matching(rows, method=method), family=families)
        if row is not None:
            widths.append(_widths(band, row, grid))
    if parameter is None:
        axis = "environment impedance |Zₑ|"
        unit = "N·s/m"
    else:
        axis = f"reference {quantities[parameter].words}"
        unit = quantities[parameter].unit
    return BandSeries(grid, tuple(widths), axis, unit)


def _size(row: BandRow) -> float:
    """Return the environment's own size: an impedance, or a reference."""
    size = row.impedance if row.parameter is None else row.reference
    assert size is not None
    return size


def _widths(band: Band, like: BandRow, grid: FloatArray) -> Widths:
    """Return the bands and laws of the same method, family and parameter as a row."""
    rows = _with_keys_of(band.rows, like)
    laws: dict[str, FloatArray] = {}
    for law in _with_keys_of(band.laws, like):
        values = np.array([[estimate.value for estimate in law.parameters.values()]])
        laws[_LAWS[law.model]] = law_band(law.model, values, grid)[0]
    return Widths(
        label=f"{METHOD_NAMES[like.method]} ({like.family})",
        method=like.method,
        environments=tuple(row.environment for row in rows),
        size=np.array([_size(row) for row in rows]),
        band=np.array([row.band for row in rows]),
        laws=laws,
    )


def _with_keys_of(records: Sequence[T], like: BandRow) -> list[T]:
    return matching(records, method=like.method, family=like.family, parameter=like.parameter)
