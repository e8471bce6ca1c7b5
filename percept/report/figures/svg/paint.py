"""From a figure to the elements of an SVG, in points from the top left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.svg.axes import Axis, Legend, SvgAxes, SvgFigure
from percept.report.figures.svg.marks import Bars, Line, Mark, Note, Rule, Shade, extent
from percept.report.figures.svg.text import TextWriter, text_width
from percept.report.figures.svg.ticks import Ticks, linear_ticks, log_ticks, minor_ticks

__all__ = ["Look", "paint"]

Array = NDArray[np.float64]
# Further out than that, points of a line lie on no paper; the clip path takes the rest.
_FAR = 1e5
_PAD = 3.5  # pt, from ticks to their labels
_MINOR = 2.0  # pt, length of the ticks between
# A letter in the middle of its line stands so much of its size below it.
_MIDDLE = 0.36
_MARKERS = {
    "o": "M-{0} 0a{0} {0} 0 1 0 {1} 0a{0} {0} 0 1 0 -{1} 0z",
    "D": "M0 -{2}L{2} 0L0 {2}L-{2} 0z",
    "X": "M-{0} -{3}L-{3} -{0}L0 -{3}L{3} -{0}L{0} -{3}L{3} 0"
    "L{0} {3}L{3} {0}L0 {3}L-{3} {0}L-{0} {3}L-{3} 0z",
    "|": "M0 -{0}V{0}",
}


@dataclass(frozen=True)
class Look:
    """Colours and sizes that all figures share.

    Attributes
    ----------
    ink, quiet, rule : str
        Colours of letters, of axes and ticks, and of the lines at the ticks.
    text, title, ticks, legend : float
        Sizes of letters, pt.
    """

    ink: str
    quiet: str
    rule: str
    text: float = 7.5
    title: float = 8.0
    ticks: float = 7.0
    legend: float = 6.8


def paint(figure: SvgFigure, writer: TextWriter, look: Look, *, prefix: str = "") -> str:
    """Write what a figure shows.

    Parameters
    ----------
    figure : SvgFigure
        What was drawn.
    writer : TextWriter
        How letters are written.
    look : Look
        Colours and sizes.
    prefix : str
        Before every id.

    Returns
    -------
    str
        Elements inside an ``<svg>`` whose unit is a point.
    """
    parts = [
        element
        for number, axes in enumerate(figure.axes)
        for element in _Painter(axes, writer, look, f"{prefix}clip-{number}").elements()
    ]
    if figure.outer_legend is not None:
        height = figure.get_size_inches()[1] * 72.0
        rows = -(-len(figure.outer_legend.labels) // figure.outer_legend.columns)
        pad = 0.6 * look.legend
        parts += _legend(figure.outer_legend, writer, look, pad, height - pad - rows * 1.5 * look.legend)
    return "\n".join(parts)


class _Painter:
    """One set of axes with its places worked out."""

    def __init__(self, axes: SvgAxes, writer: TextWriter, look: Look, clip: str) -> None:
        self.axes, self.writer, self.look, self.clip = axes, writer, look, clip
        width, height = (72.0 * side for side in axes.figure.get_size_inches())
        left, bottom, wide, high = axes.bounds
        self.left, self.right = left * width, (left + wide) * width
        self.top, self.bottom = (1 - bottom - high) * height, (1 - bottom) * height
        across, upward = extent(axes.marks)
        self.x_limits, self.y_limits = axes.xaxis.limits(across), axes.yaxis.limits(upward)

    def x(self, places: Array) -> Array:
        return self.left + (self.right - self.left) * _share(self.axes.xaxis.log, self.x_limits, places)

    def y(self, places: Array) -> Array:
        return self.bottom + (self.top - self.bottom) * _share(self.axes.yaxis.log, self.y_limits, places)

    def elements(self) -> list[str]:
        wide, high = self.right - self.left, self.bottom - self.top
        frame = f'<rect x="{self.left:.6g}" y="{self.top:.6g}" width="{wide:.6g}" height="{high:.6g}"/>'
        ordered = sorted(self.axes.marks, key=lambda mark: not isinstance(mark, Shade | Bars))
        found = [f'<clipPath id="{self.clip}">{frame}</clipPath>', *self._sides()]
        found.append(f'<g clip-path="url(#{self.clip})">')
        found += [element for mark in ordered for element in self._mark(mark)]
        found.append("</g>")
        # Marks on the edge show whole; notes may stand beside it.
        found += [element for mark in ordered for element in self._over(mark)]
        title, size = self.axes.title
        if title:
            found.append(
                self.writer.write(
                    title, self.left, self.top - 6.0, size=size or self.look.title, colour=self.look.ink
                )
            )
        if self.axes.inner_legend is not None:
            found += _legend(self.axes.inner_legend, self.writer, self.look, self.left + 6.0, self.top + 4.0)
        return found

    def _sides(self) -> list[str]:
        """Lines at the ticks, ticks, their labels, the axes and what is written beside them."""
        look, xaxis, yaxis = self.look, self.axes.xaxis, self.axes.yaxis
        size = look.ticks
        x_ticks = _ticks(xaxis, self.x_limits, (self.right - self.left) / (3.0 * size))
        y_ticks = _ticks(yaxis, self.y_limits, (self.bottom - self.top) / (2.0 * size))
        x_places, y_places = self.x(np.array(x_ticks[0])), self.y(np.array(y_ticks[0]))
        rules = "".join(f"M{place:.2f} {self.bottom:.2f}V{self.top:.2f}" for place in x_places if xaxis.grid)
        rules += "".join(f"M{self.left:.2f} {place:.2f}H{self.right:.2f}" for place in y_places if yaxis.grid)
        ticks = "".join(f"M{place:.2f} {self.bottom:.2f}v{xaxis.length:g}" for place in x_places)
        ticks += "".join(f"M{self.left:.2f} {place:.2f}h-{yaxis.length:g}" for place in y_places)
        between = _between(xaxis, self.x_limits, x_ticks), _between(yaxis, self.y_limits, y_ticks)
        ticks += "".join(f"M{place:.2f} {self.bottom:.2f}v{_MINOR:g}" for place in self.x(between[0]))
        ticks += "".join(f"M{self.left:.2f} {place:.2f}h-{_MINOR:g}" for place in self.y(between[1]))
        frame = f"M{self.left:.2f} {self.top:.2f}V{self.bottom:.2f}H{self.right:.2f}"
        found = [_stroke(rules, look.rule, 0.4), _stroke(frame + ticks, look.quiet, 0.6)]
        below = self.bottom + xaxis.length + _PAD + 0.76 * size
        beside = self.left - yaxis.length - _PAD
        for label, place in zip(x_ticks[1], x_places, strict=True):
            found.append(self._text(label, float(place), below, size, "center"))
        for label, place in zip(y_ticks[1], y_places, strict=True):
            found.append(self._text(label, beside, float(place) + _MIDDLE * size, size, "right"))
        if xaxis.label:
            middle = 0.5 * (self.left + self.right)
            found.append(self._text(xaxis.label, middle, below + 4.0 + look.text, look.text, "center"))
        if yaxis.label:
            widest = max((text_width(label, size) for label in y_ticks[1]), default=0.0)
            middle = 0.5 * (self.top + self.bottom)
            found.append(
                self._text(yaxis.label, beside - widest - 5.5, middle, look.text, "center", turned=True)
            )
        return found

    def _text(self, text: str, x: float, y: float, size: float, align: str, *, turned: bool = False) -> str:
        return self.writer.write(text, x, y, size=size, colour=self.look.ink, align=align, turned=turned)

    def _mark(self, mark: Mark) -> list[str]:
        """Return what the axes' edges cut off."""
        match mark:
            case Line() if mark.linewidth:
                return [
                    _stroke(_path(self.x(mark.x), self.y(mark.y)), mark.color, mark.linewidth, mark.dashes)
                ]
            case Shade():
                around = np.append(mark.x, mark.x[::-1]), np.append(mark.low, mark.high[::-1])
                return [_fill(_path(self.x(around[0]), self.y(around[1])), mark.color, mark.alpha)]
            case Bars():
                sides = (self.x(mark.left), self.x(mark.right), self.y(mark.bottom), self.y(mark.top))
                boxes = "".join(
                    f"M{left:.2f} {bottom:.2f}H{right:.2f}V{top:.2f}H{left:.2f}z"
                    for left, right, bottom, top in zip(*sides, strict=True)
                )
                return [_fill(boxes, mark.color, mark.alpha, crisp=True)]
            case Rule(level=True):
                (place,) = self.y(np.array([mark.place]))
                path = f"M{self.left:.2f} {place:.2f}H{self.right:.2f}"
                return [_stroke(path, mark.color, mark.linewidth, mark.dashes)]
            case Rule():
                (place,) = self.x(np.array([mark.place]))
                path = f"M{place:.2f} {self.bottom:.2f}V{self.top:.2f}"
                return [_stroke(path, mark.color, mark.linewidth, mark.dashes)]
        return []

    def _over(self, mark: Mark) -> list[str]:
        match mark:
            case Line() if mark.marker:
                inside = _inside(mark.x, self.x_limits) & _inside(mark.y, self.y_limits)
                places = zip(self.x(mark.x[inside]), self.y(mark.y[inside]), strict=True)
                return [_marker(mark, float(x), float(y)) for x, y in places]
            case Note():
                (x,), (y,) = self.x(np.array([mark.point[0]])), self.y(np.array([mark.point[1]]))
                return [self._text(mark.text, x + mark.offset[0], y - mark.offset[1], mark.size, "left")]
        return []


def _legend(legend: Legend, writer: TextWriter, look: Look, left: float, top: float) -> list[str]:
    """Entries down the columns, each a short sample and its label."""
    size = look.legend
    rows = -(-len(legend.labels) // legend.columns)
    found = []
    for start in range(0, len(legend.labels), rows):
        labels = legend.labels[start : start + rows]
        for row, (mark, label) in enumerate(zip(legend.marks[start:], labels, strict=False)):
            middle = top + (row + 0.5) * 1.5 * size
            found += _sample(mark, left, middle, size)
            found.append(
                writer.write(label, left + 2.8 * size, middle + _MIDDLE * size, size=size, colour=look.ink)
            )
        left += 4.6 * size + max(text_width(label, size) for label in labels)
    return found


def _sample(mark: Line | Shade | Bars | Rule, left: float, middle: float, size: float) -> list[str]:
    """Return two ems of a mark, level at `middle`."""
    if isinstance(mark, Shade | Bars):
        box = f"M{left:.2f} {middle + 0.35 * size:.2f}h{2 * size:.2f}v{-0.7 * size:.2f}h{-2 * size:.2f}z"
        return [_fill(box, mark.color, mark.alpha)]
    found = []
    if mark.linewidth:
        path = f"M{left:.2f} {middle:.2f}h{2 * size:.2f}"
        found.append(_stroke(path, mark.color, mark.linewidth, mark.dashes))
    if isinstance(mark, Line) and mark.marker:
        found.append(_marker(mark, left + size, middle))
    return found


def _share(log: bool, limits: tuple[float, float], places: Array) -> Array:
    """Return places as shares of an axis; what is not positive lies far below a logarithmic one."""
    if not log:
        return (places - limits[0]) / (limits[1] - limits[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(places <= 0, -np.inf, np.log10(places))
    low, high = np.log10(limits[0]), np.log10(limits[1])
    return (logs - low) / (high - low)


def _inside(places: Array, limits: tuple[float, float]) -> NDArray[np.bool_]:
    return (places >= limits[0]) & (places <= limits[1])


def _ticks(axis: Axis, limits: tuple[float, float], room: float) -> Ticks:
    if axis.ticks is not None:
        inside = [pair for pair in zip(*axis.ticks, strict=True) if limits[0] <= pair[0] <= limits[1]]
        return [place for place, _ in inside], [label for _, label in inside]
    most = axis.most or max(2, min(9, int(room)))
    if not axis.log:
        return linear_ticks(*limits, most=most)
    formatter = axis.formatter
    return log_ticks(*limits, most=most, label=(lambda place: formatter(place, None)) if formatter else None)


def _between(axis: Axis, limits: tuple[float, float], ticks: Ticks) -> Array:
    return np.array(minor_ticks(*limits, ticks[0]) if axis.log and axis.minor else [])


def _path(x: Array, y: Array) -> str:
    """Return path data through points, with a gap where one is missing."""
    x, y = (np.clip(side, -_FAR, _FAR) for side in (x, y))
    seen = np.isfinite(x) & np.isfinite(y)
    pieces = []
    pen = False
    for across, down, there in zip(x.tolist(), y.tolist(), seen.tolist(), strict=True):
        if there:
            pieces.append(f"{'L' if pen else 'M'}{across:.2f} {down:.2f}")
        pen = there
    return "".join(pieces)


def _stroke(path: str, colour: str, width: float, dashes: tuple[float, ...] = ()) -> str:
    if not path:
        return ""
    # As in matplotlib, dashes are as long as the line is wide.
    dashed = f";stroke-dasharray:{','.join(f'{width * one:.4g}' for one in dashes)}" if dashes else ""
    return f'<path d="{path}" style="fill:none;stroke:{colour};stroke-width:{width:g}{dashed}"/>'


def _fill(path: str, colour: str, alpha: float, *, crisp: bool = False) -> str:
    if not path:
        return ""
    edges = ' shape-rendering="crispEdges"' if crisp else ""
    return f'<path d="{path}"{edges} style="fill:{colour};fill-opacity:{alpha:g}"/>'


def _marker(mark: Line, x: float, y: float) -> str:
    half = 0.5 * mark.markersize
    path = _MARKERS[mark.marker].format(
        *(f"{one:.4g}" for one in (half, 2 * half, 1.41421 * half, 0.5 * half))
    )
    style = f"fill:{mark.face};stroke:{mark.edge};stroke-width:1"
    return f'<path transform="translate({x:.2f} {y:.2f})" d="{path}" style="{style}"/>'
