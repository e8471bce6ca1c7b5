"""The figures of boundaries over the angular frequency, from records to drawings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.figures.canvas import (
    WIDE,
    Drawing,
    Frame,
    legend,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.curves import Limits, draw_magnitude, draw_ratio, ratio_range
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    choice_said,
    chosen,
    distinct,
    each_by_itself,
    families_of,
    first,
    kind_names,
    matching,
    words_of,
)
from percept.results import Boundary, Results

__all__ = ["boundary_drawings", "like_limits"]

FloatArray = NDArray[np.float64]
#: Boundaries by environment.
_Panels = Mapping[str, Sequence[Boundary]]

_WHOM = {
    "mean": "the average {0.user}",
    "user": "the next {0.user}",
    "share": "a share of all {0.users}",
}
#: The next user's boundary is what the paper's rule asks about.
_SHOWN_FIRST = ("user", "mean", "share")
#: Shapes that both methods have, the exact one first.
_SHAPES = ("envelope", "pointwise")
_MOST_COLUMNS = 5  # panels side by side
_FEWEST_COLUMNS = 3
_PANEL_HEIGHT = 42.0  # mm, with its labels
_LEGEND_HEIGHT = 15.0  # mm
_STRIP_HEIGHT = 15.5  # mm
_STRIP_LEGEND = 21.0  # mm, with the heads of the columns
_STRIP_TITLE = 14.0  # mm, width
_LABELS = 17.0  # mm, of the left axis and the right edge


def boundary_drawings(results: Results) -> list[Drawing]:
    """Return boundaries over ω, limits over the reference, and the scene's close views."""
    every = _by_environment(results.boundaries)
    if not every:
        return []
    drawn = {name: every[name] for name in chosen(list(every))}
    kinds = {boundary.kind for boundary in results.boundaries}
    kind = next(kind for kind in _SHOWN_FIRST if kind in kinds)
    left_out = choice_said(list(every), words_of(results).environments)
    drawings = [_magnitudes(results, drawn, kind), _ratios(results, drawn)]
    drawings = [replace(one, description=one.description + left_out) for one in drawings]
    close = _by_environment(matching(results.close, kind=kind))
    if close:
        near = {name: close[name] for name in chosen(list(close))}
        drawings.append(_magnitudes(results, near, kind, close=True))
    return drawings


def _by_environment(boundaries: Sequence[Boundary]) -> dict[str, list[Boundary]]:
    """Group the boundaries of the main account."""
    main = [boundary for boundary in boundaries if each_by_itself(boundary)]
    return {name: matching(main, environment=name) for name in distinct(main, "environment")}


def _magnitudes(
    results: Results, boundaries: _Panels, kind: str, *, close: bool = False
) -> Drawing:
    """Draw the boundary of each environment in a panel of its own.

    All share their axes; close views, of the windows that the scene asks for, have axes of their
    own.
    """
    columns = min(max(len(boundaries), _FEWEST_COLUMNS), _MOST_COLUMNS)
    gap = 12.0 if close else 6.0
    line = 14.0 if close else 8.0

    def draw(figure: Figure) -> None:
        frame = Frame(bottom=17, gap=gap, line=line)
        axes = panels(figure, len(boundaries), columns=columns, frame=frame)
        _draw_panels(axes, results, boundaries, kind, columns=columns, gap=gap, log=not close)
        if not close:
            ends = np.array([ax.get_ylim() for ax in axes])
            for ax in axes:
                ax.set_ylim(ends.min(), ends.max())
            outer_labels(axes, columns)
        _label_left(axes, columns)
        legend(axes[0], ncols=4)

    title = f"Boundaries of |Z_h| for {_WHOM[kind].format(words_of(results))}"
    return Drawing(
        name="boundaries_close" if close else "boundaries",
        title=f"{title}, close views" if close else title,
        description=_said(results, boundaries, kind),
        size=_panel_size(boundaries, columns),
        draw=draw,
    )


def _draw_panels(
    axes: Sequence[Axes],
    results: Results,
    boundaries: _Panels,
    kind: str,
    *,
    columns: int,
    gap: float,
    log: bool,
) -> None:
    """Draw the boundaries of one kind, an environment a panel."""
    families = families_of(results)
    titles = row_labels(list(boundaries), most=(WIDE - _LABELS) / columns - gap)
    for ax, title, of_environment in zip(axes, titles, boundaries.values(), strict=True):
        shown = of_environment[0]
        limits = like_limits(of_environment, kind, families)
        draw_magnitude(ax, shown.omega, limits, shown.reference, shown.coupled, log=log)
        ax.set_title(title, loc="left")


def _label_left(axes: Sequence[Axes], columns: int) -> None:
    """Label the magnitude at the left panels alone."""
    for index, ax in enumerate(axes):
        ax.set_ylabel("" if index % columns else "|Zₕ| (N·s/m)")


def _panel_size(boundaries: _Panels, columns: int) -> tuple[float, float]:
    rows = -(-len(boundaries) // columns)
    return WIDE, _LEGEND_HEIGHT + _PANEL_HEIGHT * rows


def _said(results: Results, boundaries: _Panels, kind: str) -> str:
    """Say what the limits and the lines are."""
    limits: list[Limits] = []
    for of_environment in boundaries.values():
        limits += like_limits(of_environment, kind, families_of(results))
    shape = limits[0].label.partition(", ")[2]
    said = (
        f"What {_WHOM[kind].format(words_of(results))} takes for the reference lies between the"
        f" limits ({shape})."
        " Dashed: the reference."
    )
    if _any_coupled(boundaries):
        said += " Dotted: the reference through the coupling."
    return said


def _any_coupled(boundaries: _Panels) -> bool:
    """Say whether some reference is drawn through a coupling."""
    return any(
        boundary.coupled is not None
        for of_environment in boundaries.values()
        for boundary in of_environment
    )


def _ratios(results: Results, boundaries: _Panels) -> Drawing:
    """Draw limits over the reference: a row of panels per environment, a column per kind."""
    families = families_of(results)
    cells: dict[tuple[str, str], list[Limits]] = {}
    for kind in KINDS:
        for name, of_environment in boundaries.items():
            limits = like_limits(of_environment, kind, families)
            if limits:
                cells[name, kind] = limits
    kinds = list(dict.fromkeys(kind for _, kind in cells))
    ends = ratio_range(list(cells.values()))

    def draw(figure: Figure) -> None:
        count = len(boundaries) * len(kinds)
        axes = panels(
            figure, count, columns=len(kinds), frame=Frame(left=20, bottom=17, gap=6, line=2.5)
        )
        names = row_labels(list(boundaries), most=_STRIP_TITLE)
        remaining = iter(axes)
        for row, (name, of_environment) in enumerate(boundaries.items()):
            shown = of_environment[0]
            for kind in kinds:
                ax = next(remaining)
                limits = cells.get((name, kind), [])
                draw_ratio(ax, shown.omega, limits, shown.reference, shown.coupled, ends)
                ax.set_ylabel(names[row])
                if row == 0:
                    ax.set_title(f"{kind}: {kind_names(results.data.words)[kind]}", loc="left")
        outer_labels(axes, len(kinds))
        legend(axes[0], ncols=4)

    dotted = "; dotted: the reference through the coupling" if _any_coupled(boundaries) else ""
    return Drawing(
        name="ratios",
        title="Limits divided by the reference’s |Z_h|",
        description="One family and one shape for each kind. Dashed, at 1: the reference"
        f"{dotted}. An arrow with a value marks a curve that leaves the axis.",
        size=(WIDE, _STRIP_LEGEND + _STRIP_HEIGHT * len(boundaries)),
        draw=draw,
    )


def like_limits(boundaries: Sequence[Boundary], kind: str, families: Sequence[str]) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape, the Bayesian first."""
    shapes = list(_SHAPES)
    if any(boundary.device_share is not None for boundary in boundaries):
        # An envelope leaves out what is not known of the device.
        shapes.reverse()
    for shape in shapes:
        candidates = matching(boundaries, kind=kind, shape=shape)
        limits: list[Limits] = []
        for method in reversed(METHODS):
            boundary = first(matching(candidates, method=method), family=families)
            if boundary is not None:
                limits.append(_limits(boundary))
        if limits:
            return limits
    return []


def _limits(boundary: Boundary) -> Limits:
    method = METHOD_NAMES[boundary.method]
    averaged = ", over devices" if boundary.device_share is not None else ""
    return Limits(
        label=f"{method}, {boundary.shape} ({boundary.family}){averaged}",
        method=boundary.method,
        omega=boundary.omega,
        lower=boundary.lower,
        upper=boundary.upper,
        reference=boundary.reference,
    )
