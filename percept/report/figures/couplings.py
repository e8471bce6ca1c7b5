"""Couplings: what the device renders in time, Eq. 10, and maps of what feels real."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.inference.record import percent
from percept.report.biases import drawn_said, foremost
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    legend,
    log_scale,
    panels,
    shortened,
)
from percept.report.figures.curves import draw_stability
from percept.report.select import METHOD_NAMES
from percept.results import (
    Coupling,
    EnvironmentCouplings,
    Results,
    ZWidth,
)

#: Probabilities from which on the map is a shade darker; the decision is one more.
SHADES = (0.05, 0.25, 0.5, 0.75)
#: Opacity of one shade: they add up where one lies on another.
_SHADE_ALPHA = 0.16
_LIKELY = 0.5  # the probability of the dashed line
_KILO = 1e3  # N/m in kN/m
_ROOM = 1.3  # factor on what a logarithmic axis has to show
_LINEAR_ROOM = 1.05
_LEAST_SPAN = 10.0  # of a logarithmic axis
_FILL_ALPHA = 0.15
_MIDDLE = 0.5  # of the axes
_MOST_COLUMNS = 2  # panels side by side
_TITLE = 26  # letters
_PANEL_HEIGHT = 46.0  # mm, with its labels
_LEGEND_HEIGHT = 12.0  # mm


def draw_couplings(
    ax: Axes,
    couplings: EnvironmentCouplings,
    *,
    decision: float,
    used: tuple[float, float] | None = None,
) -> None:
    """Draw how probably couplings that can be rendered feel real, by stiffness and damping.

    Parameters
    ----------
    ax : Axes
        To draw on; its stiffness becomes logarithmic.
    couplings : EnvironmentCouplings
        The map, and its ends.
    decision : float
        Probability from which a coupling feels real.
    used : tuple of float, optional
        Stiffness (N/m) and damping (N·s/m) of the coupling in use, which the axes then hold.
    """
    stiffness = couplings.stiffness / _KILO
    lines = np.broadcast_to(couplings.damping[:, None], stiffness.shape)
    probability = couplings.probability
    colour = COLOURS["coupled"]
    if couplings.limited:
        ax.plot(
            stiffness[:, -1], couplings.damping, color=COLOURS["quiet"], linewidth=0.8,
            label="edge of what can be rendered",
        )  # fmt: skip
    for least in (*SHADES, decision):
        if probability.max() > least:
            ax.contourf(
                stiffness, lines, probability, levels=[least, 1.1], colors=[colour],
                alpha=_SHADE_ALPHA,
            )  # fmt: skip
    for least, dashes in ((_LIKELY, (0, (3, 2))), (decision, "solid")):
        # A line of the legend also where this map has none.
        ax.plot(
            [], [], label=f"{percent(least)} probability", color=colour, linestyle=dashes,
            linewidth=0.9,
        )  # fmt: skip
        if probability.min() < least < probability.max():
            ax.contour(
                stiffness, lines, probability, levels=[least], colors=[colour], linestyles=[dashes],
                linewidths=0.9,
            )  # fmt: skip
    for end in (couplings.stiffest, couplings.softest):
        if end is not None:
            ax.plot(
                [end.stiffness / _KILO], [end.damping], "o", markersize=3.5, color=colour,
                label="stiffest and softest that feel real",
            )  # fmt: skip
    ends = [float(stiffness.min()), float(stiffness.max())]
    top = float(couplings.damping[-1])
    if used is not None:
        own = used[0] / _KILO
        label = "coupling in use"
        ax.plot([own], [used[1]], "X", markersize=5, color=COLOURS["warn"], label=label)
        ends += [own / _ROOM, own * _ROOM]
        top = max(top, used[1])
    ax.set_xlim(min(ends), max(ends))
    log_scale(ax, "x", plain=True)
    ax.set_ylim(0.0, _LINEAR_ROOM * top)
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


def design_drawings(results: Results) -> list[Drawing]:
    """Return the maps of environments for which some coupling surely feels real."""
    design = results.design
    shown = (*foremost(results), None)  # All together come last
    regions = []
    for region in design.environments if design else ():
        if region.outcome == "some" and region.name in shown:
            regions.append(region)
    if design is None or not regions:
        return []
    columns = min(len(regions), _MOST_COLUMNS)
    coupling = results.provenance.scene.get("coupling")
    used = (coupling["stiffness"], coupling["damping"]) if coupling else None

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(regions), columns=columns)
        titles = shortened([region.name or "all together" for region in regions], _TITLE)
        for ax, region, title in zip(axes, regions, titles, strict=True):
            draw_couplings(ax, region, decision=design.decision, used=used)
            ax.set_title(title)
        legend(axes, ncols=2)

    shades = ", ".join(f"{100 * shade:.0f}" for shade in SHADES)
    return [
        Drawing(
            name="design",
            title="Couplings by the probability that they feel real",
            description="Left of the edge this device renders the"
            f" {results.data.words.environment} with every hand. The darker, the more probably it"
            f" feels real ({METHOD_NAMES[design.method]}): shades begin at {shades} and"
            f" {percent(design.decision)}. The cross is the coupling in use."
            f" {drawn_said(results)}".rstrip(),
            height=_LEGEND_HEIGHT + _PANEL_HEIGHT * -(-len(regions) // columns),
            draw=draw,
        )
    ]


def draw_zwidth(ax: Axes, width: ZWidth) -> None:
    """Draw the region of stiffness and damping, and the references as points.

    Parameters
    ----------
    ax : Axes
        To draw on; it becomes logarithmic beside references, which lie decades apart.
    width : ZWidth
        What is drawn. Its edge is known. The axes hold every reference.
    """
    assert width.edge is not None
    walls = [wall for wall in width.references if wall.stiffness > 0 and wall.damping > 0]
    right = _LINEAR_ROOM * width.edge.stiffest / _KILO or 1.0
    top = _LINEAR_ROOM * width.edge.most_damping or 1.0
    left, bottom = 0.0, 0.0
    if walls:
        right = max(right, _ROOM * max(wall.stiffness for wall in walls) / _KILO)
        top = max(top, _ROOM * max(wall.damping for wall in walls))
        left = min(min(wall.stiffness for wall in walls) / _KILO / _ROOM, right / _LEAST_SPAN)
        bottom = min(min(wall.damping for wall in walls) / _ROOM, top / _LEAST_SPAN)
    stiffness = np.maximum(width.edge.stiffness / _KILO, left)
    colour = COLOURS["coupled"]
    # Down to both axes.
    corners = (np.append(stiffness, left), np.append(width.edge.damping, 0.0))
    ax.fill(*corners, color=colour, alpha=_FILL_ALPHA, linewidth=0)
    ax.plot(stiffness, width.edge.damping, color=colour, label="rendered with every hand")
    if width.likely is not None:
        ax.plot(
            np.maximum(width.likely.stiffness / _KILO, left), width.likely.damping,
            color=COLOURS["ink"], linestyle="--", linewidth=0.8,
            label="rendered by 95 % of likely devices",
        )  # fmt: skip
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    if walls:
        log_scale(ax, plain=True)
    for wall in walls or width.references:
        place = (wall.stiffness / _KILO, wall.damping)
        ax.plot(*place, "o", markersize=3, color=COLOURS["ink"])
        # On the side that has room.
        across, _ = (ax.transData - ax.transAxes).transform(place)
        side = "left" if across < _MIDDLE else "right"
        ax.annotate(
            wall.environment, place, xytext=(4 if side == "left" else -4, 3), ha=side,
            textcoords="offset points",
        )  # fmt: skip
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


def stability_drawings(width: ZWidth | None, coupling: Coupling | None) -> list[Drawing]:
    """Return what the device renders in time, and Eq. 10 beside it where there is a coupling."""
    in_time = width if width is not None and width.edge is not None else None
    by_paper = coupling if coupling is not None and len(coupling.bound) else None
    if in_time is None and by_paper is None:
        return []

    def draw(figure: Figure) -> None:
        axes = panels(figure, (in_time is not None) + (by_paper is not None), columns=1)
        if in_time is not None:
            draw_zwidth(axes[0], in_time)
            axes[0].set_title("in time")
        if by_paper is not None:
            lines = {"this coupling": (by_paper.admittance, by_paper.eq10_omega)}
            draw_stability(axes[-1], by_paper.omega, by_paper.bound, lines)
            axes[-1].set_title("by Eq. 10 of the paper")
        legend(axes, ncols=1)

    said = []
    if in_time is not None:
        said.append(
            "In time: inside the edge no passive hand makes the motion grow, for walls rendered"
            " directly and for couplings with a rigid wall behind them."
        )
        if in_time.references:
            said.append("Points are the references.")
    if by_paper is not None:
        said.append("By Eq. 10 the real part of 1/Z_c has to stay above the lower bound.")
    two = in_time is not None and by_paper is not None
    return [
        Drawing(
            name="stability",
            title="What the device renders with every hand"
            + (", in time and by Eq. 10" if two else ""),
            description=" ".join(said),
            height=2.0 * _LEGEND_HEIGHT + _PANEL_HEIGHT * (2 if two else 1),
            draw=draw,
        )
    ]
