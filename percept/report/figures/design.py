"""Couplings that qualify, in the plane of stiffness and damping."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, Axes, shade_boxes

FloatArray = NDArray[np.float64]
Place = tuple[float, float]
#: The axes show so many times what qualifies at most.
_BEYOND = 4.0


def draw_design(
    ax: Axes,
    damping: FloatArray,
    intervals: Sequence[FloatArray],
    *,
    stable: tuple[FloatArray, FloatArray] | None = None,
    coupling: tuple[float, float] | None = None,
) -> None:
    """Draw the couplings that are stable and stay inside a boundary."""
    if stable is not None:
        ax.plot(
            *(np.append(side, side[0]) for side in (stable[0] / 1e3, stable[1])),
            color=COLOURS["quiet"],
            linewidth=0.8,
            label="edge of the stable region",
        )
    # One bar per line of b_c, up to half way to its neighbours; unlike a polygon, bars may split and join.
    edges = np.concatenate([damping[:1], (damping[1:] + damping[:-1]) / 2, damping[-1:]])
    bars = [
        (low / 1e3, high / 1e3, edges[line], edges[line + 1])
        for line, parts in enumerate(intervals)
        for low, high in parts
    ]
    if bars:
        shade_boxes(
            ax,
            np.array(bars),
            color=COLOURS["coupled"],
            alpha=0.35,
            label="stable and inside the boundary",
        )
    else:
        ax.text(0.5, 0.5, "none qualifies", ha="center", color=COLOURS["quiet"], transform=ax.transAxes)
    marks = [(coupling[0] / 1e3, coupling[1])] if coupling is not None else []
    edge = [(float(stable[0].max()) / 1e3, float(stable[1].max()))] if stable is not None else []
    right, top = _reach(bars, [*marks, *edge])
    for stiffness, height in marks:
        at = (min(stiffness, right), min(height, top))
        ax.plot(
            *([place] for place in at),
            marker="X",
            markersize=5,
            linestyle="none",
            color=COLOURS["warn"],
            clip_on=False,
            label="coupling in use",
        )
        if at != (stiffness, height):
            said = f"at {stiffness:.4g} kN/m,\n{height:.4g} N·s/m"
            ax.annotate(
                said, at, xytext=(-6, -4), textcoords="offset points", ha="right", va="top", fontsize=6
            )
    ax.set_xlim(0, right)
    ax.set_ylim(0, top)
    ax.set_xlabel("coupling stiffness (kN/m)")


def _reach(bars: Sequence[tuple[float, float, float, float]], marks: Sequence[Place]) -> Place:
    """Where the axes end: behind what qualifies, and behind what is marked unless that is far out."""
    right, top = (
        _end([bar[side + 2 if side else 1] for bar in bars], [mark[side] for mark in marks])
        for side in (0, 1)
    )
    return right, top


def _end(qualifying: Sequence[float], marked: Sequence[float]) -> float:
    most = max(qualifying, default=0.0)
    shown = [min(value, _BEYOND * most) for value in marked] if most else marked
    return 1.05 * max([most, *shown], default=1.0) or 1.0
