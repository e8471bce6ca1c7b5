"""Levels of a factor: each subject over them, the average user, and how the levels differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.contrast import LevelPanel, Size, level_panels, size_of
from percept.report.figures.canvas import (
    COLOURS,
    MARKERS,
    REFERENCE_DASHES,
    WIDE,
    Drawing,
    label_between,
    legend,
    log_scale,
    panels,
    unique_labels,
)
from percept.report.select import METHOD_NAMES, METHODS, distinct, matching, words_of
from percept.results import ContrastRow, LevelValues, Results

__all__ = ["level_drawings"]

FloatArray = NDArray[np.float64]

_HEIGHT = 68.0  # mm
#: Levels stand one unit apart: from a level to the intervals of its methods, beside the subjects.
_BESIDE = {"classical": 0.2, "bayesian": 0.3}
#: Half the width over which the subjects of a group are spread, in the same unit.
_SPREAD = 0.12
_END = 0.5  # room at both ends of the levels, in the same unit
_MOST_LETTERS = 60  # of all levels together
_GROUP_COLOURS = ("quiet", "coupled", "warn", "ink")
#: Pairs of levels that a figure compares; a table has all.
_MOST_PAIRS = 6


@dataclass(frozen=True, eq=False)
class _Panel:
    """One quantity over the levels of one factor."""

    title: str
    label: str  # Of the values
    outline: LevelPanel
    rows: list[LevelValues]  # Over all references
    groups: dict[str, NDArray[np.bool_]]  # Subjects of each group, by its name
    contrasts: list[ContrastRow]  # Between the levels, by both methods
    size: Size  # How differences are written

    @property
    def log(self) -> bool:
        """Whether values are ratios to the reference."""
        return self.outline.means[0].family == "lognormal"


def level_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity and factor: subjects and means, and how the levels differ."""
    words = words_of(results)
    drawings = []
    for outline in level_panels(results):
        panel = _panel(results, outline)
        lines = "a line for each" if panel.rows[0].within else "a point for each"
        coloured = f" Colours: {' and '.join(panel.groups)}." if len(panel.groups) > 1 else ""
        drawings.append(
            Drawing(
                name=outline.name,
                title=f"{panel.title} at the levels of {outline.factor}, and their differences",
                description=f"Left: {lines} {words.subject}, over all references, with the average"
                f" {words.user} beside.{coloured} Right: how the average {words.user} differs"
                " between levels. Dashed: the reference; no difference.",
                size=(WIDE, _HEIGHT),
                draw=partial(_draw, panel=panel, subject=words.subject),
            )
        )
    return drawings


def _panel(results: Results, outline: LevelPanel) -> _Panel:
    """Gather what a figure shows."""
    own = matching(results.levels, parameter=outline.parameter, environment=None)
    of_factor = matching(results.contrast, parameter=outline.parameter, factor=outline.factor)
    of_users = matching(of_factor, of="bias", kind="mean")
    overall = matching(of_users, environment=None) or of_users
    groups = {}
    for row in matching(own, within=False):
        if row.factor != outline.factor and row.factor == matching(own, within=False)[0].factor:
            groups[row.level] = np.array([value is not None for value in row.values])
    quantity = results.data.quantities[outline.parameter]
    size = size_of(outline.means[0], results)
    label = "setting / reference"
    if not size.ratio:
        what = "setting − reference" if quantity.is_matched else quantity.label
        label = f"{what}{size.axis}"
    return _Panel(
        title=quantity.head,
        label=label,
        outline=outline,
        rows=matching(own, factor=outline.factor),
        groups=groups,
        contrasts=overall,
        size=size,
    )


def _draw(figure: Figure, panel: _Panel, subject: str) -> None:
    """Draw the levels, and the differences beside them where there are some."""
    axes = panels(figure, 2 if panel.contrasts else 1)
    _draw_levels(axes[0], panel, subject)
    if panel.contrasts:
        _draw_differences(axes[1], panel)
    legend(axes)


def _draw_levels(ax: Axes, panel: _Panel, subject: str) -> None:
    """Draw each subject's values over the levels, and the average user beside them."""
    values = panel.size.scale * np.array([row.values for row in panel.rows], dtype=float)
    everyone = {f"one {subject}": np.ones(values.shape[1], dtype=bool)}
    groups = panel.groups if len(panel.groups) > 1 else everyone
    for (name, members), colour in zip(groups.items(), _GROUP_COLOURS * len(groups), strict=False):
        _draw_subjects(ax, values[:, members], name, colour, within=panel.rows[0].within)
    levels = [row.level for row in panel.rows]
    for row in panel.outline.means:
        place = levels.index(row.second) + _BESIDE[row.method]
        lower, upper, estimate = panel.size.scaled(row)
        _draw_interval(ax, [place, place], [lower, upper], place, estimate, row.method)
    if panel.log:
        log_scale(ax, "y", plain=True)
        label_between(ax, "y")
    ax.set_ylabel(panel.label)
    ax.set_xticks(range(len(levels)), unique_labels(levels, max(4, _MOST_LETTERS // len(levels))))
    ax.set_xlim(-_END, len(levels) - 1 + _END)
    ax.set_xlabel(panel.outline.factor)
    ax.grid(visible=False, axis="x")
    reference = 1.0 if panel.log else 0.0
    ax.axhline(reference, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    ax.set_title(panel.title, loc="left")


def _draw_subjects(ax: Axes, values: FloatArray, name: str, colour: str, *, within: bool) -> None:
    """Join each subject's values over the levels; groups stand side by side as points."""
    count, subjects = values.shape
    spread = np.zeros(subjects) if within else np.linspace(-_SPREAD, _SPREAD, subjects)
    # A subject per row, and a gap after it. One path: a line for each of hundreds of subjects makes
    # a page of megabytes.
    x = np.arange(count + 1) + spread[:, None]
    y = np.full((subjects, count + 1), np.nan)
    y[:, :count] = values.T
    ax.plot(
        x.ravel(),
        y.ravel(),
        linewidth=0.6 if within else 0.0,
        marker=".",
        markersize=3.0,
        color=COLOURS[colour],
        label=name,
    )


def _draw_differences(ax: Axes, panel: _Panel) -> None:
    """Draw contrasts of the levels, both methods, with the line of no difference."""
    pairs = list(dict.fromkeys((row.first, row.second) for row in panel.contrasts))[:_MOST_PAIRS]
    for index, (first, second) in enumerate(pairs):
        for row in matching(panel.contrasts, first=first, second=second):
            place = -(index + _BESIDE[row.method])
            lower, upper, estimate = panel.size.scaled(row)
            _draw_interval(ax, [lower, upper], [place, place], estimate, place, row.method)
    ax.axvline(
        1.0 if panel.log else 0.0, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8
    )
    if panel.log:
        log_scale(ax, "x", plain=True)
        label_between(ax, "x")
    names = unique_labels([f"{second} : {first}" for first, second in pairs], _MOST_LETTERS // 2)
    ax.set_yticks([-index - 0.25 for index in range(len(pairs))], names)
    ax.set_ylim(-len(pairs) + 0.2, 0.3)
    ax.set_xlabel("ratio" if panel.log else f"difference{panel.size.axis}")
    for method in METHODS:
        if method in distinct(panel.contrasts, "method"):
            ax.plot([], [], color=COLOURS[method], linewidth=2.4, label=METHOD_NAMES[method])
    ax.grid(visible=False, axis="y")


def _draw_interval(
    ax: Axes, x: Sequence[float], y: Sequence[float], at_x: float, at_y: float, method: str
) -> None:
    """Draw an interval with its estimate."""
    colour = COLOURS[method]
    ax.plot(x, y, color=colour, linewidth=2.4)
    ax.plot(
        [at_x],
        [at_y],
        MARKERS[method],
        markersize=3.6,
        markerfacecolor=COLOURS["paper"],
        markeredgecolor=colour,
    )
