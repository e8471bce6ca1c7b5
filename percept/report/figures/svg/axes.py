"""Axes and figures that are drawn on like matplotlib's and cost a hundredth to write as SVG.

Only what the figures of a report need is here, under matplotlib's own names, so that one drawing serves both:
this package writes SVG at once, matplotlib is imported for PDF and PNG alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from percept.report.figures.svg.marks import Bars, Line, Mark, Note, Rule, Shade, dashes_of, extent, values

__all__ = ["Axis", "Legend", "SvgAxes", "SvgFigure"]

_COLOUR = "#1c2127"
_MARGIN = 0.05


@dataclass
class Axis:
    """One side of some axes.

    Attributes
    ----------
    log : bool
        Logarithmic.
    lower, upper : float or None
        Limits; None: what is drawn, and a margin.
    margin : float
        Share of the range left free on both sides.
    label : str
        Beside the axis.
    ticks : tuple or None
        Places and labels; None: chosen.
    minor, grid : bool
        Whether ticks stand between the powers of ten, and lines at the ticks.
    length : float
        Of the ticks, pt.
    most : int or None
        Largest number of steps between ticks.
    formatter : callable or None
        ``(place, index)`` to a tick's label.
    """

    log: bool = False
    lower: float | None = None
    upper: float | None = None
    margin: float = _MARGIN
    label: str = ""
    ticks: tuple[list[float], list[str]] | None = None
    minor: bool = True
    grid: bool = True
    length: float = 3.5
    most: int | None = None
    formatter: Callable[[float, int | None], str] | None = None

    def minorticks_off(self) -> None:
        """Leave the ticks between the powers of ten out."""
        self.minor = False

    def set_major_formatter(self, formatter: Callable[[float, int | None], str]) -> None:
        """Say what stands beside a tick."""
        self.formatter = formatter

    def limits(self, drawn: Sequence[np.ndarray]) -> tuple[float, float]:
        """Return the limits: those set, and for the rest what is drawn with the margin around it."""
        seen = np.concatenate(drawn)
        seen = seen[np.isfinite(seen) & ((seen > 0) | (not self.log))]
        low, high = (
            (float(seen.min()), float(seen.max())) if seen.size else ((1.0, 10.0) if self.log else (0.0, 1.0))
        )
        if self.log:
            room = (high / low) ** self.margin if high > low else 2.0
            low, high = low / room, high * room
        else:
            room = self.margin * (high - low) or 0.05 * abs(high) or 0.05
            low, high = low - room, high + room
        return (low if self.lower is None else self.lower, high if self.upper is None else self.upper)


@dataclass(frozen=True)
class Legend:
    """Entries below a figure, or in a corner of some axes."""

    marks: list[Line | Shade | Bars | Rule]
    labels: list[str]
    columns: int = 1


class SvgAxes:
    """Axes that take marks in matplotlib's manner.

    Parameters
    ----------
    figure : SvgFigure
        What they belong to.
    bounds : tuple of float
        Left, bottom, width and height as shares of the figure.
    """

    def __init__(self, figure: SvgFigure, bounds: tuple[float, float, float, float]) -> None:
        self.figure, self.bounds = figure, bounds
        self.xaxis, self.yaxis = Axis(), Axis()
        self.marks: list[Mark] = []
        self.title: tuple[str, float | None] = ("", None)
        self.inner_legend: Legend | None = None

    def plot(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        color: str = _COLOUR,
        label: str | None = None,
        linewidth: float = 1.2,
        linestyle: Any = "-",
        marker: str = "",
        markersize: float = 6.0,
        markerfacecolor: str | None = None,
        markeredgecolor: str | None = None,
    ) -> list[Line]:
        """Add a curve, or marks where the style of line is "none"; returns it in a list."""
        line = Line(
            values(x),
            values(y),
            color=color,
            label=label,
            linewidth=0.0 if linestyle == "none" else linewidth,
            dashes=dashes_of(linestyle),
            marker=marker,
            markersize=markersize,
            face=markerfacecolor or color,
            edge=markeredgecolor or color,
        )
        self.marks.append(line)
        return [line]

    def fill_between(
        self,
        x: ArrayLike,
        low: ArrayLike,
        high: ArrayLike,
        *,
        color: str = _COLOUR,
        alpha: float = 1.0,
        linewidth: float = 0.0,
        label: str | None = None,
    ) -> None:
        """Shade between two curves; the area has no outline."""
        del linewidth
        self.marks.append(Shade(values(x), values(low), values(high), color, alpha, label))

    def barh(
        self,
        y: ArrayLike,
        width: ArrayLike,
        *,
        height: ArrayLike,
        left: ArrayLike,
        align: str = "edge",
        color: str = _COLOUR,
        alpha: float = 1.0,
        linewidth: float = 0.0,
        antialiased: bool = False,
        label: str | None = None,
    ) -> None:
        """Add level bars from `left` and, as `align` "edge" has it, upward from y; without outline."""
        del align, linewidth, antialiased
        start, bottom = values(left), values(y)
        self.marks.append(
            Bars(start, start + values(width), bottom, bottom + values(height), color, alpha, label)
        )

    def axhline(
        self, y: float, *, color: str, label: str | None = None, linewidth: float = 1.2, linestyle: Any = "-"
    ) -> None:
        """Add a level line across."""
        self.marks.append(Rule(float(y), True, color, label, linewidth, dashes_of(linestyle)))

    def axvline(
        self, x: float, *, color: str, label: str | None = None, linewidth: float = 1.2, linestyle: Any = "-"
    ) -> None:
        """Add an upright line across."""
        self.marks.append(Rule(float(x), False, color, label, linewidth, dashes_of(linestyle)))

    def annotate(
        self,
        text: str,
        xy: tuple[float, float],
        *,
        xytext: tuple[float, float],
        textcoords: str = "offset points",
        fontsize: float = 7.5,
    ) -> None:
        """Add text, shifted from a point by `xytext` pt."""
        del textcoords
        self.marks.append(Note(text, (float(xy[0]), float(xy[1])), xytext, fontsize))

    def set_xscale(self, scale: str) -> None:
        """Make the x axis "linear" or "log"."""
        self.xaxis.log = scale == "log"

    def set_yscale(self, scale: str, *, nonpositive: str = "clip") -> None:
        """Make the y axis "linear" or "log"; what is not positive there lies below the edge."""
        del nonpositive
        self.yaxis.log = scale == "log"

    def set_xlim(self, left: float | None = None, right: float | None = None) -> None:
        """Set limits of x."""
        _limit(self.xaxis, left, right)

    def set_ylim(self, bottom: float | None = None, top: float | None = None) -> None:
        """Set limits of y."""
        _limit(self.yaxis, bottom, top)

    def get_xlim(self) -> tuple[float, float]:
        """Return the limits of x."""
        return self.xaxis.limits(extent(self.marks)[0])

    def get_ylim(self) -> tuple[float, float]:
        """Return the limits of y."""
        return self.yaxis.limits(extent(self.marks)[1])

    def set_xticks(self, ticks: Sequence[float], labels: Sequence[str]) -> None:
        """Set the ticks of x and what stands below them."""
        self.xaxis.ticks = (list(map(float, ticks)), list(labels))

    def set_yticks(self, ticks: Sequence[float], labels: Sequence[str]) -> None:
        """Set the ticks of y and what stands beside them."""
        self.yaxis.ticks = (list(map(float, ticks)), list(labels))

    def set_xlabel(self, label: str) -> None:
        """Name the x axis."""
        self.xaxis.label = label

    def set_ylabel(self, label: str) -> None:
        """Name the y axis."""
        self.yaxis.label = label

    def set_title(self, label: str, *, loc: str = "left", fontsize: float | None = None) -> None:
        """Write above the axes, from their left edge."""
        del loc
        self.title = (label, fontsize)

    def grid(self, *, visible: bool, axis: str) -> None:
        """Show or hide the lines at the ticks of axis "x" or "y"."""
        (self.xaxis if axis == "x" else self.yaxis).grid = visible

    def tick_params(self, *, axis: str, length: float) -> None:
        """Set the length, pt, of the ticks of axis "x" or "y"."""
        (self.xaxis if axis == "x" else self.yaxis).length = length

    def locator_params(self, *, nbins: int) -> None:
        """Set the largest number of steps between ticks, on both axes."""
        self.xaxis.most = self.yaxis.most = nbins

    def margins(self, *, y: float) -> None:
        """Set the share of the range left free above and below."""
        self.yaxis.margin = y

    def get_lines(self) -> list[Line]:
        """Return the lines, in drawing order."""
        return [mark for mark in self.marks if isinstance(mark, Line)]

    def get_legend_handles_labels(self) -> tuple[list[Line | Shade | Bars | Rule], list[str]]:
        """Return the marks that have a label, bars last, and their labels."""
        named = [mark for mark in self.marks if not isinstance(mark, Note) and mark.label]
        # As matplotlib orders them, so that its PDF and our SVG have one legend.
        named.sort(key=lambda mark: isinstance(mark, Bars))
        return named, [str(mark.label) for mark in named]

    def legend(self, *, frameon: bool = False, loc: str = "upper left") -> None:
        """Put the legend into the upper left corner of the axes."""
        del frameon, loc
        self.inner_legend = Legend(*self.get_legend_handles_labels())

    def get_figure(self, *, root: bool = True) -> SvgFigure:
        """Return the figure."""
        del root
        return self.figure


class SvgFigure:
    """An empty figure.

    Parameters
    ----------
    figsize : tuple of float
        Width and height, inches.
    """

    def __init__(self, figsize: tuple[float, float]) -> None:
        self._size = figsize
        self.axes: list[SvgAxes] = []
        self.outer_legend: Legend | None = None

    def get_size_inches(self) -> tuple[float, float]:
        """Return width and height, inches."""
        return self._size

    def add_axes(self, bounds: tuple[float, float, float, float]) -> SvgAxes:
        """Add axes at left, bottom, width and height, as shares of the figure."""
        self.axes.append(SvgAxes(self, bounds))
        return self.axes[-1]

    def legend(
        self,
        handles: list[Line | Shade | Bars | Rule],
        labels: list[str],
        *,
        ncols: int = 1,
        loc: str = "lower left",
        bbox_to_anchor: tuple[float, float] = (0.0, 0.0),
        borderaxespad: float = 0.2,
    ) -> None:
        """Put a legend along the lower edge."""
        del loc, bbox_to_anchor, borderaxespad
        self.outer_legend = Legend(handles, labels, ncols)


def _limit(axis: Axis, lower: float | None, upper: float | None) -> None:
    axis.lower = axis.lower if lower is None else float(lower)
    axis.upper = axis.upper if upper is None else float(upper)
