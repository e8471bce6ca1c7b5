"""Levels of a factor: each subject over them, and the average user by both methods."""

from __future__ import annotations

import dataclasses
import itertools
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
from percept.report.figures.intervals import bars_of, tick_steps
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

__all__ = ["level_drawings"]

FloatArray = NDArray[np.float64]

#: mm, half a page, for up to so many levels; more take the whole width.
_WIDTH = 86.0
_HEIGHT = 68.0
_MOST_ON_HALF_A_PAGE = 6
#: Each of so many environments has a panel: two rows of three, and one, fit a page.
_MOST_ENVIRONMENTS = 6
#: Panels in a row across the page.
_COLUMNS = 3
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

    title: str
    factor: str
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
    """Return a figure per quantity and factor: subjects, and the average user at each level.

    Its first panel is over all references. In a study with one factor and few environments, each
    of these has another.
    """
    outlines = level_panels(results)
    figures = [_panels(results, outline) for outline in outlines]
    subject = words_of(results).subject
    factors = listed(distinct(outlines, "factor"))
    description = _caption(results, figures)
    drawings = []
    for outline, parts in zip(outlines, figures, strict=True):
        narrow = len(parts) == 1 and len(parts[0].levels) <= _MOST_ON_HALF_A_PAGE
        rows = -(-len(parts) // _COLUMNS)
        drawing = Drawing(
            name=outline.name,
            title=f"What each {subject} set at the levels of {factors}",
            description=description,
            size=(_WIDTH if narrow else WIDE, _HEIGHT * rows),
            draw=_draw_with(parts, _WIDTH if narrow else WIDE, subject),
        )
        drawings.append(drawing)
    return drawings


def _panels(results: Results, outline: LevelPanel) -> list[_Panel]:
    """Gather what the panels of a figure show, that over all references first."""
    of_figure = matching(results.levels, parameter=outline.parameter, factor=outline.factor)
    means: dict[str | None, list[ContrastRow]] = {None: outline.means}
    environments = [name for name in distinct(of_figure, "environment") if name is not None]
    narrow = len(matching(of_figure, environment=None)) <= _MOST_ON_HALF_A_PAGE
    if narrow and len(environments) <= _MOST_ENVIRONMENTS:
        for name in environments:
            in_environment = _means_in(results, outline, name)
            # Cells of several factors have no mean over the others.
            if in_environment:
                means[name] = in_environment
    drawn = [row for row in of_figure if row.environment in means]
    log = family_of(results) == "lognormal"
    # One axis for all panels: they are there to be compared.
    values = np.array([row.values for row in drawn], dtype=float)
    low, high = _ends(values, list(itertools.chain(*means.values())), log=log)
    parts = []
    for environment, of_users in means.items():
        rows = matching(drawn, environment=environment)
        panel = _Panel(
            title=environment or results.data.quantities[outline.parameter].head,
            factor=outline.factor,
            levels=[row.level for row in rows],
            within=rows[0].within,
            values=np.array([row.values for row in rows], dtype=float),
            means=of_users,
            log=log,
            low=low,
            high=high,
        )
        parts.append(panel)
    return parts


def _means_in(results: Results, outline: LevelPanel, environment: str) -> list[ContrastRow]:
    """Return the average user at each level in one environment, in a study with one factor."""
    bars = bars_of(results.intervals, outline.parameter, ("mean",), [family_of(results)])
    means = []
    for mean in outline.means:
        cell = f"{environment} ({mean.second})"
        # A difference in references is a ratio less one.
        less = 1.0 if mean.unit == "references" else 0.0
        for bar in matching(bars, environment=cell, method=mean.method):
            row = dataclasses.replace(
                mean,
                lower=bar.lower - less,
                upper=bar.upper - less,
                estimate=bar.estimate - less,
            )
            means.append(row)
    return means


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


def _draw_with(parts: Sequence[_Panel], width: float, subject: str) -> Callable[[Figure], None]:
    """Return what draws the panels of a figure."""
    columns = min(_COLUMNS, len(parts))

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(parts), columns=columns, frame=Frame(bottom=17.0))
        for panel, ax in zip(parts, axes, strict=True):
            _draw_axis(ax, panel, width / columns)
            _draw_subjects(ax, panel, subject)
            for row in panel.means:
                _draw_mean(ax, row, panel)
        for index, ax in enumerate(axes):
            if index % columns:
                ax.set_ylabel("")
        for method in distinct(parts[0].means, "method"):
            # A line of no length stands for the method in the legend.
            axes[0].plot([], [], color=COLOURS[method], linewidth=2.4, label=METHOD_NAMES[method])
        legend(axes[0], ncols=3)

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
    (title,) = row_labels([panel.title], most=width)
    ax.set_title(title, loc="left")


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


def _caption(results: Results, figures: Sequence[list[_Panel]]) -> str:
    """Say what lines, points and marks stand for, and who is not drawn."""
    parts = list(itertools.chain(*figures))
    words = words_of(results)
    sentences = []
    if any(panel.within for panel in parts):
        sentences.append(f"A line joins the means of one {words.subject}")
    if not all(panel.within for panel in parts):
        sentences.append(f"In groups, a point is the mean of one {words.subject}")
    over = "Means are over all references"
    if len(parts) > len(figures):
        over += f" in the first panel; every other panel is of one {words.environment}"
    sentences.append(over)
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
