"""Couplings: what the device renders in time, Eq. 10, and maps of what feels real."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.inference.record import percent
from percept.report.basics import METHOD_NAMES
from percept.report.biases import drawn_said, foremost
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    legend,
    log_scale,
    panels,
    shortened,
)
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
_KILO = 1e3  # N/m in kN/m
_ROOM = 1.3  # factor on what a logarithmic axis has to show
_LINEAR_ROOM = 1.05
_LEAST_SPAN = 10.0  # of a logarithmic axis
_FILL_ALPHA = 0.15
_MIDDLE = 0.5  # of the axes
_MOST_WIDE = 4  # panels two side by side; more stand three by three
_TITLE = 26  # letters
_PANEL_HEIGHT = 40.0  # mm, with its labels
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
    shown = (stiffness, lines, couplings.probability)
    colour = COLOURS["coupled"]
    if couplings.limited:
        ax.plot(
            stiffness[:, -1], couplings.damping, color=COLOURS["quiet"], linewidth=0.8,
            label="edge of what can be rendered",
        )  # fmt: skip
    most = float(couplings.probability.max())
    for least in (*SHADES, decision):
        if most > least:
            ax.contourf(*shown, levels=[least, 1.1], colors=[colour], alpha=_SHADE_ALPHA)
    # A line of the legend also where this map has none.
    ax.plot([], [], label=f"{percent(decision)} probability", color=colour, linewidth=0.9)
    if couplings.probability.min() < decision < most:
        ax.contour(*shown, levels=[decision], colors=[colour], linewidths=0.9)
    for end in (couplings.stiffest, couplings.softest):
        if end is not None:
            label = "stiffest and softest that feel real"
            place = ([end.stiffness / _KILO], [end.damping])
            ax.plot(*place, "o", markersize=3.5, color=colour, label=label)
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
    columns = min(len(regions), 2 if len(regions) <= _MOST_WIDE else 3)
    coupling = results.provenance.scene.get("coupling")
    used = (coupling["stiffness"], coupling["damping"]) if coupling else None

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(regions), columns=columns)
        titles = shortened([region.name or "together" for region in regions], _TITLE)
        for index, (ax, region) in enumerate(zip(axes, regions, strict=True)):
            draw_couplings(ax, region, decision=design.decision, used=used)
            ax.set_title(titles[index])
            if index % columns:
                ax.set_ylabel("")
            if index < len(regions) - columns:
                ax.set_xlabel("")
        legend(axes, ncols=2)

    shades = ", ".join(f"{100 * shade:.0f}" for shade in SHADES)
    return [
        Drawing(
            name="design",
            title="Couplings by the probability that they feel real",
            description="Left of the edge this device renders the"
            f" {results.data.words.environment} with every hand. The darker, the more probably it"
            f" feels real ({METHOD_NAMES[design.method]}): shades begin at {shades} and"
            f" {percent(design.decision)}. {drawn_said(results)}".rstrip(),
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
        stiffness = [wall.stiffness / _KILO for wall in walls]
        damping = [wall.damping for wall in walls]
        right = max(right, _ROOM * max(stiffness))
        top = max(top, _ROOM * max(damping))
        left = min(min(stiffness) / _ROOM, right / _LEAST_SPAN)
        bottom = min(min(damping) / _ROOM, top / _LEAST_SPAN)
    edges = (
        (width.edge, "coupled", "-", "rendered with every hand"),
        (width.likely, "ink", "--", "rendered by 95 % of likely devices"),
    )
    for edge, name, dashes, label in edges:
        if edge is None:
            continue
        # Down to both axes.
        across = np.append(np.maximum(edge.stiffness / _KILO, left), left)
        up = np.append(edge.damping, 0.0)
        ax.plot(across, up, color=COLOURS[name], linestyle=dashes, label=label)
        if edge is width.edge:
            ax.fill(across, up, color=COLOURS[name], alpha=_FILL_ALPHA, linewidth=0)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    if walls:
        log_scale(ax, plain=True)
    for wall in walls or width.references:
        place = (wall.stiffness / _KILO, wall.damping)
        ax.plot(*place, "o", markersize=3, color=COLOURS["ink"])
        # On the side that has room.
        is_left = (ax.transData - ax.transAxes).transform(place)[0] < _MIDDLE
        ax.annotate(
            wall.environment, place, xytext=(4 if is_left else -4, 3),
            ha="left" if is_left else "right", textcoords="offset points",
        )  # fmt: skip
    ax.set_xlabel("stiffness (kN/m)")
    ax.set_ylabel("damping (N·s/m)")


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
        ax.plot([binding], [reached], "o", markersize=5, color=colour)
    log_scale(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("admittance, real part (m/(N·s))")


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
            draw_stability(axes[-1], by_paper)
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
