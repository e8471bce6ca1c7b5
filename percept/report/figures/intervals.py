"""What users set: an overview with a row per environment, and the levels of factors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import cycle, product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.adjustments import is_ratio, level_figures, unit_of
from percept.report.basics import KINDS, METHODS, bracketed, distinct, matching, present
from percept.report.biases import Bias, biases_of, drawn_said, foremost
from percept.report.figures.canvas import (
    COLOURS,
    REFERENCE,
    Drawing,
    draw_interval,
    legend,
    log_scale,
    method_legend,
    panels,
    shortened,
)
from percept.results import CellValues, LevelValues, Results, Words
from percept.sessions.quantities import Quantity

FloatArray = NDArray[np.float64]

#: Points, by what an interval covers: the narrower the interval, the thicker its bar.
_THICKNESS = {"mean": 3.0, "user": 1.4, "share": 0.6}
#: Between two environments, in distances between two bars of one.
_GAP = 1.5
_MOST_LETTERS = 22  # of an environment
_REFERENCE_WIDTH = 0.8  # points
_FARTHEST = 1e4  # ratio to the reference that a figure shows
_ROOM = 0.02  # at both ends of an axis, as a share of its length
_LINE_HEIGHT = 1.9  # mm, of a bar or of the subjects
_HEIGHT = 22.0  # mm, of title, axis and legend

_LEVELS_HEIGHT = 58.0  # mm
#: Levels stand one unit apart: from a level to the intervals of its methods, beside the subjects.
_BESIDE = {"classical": 0.2, "bayesian": 0.3}
#: Half the width over which the subjects of a group are spread, in the same unit.
_SPREAD = 0.12
_END = 0.5  # room at both ends of the levels, in the same unit
_LEVELS_LETTERS = 60  # of all levels together
_GROUP_COLOURS = ("quiet", "coupled", "warn", "ink")


def draw_intervals(
    ax: Axes,
    biases: Sequence[Bias],
    cells: Sequence[CellValues],
    quantity: Quantity,
    words: Words,
) -> None:
    """Draw a row per environment: subjects as dots, kinds by thickness, methods by colour.

    Parameters
    ----------
    ax : Axes
        To draw on. Its ends hold every finite value; what is infinite reaches them.
    biases : sequence of Bias
        Intervals of one quantity, at least one.
    cells : sequence of CellValues
        Values of the subjects.
    quantity : Quantity
        What is drawn.
    words : Words
        What the study calls subjects and users.
    """
    relative = biases[0].relative
    environments = distinct(biases, "environment")
    rows = [bias.row for bias in biases]
    lines = list(dict.fromkeys((row.kind, row.method) for row in rows))
    # The reference is a ratio of one, or a difference of zero.
    centre = float(relative)
    against = np.divide if relative else np.subtract
    bars = [against([row.lower, row.upper, row.estimate], row.reference or 0.0) for row in rows]
    shown = [
        cell
        for cell in matching(cells, parameter=quantity.name)
        if cell.values and cell.environment in environments
    ]
    dots = [against(cell.values, cell.reference) for cell in shown]
    values = np.concatenate([[centre], *dots, *bars])
    log = rows[0].family == "lognormal" and relative and bool((values > 0).all())
    left, right = _ends(values, log=log)
    tops = -(len(lines) + _GAP) * np.arange(len(environments))
    ax.axvline(centre, linewidth=_REFERENCE_WIDTH, **REFERENCE)
    for cell, x in zip(shown, dots, strict=True):
        ax.plot(
            x,
            np.full(len(x), tops[environments.index(cell.environment)]),
            ".",
            color=COLOURS["quiet"],
            markersize=3.4,
            label=f"one {words.subject}",
        )
    for row, (lower, upper, estimate) in zip(rows, bars, strict=True):
        draw_interval(
            ax,
            tops[environments.index(row.environment)] - 1 - lines.index((row.kind, row.method)),
            np.clip([lower, upper], left, right),
            estimate if row.kind == "mean" else None,
            row.method,
            width=_THICKNESS[row.kind],
        )
    method_legend(ax, rows)
    names = {
        "mean": f"average {words.user}",
        "user": f"next {words.user}",
        "share": f"share of {words.users}",
    }
    for kind in present(KINDS, rows, "kind"):
        ax.plot(
            [],
            [],
            color=COLOURS["quiet"],
            linewidth=_THICKNESS[kind],
            label=names[kind],
        )
    ax.set_xlim(left, right)
    if log:
        log_scale(ax, "x", plain=True)
    ax.set_yticks(tops - len(lines) / 2, shortened(environments, _MOST_LETTERS))
    ax.set_ylim(tops[-1] - len(lines) - _GAP / 2, _GAP / 2)
    ax.set_xlabel(_against_label(quantity.words, quantity, quantity.unit, relative=relative))
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def _against_label(label: str, quantity: Quantity, unit: str, *, relative: bool) -> str:
    """Name an axis of values divided by their reference, or less the reference."""
    if relative:
        return f"{label} / reference"
    return label + (" − reference" if quantity.is_matched else "") + bracketed(unit)


def _ends(values: FloatArray, *, log: bool) -> tuple[float, float]:
    """Return the ends of an axis that holds every finite value."""
    shown = values[np.isfinite(values)]
    if log:
        # Limits of two subjects may span a hundred decades.
        shown = np.clip(shown, 1.0 / _FARTHEST, _FARTHEST)
        room = (shown.max() / shown.min()) ** _ROOM
        return float(shown.min() / room), float(shown.max() * room)
    room = _ROOM * float(np.ptp(shown) or 1.0)
    return float(shown.min()) - room, float(shown.max()) + room


def overview_drawings(results: Results) -> list[Drawing]:
    """Return the figure of the foremost environments, a panel per quantity."""
    environments = foremost(results)
    if not environments:
        return []
    words = results.data.words
    kinds = present(("mean", "user"), results.intervals, "kind") or ["share"]
    shown = []
    for kind, method in product(kinds, METHODS):
        biases = biases_of(results, kind=kind, method=method)
        shown += [bias for bias in biases if bias.environment in environments]
    names = distinct(shown, "parameter")
    columns = min(2, len(names))

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(names), columns=columns)
        for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
            quantity = results.data.quantities[name]
            chosen = matching(shown, parameter=name)
            draw_intervals(ax, chosen, results.data.cells, quantity, words)
            ax.set_title(quantity.head, loc="left")
            ax.tick_params(axis="y", labelleft=index % columns == 0)
        legend(axes, ncols=3)

    lines = len({(bias.row.kind, bias.row.method) for bias in shown}) + _GAP
    height = _HEIGHT + _LINE_HEIGHT * lines * len(environments)
    return [
        Drawing(
            name="overview",
            title=f"What {words.users} {words.verb}",
            description=f"Dashed: the reference. {drawn_said(results)}".rstrip(),
            height=height * -(-len(names) // columns),
            draw=draw,
        )
    ]


def level_drawings(results: Results) -> list[Drawing]:
    """Return a figure per quantity and factor: what subjects set at each level, and the means."""
    words = results.data.words
    drawings = []
    for name, (parameter, factor) in level_figures(results).items():
        rows = matching(results.levels, parameter=parameter, factor=factor, environment=None)
        drawings.append(
            Drawing(
                name=name,
                title=f"{results.data.quantities[parameter].head} at the levels of {factor}",
                description=f"A {'line' if rows[0].within else 'point'} for each {words.subject},"
                f" and the average {words.user} beside. Dashed: the reference.",
                height=_LEVELS_HEIGHT,
                draw=partial(_draw_levels, rows=rows, results=results),
            )
        )
    return drawings


def _draw_levels(figure: Figure, rows: Sequence[LevelValues], results: Results) -> None:
    """Draw each subject's values over the levels, and the average user beside them."""
    (ax,) = panels(figure)
    drawn = rows[0]
    quantity = results.data.quantities[drawn.parameter]
    means = matching(
        results.contrast, parameter=drawn.parameter, factor=drawn.factor, of="level", kind="mean"
    )
    scale, unit = unit_of(means[0], results)
    values = scale * np.array([row.values for row in rows], dtype=float)
    for (name, members), colour in zip(_groups(drawn, results).items(), cycle(_GROUP_COLOURS)):
        _draw_subjects(ax, values[:, members], name, colour, within=drawn.within)
    levels = [row.level for row in rows]
    for row in means:
        place = levels.index(row.second) + _BESIDE[row.method]
        limits = [scale * row.lower, scale * row.upper]
        draw_interval(ax, place, limits, scale * row.estimate, row.method, upright=True)
    method_legend(ax, means)
    log = is_ratio(means[0])
    if log:
        log_scale(ax, "y", plain=True)
    ax.set_ylabel(_against_label(quantity.label, quantity, unit, relative=log))
    ax.set_xticks(range(len(levels)), shortened(levels, max(4, _LEVELS_LETTERS // len(levels))))
    ax.set_xlim(-_END, len(levels) - 1 + _END)
    ax.set_xlabel(drawn.factor)
    ax.grid(visible=False, axis="x")
    if quantity.is_matched:
        ax.axhline(float(log), linewidth=_REFERENCE_WIDTH, **REFERENCE)
    legend([ax])


def _groups(drawn: LevelValues, results: Results) -> dict[str, NDArray[np.bool_]]:
    """Return the subjects of each level of the first factor between groups, else all of them."""
    others = matching(results.levels, parameter=drawn.parameter, environment=None, within=False)
    first = others[0].factor if others else drawn.factor
    groups = [] if first == drawn.factor else matching(others, factor=first)
    if len(groups) < 2:
        return {f"one {results.data.words.subject}": np.ones(len(drawn.values), dtype=bool)}
    return {row.level: np.array([one is not None for one in row.values]) for row in groups}


def _draw_subjects(ax: Axes, values: FloatArray, name: str, colour: str, *, within: bool) -> None:
    """Join each subject's values over the levels; groups stand side by side as points."""
    count, subjects = values.shape
    spread = np.zeros(subjects) if within else np.linspace(-_SPREAD, _SPREAD, subjects)
    # A subject per row, and a gap after it. One path: a line for each of hundreds of subjects makes
    # a page of megabytes.
    x = np.arange(count + 1) + spread[:, None]
    y = np.pad(values.T, ((0, 0), (0, 1)), constant_values=np.nan)
    ax.plot(
        x.ravel(),
        y.ravel(),
        linewidth=0.6 if within else 0.0,
        marker=".",
        markersize=3.0,
        color=COLOURS[colour],
        label=name,
    )
