"""The figure of what a device renders stably: directly, and through a coupling."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.report.figures.canvas import COLOURS, Drawing, Frame, legend, log_scale, panels
from percept.results import RenderedEdge, ZWidth

__all__ = ["draw_zwidth", "zwidth_drawings"]

_KILO = 1e3  # N/m in kN/m
_ROOM = 1.05  # factor on what an axis has to show
_SIZE = (120.0, 70.0)  # mm
_FILL_ALPHA = 0.15
# Logarithmic axes begin at this fraction of the smallest reference, and span a decade or more.
_BELOW = 0.5
_LEAST_SPAN = 10.0


def draw_zwidth(ax: Axes, width: ZWidth) -> None:
    """Draw the regions of stiffness and damping, and the references as points.

    Parameters
    ----------
    ax : Axes
        To draw on; it becomes logarithmic beside references, which lie decades apart.
    width : ZWidth
        What is drawn. References beyond both edges stand at the border.
    """
    shown = [edge for edge in (width.direct, width.coupled) if edge is not None]
    right = _ROOM * max((edge.stiffest for edge in shown), default=0.0) / _KILO or 1.0
    top = _ROOM * max((edge.most_damping for edge in shown), default=0.0) or 1.0
    left, bottom = _lower_ends(width, right, top)
    if width.coupled is not None:
        _draw_edge(ax, width.coupled, left, COLOURS["coupled"], "a rigid wall through a coupling")
    if width.direct is not None:
        _draw_edge(ax, width.direct, left, COLOURS["classical"], "rendered directly")
    for likely in (width.likely_coupled, width.likely_direct):
        if likely is not None:
            ax.plot(
                np.maximum(likely.stiffness / _KILO, left), likely.damping,
                color=COLOURS["ink"], linestyle="--", linewidth=0.8,
                label="rendered by 95 % of likely devices",
            )  # fmt: skip
    if left:
        log_scale(ax, plain=True)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    for wall in width.references:
        x = np.clip(wall.stiffness / _KILO, left, right)
        y = np.clip(wall.damping, bottom, top)
        ax.plot([x], [y], "o", markersize=3, color=COLOURS["ink"], clip_on=False)
        ax.annotate(wall.environment, (x, y), xytext=(3, 3), textcoords="offset points")
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


def _lower_ends(width: ZWidth, right: float, top: float) -> tuple[float, float]:
    """Return where both axes begin: at zero, or below the references on logarithmic axes."""
    stiffness = [wall.stiffness / _KILO for wall in width.references if wall.stiffness > 0]
    damping = [wall.damping for wall in width.references if wall.damping > 0]
    if not stiffness or not damping:
        return 0.0, 0.0
    left = min(_BELOW * min(stiffness), right / _LEAST_SPAN)
    return left, min(_BELOW * min(damping), top / _LEAST_SPAN)


def _draw_edge(ax: Axes, edge: RenderedEdge, left: float, colour: str, label: str) -> None:
    """Fill a region down to both axes."""
    stiffness = np.append(edge.stiffness, 0.0) / _KILO
    damping = np.append(edge.damping, edge.damping[-1])
    stiffness = np.maximum(stiffness, left)
    ax.fill_betweenx(damping, left, stiffness, color=colour, alpha=_FILL_ALPHA, linewidth=0)
    ax.plot(stiffness, damping, color=colour, label=label)


def zwidth_drawings(width: ZWidth | None) -> list[Drawing]:
    """Return the Z-width of the device."""
    if width is None or width.direct is None:
        return []

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=16, right=14, top=4, bottom=21))
        draw_zwidth(ax, width)
        legend(ax)

    said = (
        "Inside the edges a wall is rendered stably with every passive hand. A coupling shows"
        " itself where the wall behind it is rigid."
    )
    if width.references:
        said += " Points are the references; those beyond stand at the border."
    return [
        Drawing(
            name="zwidth",
            title="Largest stiffness and damping that the device renders stably",
            description=said,
            size=_SIZE,
            draw=draw,
        )
    ]
