"""The figures of couplings: Eq. 10, and maps of what feels real."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.inference.record import percent
from percept.report.figures.canvas import (
    COLOURS,
    WIDE,
    Drawing,
    Frame,
    legend,
    log_scale,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.curves import draw_stability
from percept.report.select import METHOD_NAMES, choice_said, chosen, words_of
from percept.results import (
    AdmissibleCouplings,
    Coupling,
    EnvironmentCouplings,
    Results,
)

__all__ = [
    "design_drawings", "draw_couplings", "stability_drawings",
]  # fmt: skip

#: Probabilities from which on the map is a shade darker; the decision is one more.
SHADES = (0.05, 0.25, 0.5, 0.75)
#: Opacity of one shade: they add up where one lies on another.
SHADE_ALPHA = 0.16
_LIKELY = 0.5  # the probability of the dashed line
_KILO = 1e3  # N/m in kN/m
_ROOM = 1.05  # factor on what an axis has to show
_MOST_COLUMNS = 6  # panels side by side
_FEWEST_COLUMNS = 3
_TITLE_WIDTH = 24.0  # mm
_PANEL_HEIGHT = 42.0  # mm, with its labels
_LEGEND_HEIGHT = 15.0  # mm
_STABILITY_SIZE = (120.0, 50.0)  # mm


def draw_couplings(ax: Axes, couplings: EnvironmentCouplings, *, decision: float) -> None:
    """Draw how probably couplings that are stable in time feel real, by stiffness and damping.

    Parameters
    ----------
    ax : Axes
        To draw on; its stiffness becomes logarithmic.
    couplings : EnvironmentCouplings
        The map, and its ends.
    decision : float
        Probability from which a coupling feels real.
    """
    stiffness = couplings.stiffness / _KILO
    lines = np.broadcast_to(couplings.damping[:, None], stiffness.shape)
    probability = couplings.probability
    if couplings.limited:
        ax.plot(
            stiffness[:, -1], couplings.damping, color=COLOURS["quiet"], linewidth=0.8,
            label="edge of what is stable in time",
        )  # fmt: skip
    for least in (*SHADES, decision):
        if probability.max() > least:
            ax.contourf(
                stiffness, lines, probability, levels=[least, 1.1], colors=[COLOURS["coupled"]],
                alpha=SHADE_ALPHA,
            )  # fmt: skip
    for least, dashes in ((_LIKELY, (0, (3, 2))), (decision, "solid")):
        # A line of the legend also where this map has none.
        ax.plot(
            [], [], label=f"{percent(least)} probability", color=COLOURS["coupled"],
            linestyle=dashes, linewidth=0.9,
        )  # fmt: skip
        if probability.min() < least < probability.max():
            ax.contour(
                stiffness, lines, probability, levels=[least], colors=[COLOURS["coupled"]],
                linestyles=[dashes], linewidths=0.9,
            )  # fmt: skip
    for end in (couplings.stiffest, couplings.softest):
        if end is not None:
            ax.plot(
                [end.stiffness / _KILO], [end.damping], "o", markersize=3.5, clip_on=False,
                color=COLOURS["coupled"], label="stiffest and softest that feel real",
            )  # fmt: skip
    largest = float(probability.max())
    if largest < decision:
        text = f"at most {100.0 * largest:.0f} %"
        ax.text(0.05, 0.05, text, color=COLOURS["quiet"], transform=ax.transAxes)
    log_scale(ax, "x", plain=True)


def _draw_used(ax: Axes, stiffness: float, damping: float) -> None:
    """Mark the coupling in use, its numbers in the legend; at the edge where it lies beyond."""
    own = stiffness / _KILO
    ax.plot(
        [min(own, ax.get_xlim()[1])], [min(damping, ax.get_ylim()[1])], "X", markersize=5,
        color=COLOURS["warn"], clip_on=False,
        label=f"coupling in use ({own:.4g} kN/m, {damping:.4g} N·s/m)",
    )  # fmt: skip


def design_drawings(results: Results) -> list[Drawing]:
    """Return the map of couplings by the probability that they feel real."""
    design = results.design
    if design is None:
        return []
    names = [region.name for region in design.environments if region.name is not None]
    drawn = {*chosen(names), None}
    regions = [region for region in design.environments if region.name in drawn]
    columns = min(max(len(regions), _FEWEST_COLUMNS), _MOST_COLUMNS)
    used = results.provenance.scene.get("coupling")

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(regions), columns=columns, frame=Frame(bottom=17, gap=9, line=8))
        titles = row_labels(
            [region.name or "all together" for region in regions], most=_TITLE_WIDTH
        )
        left = min(float(region.stiffness[0, 0]) for region in regions) / _KILO
        right = max(float(region.stiffness.max()) for region in regions) / _KILO
        for ax, region, title in zip(axes, regions, titles, strict=True):
            draw_couplings(ax, region, decision=design.decision)
            ax.set_xlim(left / _ROOM, _ROOM * right)
            ax.set_ylim(0.0, _ROOM * float(region.damping[-1]))
            if used is not None:
                _draw_used(ax, used["stiffness"], used["damping"])
            ax.set_title(title, loc="left")
            ax.set_xlabel("stiffness (kN/m)")
            ax.set_ylabel("damping (N·s/m)")
        outer_labels(axes, columns)
        for ax in axes:
            # What is stable ends elsewhere in each panel.
            ax.tick_params(labelleft=True)
        legend(max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0])), ncols=3)

    rows = -(-len(regions) // columns)
    return [
        Drawing(
            name="design",
            title="Probability that couplings stable in time feel real, by stiffness and damping",
            description=_said(results, design) + choice_said(names, words_of(results).environments),
            size=(WIDE, _LEGEND_HEIGHT + _PANEL_HEIGHT * rows),
            draw=draw,
        )
    ]


def _said(results: Results, design: AdmissibleCouplings) -> str:
    """Say what the map shows."""
    shades = ", ".join(f"{100 * shade:.0f}" for shade in SHADES)
    words = words_of(results)
    draws = min(region.draws for region in design.environments)
    said = (
        f"Left of the edge this device renders the {words.environment} with every passive hand,"
        f" in time. Without an edge all couplings do. The darker, the more probably displays"
        f" through the coupling feel real ({METHOD_NAMES[design.method]},"
        f" {draws} draws of the {words.users}): shades begin at {shades} and"
        f" {percent(design.decision)}."
    )
    if len(design.environments) > 1:
        said += f" “All together” shows the least probable of the {words.environments}."
    if results.provenance.scene.get("coupling") is not None:
        said += " The cross is the coupling in use."
    return said


def stability_drawings(coupling: Coupling | None) -> list[Drawing]:
    """Return Eq. 10 over ω (Fig. 4)."""
    if coupling is None or not len(coupling.bound):
        return []

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18, top=3))
        lines = {"this coupling": (coupling.admittance, coupling.eq10_omega)}
        draw_stability(ax, coupling.omega, coupling.bound, lines)

    return [
        Drawing(
            name="stability",
            title="Equation 10 over the angular frequency",
            description="By the paper, the real part of the coupling’s admittance 1/Z_c has to stay"
            " above the lower bound.",
            size=_STABILITY_SIZE,
            draw=draw,
        )
    ]
