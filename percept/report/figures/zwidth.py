"""The figure of what a device renders with every passive hand."""

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
    """Draw the region of stiffness and damping, and the references as points.

    Parameters
    ----------
    ax : Axes
        To draw on; it becomes logarithmic beside references, which lie decades apart.
    width : ZWidth
        What is drawn. Its edge is known. References beyond it stand at the border.
    """
    assert width.edge is not None
    right = _ROOM * width.edge.stiffest / _KILO or 1.0
    top = _ROOM * width.edge.most_damping or 1.0
    left, bottom = _lower_ends(width, right, top)
    _draw_edge(ax, width.edge, left)
    if width.likely is not None:
        ax.plot(
            np.maximum(width.likely.stiffness / _KILO, left), width.likely.damping,
            color=COLOURS["ink"], linestyle="--", linewidth=0.8,
            label="rendered by 95 % of likely devices",
        )  # fmt: skip
    if left:
        log_scale(ax, plain=True)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    places: dict[tuple[float, float], list[str]] = {}
    for wall in width.references:
        x = float(np.clip(wall.stiffness / _KILO, left, right))
        y = float(np.clip(wall.damping, bottom, top))
        places.setdefault((x, y), []).append(wall.environment)
    for place, names in places.items():
        ax.plot(*place, "o", markersize=3, color=COLOURS["ink"], clip_on=False)
        side = "right" if place[0] == right else "left"
        ax.annotate(
            ", ".join(names), place, xytext=(-3 if side == "right" else 3, 3), ha=side,
            textcoords="offset points",
        )  # fmt: skip
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


def _draw_edge(ax: Axes, edge: RenderedEdge, left: float) -> None:
    """Fill the region down to both axes."""
    stiffness = np.maximum(edge.stiffness / _KILO, left)
    colour = COLOURS["coupled"]
    corner_stiffness = np.append(stiffness, left)
    corner_damping = np.append(edge.damping, 0.0)
    ax.fill(corner_stiffness, corner_damping, color=colour, alpha=_FILL_ALPHA, linewidth=0)
    ax.plot(stiffness, edge.damping, color=colour, label="rendered with every passive hand")


def zwidth_drawings(width: ZWidth | None) -> list[Drawing]:
    """Return the Z-width of the device."""
    if width is None or width.edge is None:
        return []

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=16, right=14, top=4, bottom=21))
        draw_zwidth(ax, width)
        legend(ax)

    said = (
        "Inside the edge no passive hand makes the motion grow, in time. The edge holds for walls"
        " rendered directly, and for couplings with a rigid wall behind them."
    )
    if width.references:
        said += " Points are the references; those beyond stand at the border."
    return [
        Drawing(
            name="zwidth",
            title="Stiffness and damping that the device renders with every passive hand",
            description=said,
            size=_SIZE,
            draw=draw,
        )
    ]
