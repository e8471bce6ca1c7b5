"""Levels of a factor: each subject over them, the average user, and how the levels differ."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.contrast import contrast_rows, is_ratio, level_figures
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    draw_interval,
    legend,
    log_scale,
    method_legend,
    panels,
    reference_line,
    shortened,
)
from percept.report.select import METHODS, distinct, matching
from percept.results import ContrastRow, LevelValues, Results

FloatArray = NDArray[np.float64]

_HEIGHT = 58.0  # mm, of each of two panels
#: Levels stand one unit apart: from a level to the intervals of its methods, beside the subjects.
_BESIDE = {"classical": 0.2, "bayesian": 0.3}
#: Half the width over which the subjects of a group are spread, in the same unit.
_SPREAD = 0.12
_END = 0.5  # room at both ends of the levels, in the same unit
_MOST_LETTERS = 60  # of all levels together
_GROUP_COLOURS = ("quiet", "coupled", "warn", "ink")
#: Pairs of levels that a figure compares; a table has all.
_MOST_PAIRS = 6


def level_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity and factor: subjects and means, and how the levels differ."""
    words = results.data.words
    drawings = []
    for name, (parameter, factor) in level_figures(results).items():
        quantity = results.data.quantities[parameter]
        own = matching(results.levels, parameter=parameter, factor=factor)
        drawings.append(
            Drawing(
                name=name,
                title=f"{quantity.head} at the levels of {factor}, and their differences",
                description=f"Above: a {'line' if own[0].within else 'point'} for each"
                f" {words.subject}, over all references, with the average {words.user} beside."
                f" Below: how the average {words.user} differs between levels. Dashed: the"
                " reference; no difference.",
                height=2.0 * _HEIGHT,
                draw=partial(_draw, results=results, parameter=parameter, factor=factor),
            )
        )
    return drawings


def _draw(figure: Figure, results: Results, parameter: str, factor: str) -> None:
    """Draw the levels, and the differences beside them where there are some."""
    rows = matching(contrast_rows(results), parameter=parameter, factor=factor, kind="mean")
    between = matching(rows, of="bias")
    overall = matching(between, environment=None) or between
    axes = panels(figure, 2 if overall else 1, columns=1)
    _draw_levels(axes[0], matching(rows, of="level"), results)
    axes[0].set_title(results.data.quantities[parameter].head, loc="left")
    if overall:
        _draw_differences(axes[1], overall)
    legend(axes)


def _draw_levels(ax: Axes, means: Sequence[ContrastRow], results: Results) -> None:
    """Draw each subject's values over the levels, and the average user beside them."""
    parameter = means[0].parameter
    quantity = results.data.quantities[parameter]
    own = matching(results.levels, parameter=parameter, environment=None)
    rows = matching(own, factor=means[0].factor)
    raw = matching(results.contrast, parameter=parameter, factor=means[0].factor, of="level")
    # Values are in the unit of report.json, as its contrasts.
    scale = means[0].estimate / raw[0].estimate if raw[0].estimate else 1.0
    values = scale * np.array([row.values for row in rows], dtype=float)
    groups = _groups(own, rows[0].factor)
    if len(groups) < 2:
        groups = {f"one {results.data.words.subject}": np.ones(values.shape[1], dtype=bool)}
    for (name, members), colour in zip(groups.items(), _GROUP_COLOURS * len(groups), strict=False):
        _draw_subjects(ax, values[:, members], name, colour, within=rows[0].within)
    levels = [row.level for row in rows]
    for row in means:
        place = levels.index(row.second) + _BESIDE[row.method]
        limits = [row.lower, row.upper]
        draw_interval(ax, place, limits, row.estimate, row.method, upright=True)
    log = is_ratio(means[0])
    if log:
        log_scale(ax, "y", plain=True)
    unit = f" ({means[0].unit})" if means[0].unit else ""
    label = "setting − reference" if quantity.is_matched else quantity.label
    ax.set_ylabel("setting / reference" if log else f"{label}{unit}")
    ax.set_xticks(range(len(levels)), shortened(levels, max(4, _MOST_LETTERS // len(levels))))
    ax.set_xlim(-_END, len(levels) - 1 + _END)
    ax.set_xlabel(rows[0].factor)
    ax.grid(visible=False, axis="x")
    if quantity.is_matched:
        reference_line(ax, float(log), "y")


def _groups(rows: Sequence[LevelValues], factor: str) -> dict[str, NDArray[np.bool_]]:
    """Return the subjects of each level of the first factor between groups, if another's drawn."""
    between = matching(rows, within=False)
    if not between or between[0].factor == factor:
        return {}
    of_groups = matching(between, factor=between[0].factor)
    return {row.level: np.array([one is not None for one in row.values]) for row in of_groups}


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
        x.ravel(), y.ravel(), linewidth=0.6 if within else 0.0, marker=".", markersize=3.0,
        color=COLOURS[colour], label=name,
    )  # fmt: skip


def _draw_differences(ax: Axes, contrasts: Sequence[ContrastRow]) -> None:
    """Draw contrasts of the levels, both methods, with the line of no difference."""
    pairs = list(dict.fromkeys((row.first, row.second) for row in contrasts))[:_MOST_PAIRS]
    for row in contrasts:
        if (row.first, row.second) in pairs:
            place = -(pairs.index((row.first, row.second)) + _BESIDE[row.method])
            draw_interval(ax, place, [row.lower, row.upper], row.estimate, row.method)
    log = is_ratio(contrasts[0])
    reference_line(ax, float(log))
    if log:
        log_scale(ax, "x", plain=True)
    names = [f"{second} : {first}" if log else f"{second} − {first}" for first, second in pairs]
    ax.set_yticks([-index - 0.25 for index in range(len(pairs))], shortened(names, 30))
    ax.set_ylim(-len(pairs) + 0.2, 0.3)
    unit = f" ({contrasts[0].unit})" if contrasts[0].unit else ""
    ax.set_xlabel("ratio" if log else f"difference{unit}")
    method_legend(ax, [one for one in METHODS if one in distinct(contrasts, "method")])
    ax.grid(visible=False, axis="y")
