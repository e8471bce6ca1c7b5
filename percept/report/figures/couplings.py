"""Figures of couplings: the stability criterion over ω, and the map of those that qualify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import NDArray

from percept.haptics.design import MAP_ACCURACY
from percept.report.figures.canvas import (
    COLOURS,
    WIDE,
    Drawing,
    Frame,
    legend,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.curves import draw_stability
from percept.report.select import METHOD_NAMES, METHODS, choice_said, chosen, first, words_of
from percept.results import AdmissibleCouplings, Coupling, Results

__all__ = ["CouplingMarks", "design_drawings", "draw_design", "map_ends", "stability_drawings"]

FloatArray = NDArray[np.float64]
Segments = Sequence[FloatArray]  # Per line of coupling damping: (n, 2) intervals of stiffness, N/m

#: The axes of a map show at most this many times what qualifies.
_BEYOND = 4.0
_ROOM = 1.05  # factor on what an axis has to show
_KILO = 1e3  # N/m in kN/m
_MOST_COLUMNS = 6  # panels side by side
_FEWEST_COLUMNS = 3
_TITLE_WIDTH = 24.0  # mm
_PANEL_HEIGHT = 42.0  # mm, with its labels
_LEGEND_HEIGHT = 15.0  # mm
_STABILITY_SIZE = (120.0, 50.0)  # mm


@dataclass(frozen=True, eq=False)
class CouplingMarks:
    """What a map shows beside the couplings that qualify."""

    stable: tuple[FloatArray, FloatArray] | None = None  # Edge: stiffness, N/m, and damping, N·s/m
    coupling: tuple[float, float] | None = None  # In use: stiffness, N/m, and damping, N·s/m


def draw_design(
    ax: Axes,
    damping: FloatArray,
    intervals: Segments,
    marks: CouplingMarks,
    *,
    ends: tuple[float, float] | None = None,
) -> None:
    """Draw the couplings that are stable and stay inside a boundary, by stiffness and damping.

    Parameters
    ----------
    ax : Axes
        To draw on.
    damping : ndarray, shape (n,)
        Coupling damping of each line, N·s/m.
    intervals : sequence of ndarray, shape (m, 2)
        Per line, the intervals of stiffness that qualify, N/m.
    marks : CouplingMarks
        What else is drawn.
    ends : tuple of float, optional
        Ends of the axes, kN/m and N·s/m; behind what is drawn by default.
    """
    if marks.stable is not None:
        stiffness, edge_damping = marks.stable
        ax.plot(
            np.append(stiffness, stiffness[0]) / _KILO,
            np.append(edge_damping, edge_damping[0]),
            color=COLOURS["quiet"],
            linewidth=0.8,
            label="edge of the stable region",
        )
    boxes = _boxes(damping, intervals)
    if len(boxes):
        # left, right, bottom and top make the five corners of a closed box
        corners = boxes[:, [[0, 2], [1, 2], [1, 3], [0, 3], [0, 2]]]
        shade = PathPatch(
            Path.make_compound_path_from_polys(corners),
            color=COLOURS["coupled"],
            alpha=0.35,
            linewidth=0,
            antialiased=False,  # smoothed edges would leave a light line where boxes touch
            label="stable and inside the boundary",
        )
        # add_patch would look for the extent segment by segment; the ends are known.
        ax.add_artist(shade)
    else:
        quiet = COLOURS["quiet"]
        ax.text(0.5, 0.5, "none qualifies", ha="center", color=quiet, transform=ax.transAxes)
    right, top = ends or map_ends(damping, [intervals], marks)
    if marks.coupling is not None:
        _draw_coupling(ax, *marks.coupling, right=right, top=top)
    ax.set_xlim(0, right)
    ax.set_ylim(0, top)
    ax.set_xlabel("coupling stiffness (kN/m)")


def _draw_coupling(ax: Axes, stiffness: float, damping: float, *, right: float, top: float) -> None:
    """Mark the coupling in use; at the edge with its numbers where it lies beyond."""
    own = (stiffness / _KILO, damping)
    shown = (min(own[0], right), min(own[1], top))
    ax.plot(
        [shown[0]], [shown[1]], "X", markersize=5, color=COLOURS["warn"], label="coupling in use",
        clip_on=False,
    )  # fmt: skip
    if shown != own:
        text = f"at {own[0]:.4g} kN/m,\n{own[1]:.4g} N·s/m"
        ax.annotate(
            text, shown, xytext=(-6, -4), textcoords="offset points", ha="right", va="top",
            fontsize=6,
        )  # fmt: skip


def map_ends(
    damping: FloatArray, maps: Sequence[Segments], marks: CouplingMarks
) -> tuple[float, float]:
    """Return the ends of maps' axes: behind what qualifies, and behind marks that are near.

    Stiffness is in kN/m, damping in N·s/m.
    """
    boxes = np.concatenate([np.zeros((1, 4)), *(_boxes(damping, intervals) for intervals in maps)])
    qualifying = boxes[:, [1, 3]].max(axis=0)
    marked = np.zeros(2)
    if marks.coupling is not None:
        marked = np.array([marks.coupling[0] / _KILO, marks.coupling[1]])
    if marks.stable is not None:
        stiffness, edge_damping = marks.stable
        marked = np.maximum(marked, [stiffness.max() / _KILO, edge_damping.max()])
    if qualifying.all():
        marked = np.minimum(marked, _BEYOND * qualifying)
    right, top = _ROOM * np.maximum(qualifying, marked)
    return float(right or 1.0), float(top or 1.0)


def _boxes(damping: FloatArray, intervals: Segments) -> FloatArray:
    """Return left, right, bottom, top of a box per interval, half way to the next lines."""
    halfway = (damping[1:] + damping[:-1]) / 2
    edges = np.concatenate([damping[:1], halfway, damping[-1:]])
    boxes: list[tuple[float, float, float, float]] = []
    for line, segments in enumerate(intervals):
        for low, high in segments:
            boxes.append((low / _KILO, high / _KILO, edges[line], edges[line + 1]))
    return np.array(boxes, dtype=float).reshape(-1, 4)


def design_drawings(results: Results) -> list[Drawing]:
    """Return the map of couplings that qualify, by the Bayesian limits where there are any."""
    design = results.design
    if design is None:
        return []
    best = first(design.maps, method=METHODS[::-1])
    assert best is not None
    names = [region.name for region in best.environments if region.name is not None]
    drawn = {*chosen(names), None}
    regions = [region for region in best.environments if region.name in drawn]
    marks = _marks(results, design)
    columns = min(max(len(regions), _FEWEST_COLUMNS), _MOST_COLUMNS)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(regions), columns=columns, frame=Frame(bottom=17, gap=3, line=8))
        titles = row_labels(
            [region.name or "all together" for region in regions], most=_TITLE_WIDTH
        )
        maps = [
            [np.array(segments, dtype=float).reshape(-1, 2) for segments in region.intervals]
            for region in regions
        ]
        ends = map_ends(best.damping, maps, marks)
        for ax, segments, title in zip(axes, maps, titles, strict=True):
            draw_design(ax, best.damping, segments, marks, ends=ends)
            ax.set_title(title, loc="left")
            ax.set_xlabel("stiffness (kN/m)")
            ax.set_ylabel("damping (N·s/m)")
        outer_labels(axes, columns)
        legend(max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0])), ncols=3)

    said = (
        "Shaded: stable with this device, and by the paper’s rule inside the next"
        f" {words_of(results).user}’s boundary"
        f" ({METHOD_NAMES[best.method]}, {design.family}), by |Z_h| and by effective"
        f" stiffness and damping, at every ω, to {100 * MAP_ACCURACY:g} %."
    )
    if marks.stable is not None:
        said += " The line is the edge of what is stable."
    if marks.coupling is not None:
        said += " The cross is the coupling in use."
    rows = -(-len(regions) // columns)
    return [
        Drawing(
            name="design",
            title="Couplings that qualify, by stiffness and damping of the coupling",
            description=said + choice_said(names, words_of(results).environments),
            size=(WIDE, _LEGEND_HEIGHT + _PANEL_HEIGHT * rows),
            draw=draw,
        )
    ]


def _marks(results: Results, design: AdmissibleCouplings) -> CouplingMarks:
    """Return the edge of what is stable, and the scene's coupling."""
    edge = design.stable
    used = results.provenance.scene.get("coupling")
    return CouplingMarks(
        stable=None if edge is None else (edge.stiffness, edge.damping),
        coupling=None if used is None else (used["stiffness"], used["damping"]),
    )


def stability_drawings(coupling: Coupling | None) -> list[Drawing]:
    """Return the stability criterion over ω (Fig. 4)."""
    if coupling is None or not len(coupling.bound):
        return []

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18, top=3))
        lines = {"this coupling": (coupling.admittance, coupling.binding_omega)}
        draw_stability(ax, coupling.omega, coupling.bound, lines)

    return [
        Drawing(
            name="stability",
            title="Stability of the coupling over the angular frequency",
            description="The real part of the coupling’s admittance 1/Z_c has to stay above the"
            " lower bound.",
            size=_STABILITY_SIZE,
            draw=draw,
        )
    ]
