"""Levels of a factor: each subject over them, and the average user by both methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from percept.errors import counted
from percept.report.contrast import LevelPanel, level_panels
from percept.report.figures.canvas import (
    COLOURS,
    MARKERS,
    REFERENCE_DASHES,
    WIDE,
    Drawing,
    Frame,
    brief,
    legend,
    log_scale,
    mark,
    panels,
    row_labels,
)
from percept.report.figures.intervals import tick_steps
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    distinct,
    family_of,
    listed,
    matching,
    words_of,
)
from percept.results import ContrastRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["level_drawings"]

FloatArray = NDArray[np.float64]

#: mm, half a page, for up to so many levels; more take the whole width.
_WIDTH = 86.0
_HEIGHT = 68.0
_MOST_ON_HALF_A_PAGE = 6
#: mm beside the levels, for the labels of the other axis.
_MARGINS = 18.0
#: Levels stand one unit apart: from a level to the intervals of its methods, beside the subjects.
_BESIDE = {"classical": 0.2, "bayesian": 0.3}
#: Half the width over which the subjects of a group are spread, in the same unit.
_SPREAD = 0.12
#: Room at both ends of the levels, in the same unit.
_END = 0.5
#: Room above and below, as a share of the axis.
_ROOM = 0.04
#: Quartile ranges beyond the quartiles from which on a value is far out (Tukey).
_FAR_OUT = 3.0


@dataclass(frozen=True, eq=False)
class _Panel:
    """One quantity over the levels of one factor."""

    factor: str
    quantity: Quantity
    levels: list[str]
    within: bool  # Whether lines join each subject's values
    values: FloatArray  # (levels, subjects) NaN where a subject lacks a cell
    means: list[ContrastRow]  # The average user at every level, by both methods
    log: bool
    low: float  # Ends of the axis
    high: float

    @property
    def reference(self) -> float:
        """Where the reference lies: at the ratio one, or the difference zero."""
        return 1.0 if self.log else 0.0

    @property
    def beyond(self) -> int:
        """How many subjects' values lie beyond the axis."""
        below = self.values < self.low
        above = self.values > self.high
        return int((below | above).sum())

    @property
    def lacking(self) -> int:
        """How many subjects have no value at some level; in groups, at none."""
        missing = np.isnan(self.values)
        subjects = missing.any(axis=0) if self.within else missing.all(axis=0)
        return int(subjects.sum())


def level_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity and factor: subjects, and the average user at each level."""
    outlines = level_panels(results)
    parts = [_panel(results, outline) for outline in outlines]
    subject = words_of(results).subject
    factors = listed(distinct(outlines, "factor"))
    description = _caption(results, parts)
    drawings = []
    for outline, panel in zip(outlines, parts, strict=True):
        narrow = len(panel.levels) <= _MOST_ON_HALF_A_PAGE
        width = _WIDTH if narrow else WIDE
        drawing = Drawing(
            name=outline.name,
            title=f"What each {subject} set at the levels of {factors}",
            description=description,
            size=(width, _HEIGHT),
            draw=_draw_with(panel, width, subject),
        )
        drawings.append(drawing)
    return drawings


def _panel(results: Results, outline: LevelPanel) -> _Panel:
    """Gather what one panel shows."""
    rows = matching(results.levels, parameter=outline.parameter, factor=outline.factor)
    values = np.array([row.values for row in rows], dtype=float)
    log = family_of(results) == "lognormal"
    low, high = _ends(values, outline.means, log=log)
    return _Panel(
        factor=outline.factor,
        quantity=results.data.quantities[outline.parameter],
        levels=[row.level for row in rows],
        within=rows[0].within,
        values=values,
        means=outline.means,
        log=log,
        low=low,
        high=high,
    )


def _ends(values: FloatArray, means: Sequence[ContrastRow], *, log: bool) -> tuple[float, float]:
    """Return the ends of the axis: what lies far out does not flatten the rest."""
    estimates = [row.estimate for row in means]
    limits = [row.lower for row in means] + [row.upper for row in means]
    shown = np.concatenate([values[np.isfinite(values)], estimates, [1.0 if log else 0.0]])
    limits_shown = np.array(limits)
    if log:
        shown = np.log(shown)
        # Limits of two subjects may underflow to zero.
        with np.errstate(divide="ignore"):
            limits_shown = np.log(limits_shown)
    first, third = np.percentile(shown, (25, 75))
    fence = _FAR_OUT * (third - first) or np.ptp(shown)
    every = np.concatenate([shown, limits_shown])
    near = every[(every >= first - fence) & (every <= third + fence)]
    # Estimates and the reference are there, however far out.
    always = shown[-len(estimates) - 1 :]
    low = min(near.min(), always.min())
    high = max(near.max(), always.max())
    if log:
        return float(np.exp(low)), float(np.exp(high))
    return float(low), float(high)


def _draw_with(panel: _Panel, width: float, subject: str) -> Callable[[Figure], None]:
    """Return what draws a panel on a figure."""

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(bottom=17.0))
        _draw_axis(ax, panel, width)
        _draw_subjects(ax, panel, subject)
        for method in METHODS:
            rows = matching(panel.means, method=method)
            if rows:
                # A line of no length stands for the method in the legend.
                label = METHOD_NAMES[method]
                ax.plot([], [], color=COLOURS[method], linewidth=2.4, label=label)
            for row in rows:
                _draw_mean(ax, row, panel)
        legend(ax, ncols=3)

    return draw


def _draw_axis(ax: Axes, panel: _Panel, width: float) -> None:
    """Label both axes, and draw the reference."""
    if panel.log:
        log_scale(ax, "y", plain=True)
        span = panel.high / panel.low
        ax.yaxis.set_major_locator(LogLocator(subs=tick_steps(span)))
        room = span**_ROOM
        ax.set_ylim(panel.low / room, panel.high * room)
        ax.set_ylabel("adjusted / reference")
    else:
        room = _ROOM * (panel.high - panel.low)
        ax.set_ylim(panel.low - room, panel.high + room)
        ax.set_ylabel(f"adjusted − reference ({panel.means[0].unit})")
    count = len(panel.levels)
    ax.set_xticks(range(count), row_labels(panel.levels, most=(width - _MARGINS) / count))
    ax.set_xlim(-_END, count - 1 + _END)
    ax.set_xlabel(panel.factor)
    ax.grid(visible=False, axis="x")
    ax.axhline(panel.reference, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    ax.set_title(panel.quantity.head, loc="left")


def _draw_subjects(ax: Axes, panel: _Panel, subject: str) -> None:
    """Join each subject's values over the levels; groups stand side by side as points."""
    count, subjects = panel.values.shape
    spread = np.zeros(subjects) if panel.within else np.linspace(-_SPREAD, _SPREAD, subjects)
    # A subject per row, and a gap after it. One path: a line for each of hundreds of subjects makes
    # a page of megabytes.
    x = np.arange(count + 1) + spread[:, None]
    y = np.full((subjects, count + 1), np.nan)
    y[:, :count] = np.clip(panel.values, panel.low, panel.high).T
    ax.plot(
        x.ravel(),
        y.ravel(),
        linewidth=0.6 if panel.within else 0.0,
        marker=".",
        markersize=3.0,
        color=COLOURS["quiet"],
        label=f"one {subject}",
    )
    for level, values in enumerate(panel.values):
        for beyond in (values[values < panel.low], values[values > panel.high]):
            if len(beyond):
                distance = np.abs(beyond - panel.reference)
                farthest = brief(beyond[distance.argmax()])
                text = farthest if len(beyond) == 1 else f"{len(beyond)}: to {farthest}"
                _point_beyond(ax, level, beyond[0], panel, "quiet", text)


def _draw_mean(ax: Axes, row: ContrastRow, panel: _Panel) -> None:
    """Draw the average user at a level with the interval of one method, beside the subjects."""
    colour = COLOURS[row.method]
    place = panel.levels.index(row.second) + _BESIDE[row.method]
    ends = np.clip([row.lower, row.upper], panel.low, panel.high)
    bar = ax.plot([place, place], ends, color=colour, linewidth=2.4)
    point = ax.plot(
        [place],
        [row.estimate],
        MARKERS[row.method],
        markersize=3.6,
        markerfacecolor=COLOURS["paper"],
        markeredgecolor=colour,
    )
    mark(ax, [*bar, *point], row.method, "mean")
    for end in (row.lower, row.upper):
        if not panel.low <= end <= panel.high:
            _point_beyond(ax, place, end, panel, row.method, brief(end))


def _point_beyond(
    ax: Axes, place: float, value: float, panel: _Panel, colour: str, text: str
) -> None:
    """Mark where a value leaves the axis."""
    below = value < panel.low
    edge = panel.low if below else panel.high
    arrow = "v" if below else "^"
    ax.plot([place], [edge], arrow, markersize=3.0, color=COLOURS[colour], clip_on=False)
    inward = 4 if below else -4
    ax.annotate(
        text,
        (place, edge),
        xytext=(3, inward),
        textcoords="offset points",
        va="center",
        fontsize=5.2,
        color=COLOURS["ink"],
    )


def _caption(results: Results, parts: Sequence[_Panel]) -> str:
    """Say what lines, points and marks stand for, and who is not drawn."""
    words = words_of(results)
    sentences = []
    if any(panel.within for panel in parts):
        sentences.append(f"A line joins the means of one {words.subject} over all references")
    if not all(panel.within for panel in parts):
        sentences.append(f"In groups, a point is the mean of one {words.subject}")
    drawn = {row.method for panel in parts for row in panel.means}
    by = " and ".join(METHOD_NAMES[method] for method in METHODS if method in drawn)
    sentences.append(f"Bars: the average {words.user}, {by} interval; dashed: the reference")
    beyond = sum(panel.beyond for panel in parts)
    if beyond:
        lies = "lies" if beyond == 1 else "lie"
        sentences.append(f"{counted(beyond, 'value')} {lies} beyond the axis, at its end")
    lacking = max((panel.lacking for panel in parts), default=0)
    if lacking:
        has = "has" if lacking == 1 else "have"
        who = counted(lacking, words.subject, words.subjects)
        sentences.append(f"{who} {has} no value at some level, for want of a trial there")
    return " ".join(f"{sentence}." for sentence in sentences)
