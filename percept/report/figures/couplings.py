"""Couplings: what the device renders in time, Eq. 10, and maps of what feels real."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.inference.record import percent
from percept.report.basics import METHOD_NAMES, matching
from percept.report.biases import drawn_said
from percept.report.figures.canvas import (
    COLOURS,
    LEGEND_HEIGHT,
    Drawing,
    draw_panels,
    legend,
    log_scale,
    panels,
    panels_height,
)
from percept.results import (
    Coupling,
    EnvironmentCouplings,
    Results,
    ZWidth,
)

#: Probabilities from which on the map is a shade darker; the decision is one more.
_SHADES = (0.05, 0.25, 0.5, 0.75)
#: Opacity by which one shade is darker than the one before.
_SHADE_ALPHA = 0.12
_KILO = 1e3  # N/m in kN/m
_ROOM = 1.3  # factor on what a logarithmic axis has to show
_LEAST_SPAN = 10.0  # of a logarithmic axis
_FILL_ALPHA = 0.15
_MOST_WIDE = 4  # panels two side by side; more stand three by three


def draw_couplings(
    ax: Axes,
    couplings: EnvironmentCouplings,
    *,
    decision: float,
    used: Coupling | None,
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
    used : Coupling or None
        The coupling in use, which the axes then hold.
    """
    stiffness = couplings.stiffness / _KILO
    lines = np.broadcast_to(couplings.damping[:, None], stiffness.shape)
    probability = couplings.probability
    shown = (stiffness, lines, probability)
    colour = COLOURS["coupled"]
    if couplings.limited:
        ax.plot(
            stiffness[:, -1],
            couplings.damping,
            color=COLOURS["quiet"],
            linewidth=0.8,
            label="edge of what can be rendered",
        )
    levels = sorted({*_SHADES, decision})
    colours = [(colour, _SHADE_ALPHA * (index + 1)) for index in range(len(levels))]
    ax.contourf(*shown, levels=[*levels, 1.1], colors=colours)
    # A line of the legend also where this map has none.
    ax.plot([], [], label=f"{percent(decision)} probability", color=colour, linewidth=0.9)
    if probability.min() < decision < probability.max():
        ax.contour(*shown, levels=[decision], colors=[colour], linewidths=0.9)
    for end in (couplings.stiffest, couplings.softest):
        if end is not None:
            label = "stiffest and softest that feel real"
            place = (end.stiffness / _KILO, end.damping)
            ax.plot(*place, "o", markersize=3.5, color=colour, label=label)
    if used is not None:
        place = (used.stiffness / _KILO, used.damping)
        ax.plot(*place, "X", markersize=5, color=COLOURS["warn"], label="coupling in use")
    ax.set_xscale("log")
    ax.autoscale()
    log_scale(ax, "x", plain=True)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


def design_drawings(results: Results) -> list[Drawing]:
    """Return the maps of environments for which some coupling surely feels real."""
    design = results.design
    maps = matching(design.environments if design else (), outcome="some")
    if design is None or not maps:
        return []
    decision = design.decision
    names = [one.name for one in maps]
    columns = min(len(maps), 2 if len(maps) <= _MOST_WIDE else 3)

    def draw_one(ax: Axes, index: int) -> None:
        draw_couplings(ax, maps[index], decision=decision, used=results.coupling)

    shades = ", ".join(f"{100 * shade:.0f}" for shade in _SHADES)
    return [
        Drawing(
            name="design",
            title="Couplings by the probability that they feel real",
            description="Left of the edge this device renders the"
            f" {results.data.words.environment} with every hand. The darker, the more probably it"
            f" feels real ({METHOD_NAMES[design.method]}): shades begin at {shades} and"
            f" {percent(decision)}. {drawn_said(results)}".rstrip(),
            height=panels_height(len(maps), columns),
            draw=lambda figure: draw_panels(figure, names, columns, draw_one),
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
    left, right = _ends([wall.stiffness / _KILO for wall in walls], width.edge.stiffest / _KILO)
    bottom, top = _ends([wall.damping for wall in walls], width.edge.most_damping)
    edges = (
        (width.edge, "coupled", "-", "rendered with every hand"),
        (width.likely, "ink", "--", "rendered by 95 % of likely devices"),
    )
    for edge, name, dashes, label in edges:
        if edge is not None:
            shown = (edge.stiffness / _KILO, edge.damping)
            ax.plot(*shown, color=COLOURS[name], linestyle=dashes, label=label)
    ax.fill_between(
        width.edge.stiffness / _KILO,
        width.edge.damping,
        color=COLOURS["coupled"],
        alpha=_FILL_ALPHA,
        linewidth=0,
    )
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    if walls:
        log_scale(ax, plain=True)
    for wall in walls or width.references:
        place = (wall.stiffness / _KILO, wall.damping)
        ax.plot(*place, "o", markersize=3, color=COLOURS["ink"])
        ax.annotate(wall.environment, place, xytext=(4, 3), textcoords="offset points")
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


def _ends(sizes: Sequence[float], edge: float) -> tuple[float, float]:
    """Return the ends of an axis that holds an edge and sizes; without sizes it starts at zero."""
    top = _ROOM * max(edge, *sizes, 0.0) or 1.0
    return (min(*sizes, top / _LEAST_SPAN) / _ROOM if sizes else 0.0), top


def draw_stability(ax: Axes, coupling: Coupling) -> None:
    """Draw the bound of Eq. 10, and the coupling that has to stay above it, with where it binds.

    Parameters
    ----------
    ax : Axes
        To draw on; both axes become logarithmic.
    coupling : Coupling
        Its bound is positive somewhere.
    """
    omega = coupling.omega
    # What is zero or infinite has no logarithm.
    bound = np.where((coupling.bound > 0) & np.isfinite(coupling.bound), coupling.bound, np.nan)
    ax.plot(omega, bound, color=COLOURS["ink"], label="lower bound (Eq. 10)")
    binding = coupling.eq10_omega
    label = f"this coupling: {coupling.eq10_margin:.3g} × bound at {binding:.4g} rad/s"
    colour = COLOURS["classical"]
    ax.plot(omega, coupling.admittance, color=colour, linestyle="--", label=label)
    if omega[0] <= binding <= omega[-1]:
        reached = np.interp(binding, omega, coupling.admittance)
        ax.plot(binding, reached, "o", markersize=5, color=colour)
    log_scale(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("admittance, real part (m/(N·s))")


def stability_drawings(width: ZWidth | None, coupling: Coupling | None) -> list[Drawing]:
    """Return what the device renders in time, and Eq. 10 beside it where there is a coupling."""
    panel: dict[str, Callable[[Axes], None]] = {}
    said = []
    title = "What the device renders with every hand"
    if width is not None and width.edge is not None:
        panel["in time"] = partial(draw_zwidth, width=width)
        said.append(
            "In time: inside the edge no passive hand makes the motion grow, for walls rendered"
            " directly and for couplings with a rigid wall behind them."
        )
        if width.references:
            said.append("Points are the references.")
    if coupling is not None and len(coupling.bound):
        panel["by Eq. 10 of the paper"] = partial(draw_stability, coupling=coupling)
        said.append("By Eq. 10 the real part of 1/Z_c has to stay above the lower bound.")
    if not panel:
        return []

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(panel), columns=1)
        for ax, (name, draw_one) in zip(axes, panel.items(), strict=True):
            draw_one(ax)
            ax.set_title(name)
        legend(axes, ncols=1)

    return [
        Drawing(
            name="stability",
            title=title + (", in time and by Eq. 10" if len(panel) > 1 else ""),
            description=" ".join(said),
            height=LEGEND_HEIGHT + panels_height(len(panel)),
            draw=draw,
        )
    ]
