"""The figures of couplings and devices: the stability criterion, and maps of what feels real."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from percept.inference.record import percent
from percept.report.figures.canvas import (
    COLOURS,
    WIDE,
    Drawing,
    Frame,
    brief,
    legend,
    log_scale,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.curves import draw_stability
from percept.report.select import METHOD_NAMES, choice_said, chosen, device_ranges, words_of
from percept.results import (
    AdmissibleCouplings,
    Coupling,
    DeviceMap,
    DeviceProbabilities,
    EnvironmentCouplings,
    Results,
)
from percept.results.fields import Array

__all__ = [
    "design_drawings", "device_drawings", "draw_couplings", "draw_devices", "stability_drawings",
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
_DEVICE_COLUMNS = 4  # panels side by side
_DEVICE_TITLE_WIDTH = 34.0  # mm
_DEVICE_HEIGHT = 46.0  # mm, with its labels
_DEVICE_LABELS = 12.0  # mm, of the lowest panels
_CELL_ALPHA = 0.6  # opacity of a certain cell: its number stays readable
_STABILITY_SIZE = (120.0, 50.0)  # mm


def draw_couplings(
    ax: Axes, damping: Array, couplings: EnvironmentCouplings, *, decision: float
) -> None:
    """Draw how probably stable couplings feel real, by their stiffness and damping.

    Parameters
    ----------
    ax : Axes
        To draw on; its stiffness becomes logarithmic.
    damping : ndarray, shape (B,)
        Of each line of the map, N·s/m.
    couplings : EnvironmentCouplings
        The map, and its ends.
    decision : float
        Probability from which a coupling feels real.
    """
    stiffness = couplings.stiffness / _KILO
    lines = np.broadcast_to(damping[:, None], stiffness.shape)
    probability = couplings.probability
    ax.plot(
        stiffness[:, -1], damping, color=COLOURS["quiet"], linewidth=0.8,
        label="edge of the stable region",
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
        axes = panels(figure, len(regions), columns=columns, frame=Frame(bottom=17, gap=3, line=8))
        titles = row_labels(
            [region.name or "all together" for region in regions], most=_TITLE_WIDTH
        )
        left = min(float(region.stiffness[0, 0]) for region in regions) / _KILO
        right = max(float(region.stiffness.max()) for region in regions) / _KILO
        for ax, region, title in zip(axes, regions, titles, strict=True):
            draw_couplings(ax, design.damping, region, decision=design.decision)
            ax.set_xlim(left / _ROOM, _ROOM * right)
            ax.set_ylim(0.0, _ROOM * float(design.damping[-1]))
            if used is not None:
                _draw_used(ax, used["stiffness"], used["damping"])
            ax.set_title(title, loc="left")
            ax.set_xlabel("stiffness (kN/m)")
            ax.set_ylabel("damping (N·s/m)")
        outer_labels(axes, columns)
        legend(max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0])), ncols=3)

    rows = -(-len(regions) // columns)
    return [
        Drawing(
            name="design",
            title="Probability that stable couplings feel real, by stiffness and damping",
            description=_said(results, design) + choice_said(names, words_of(results).environments),
            size=(WIDE, _LEGEND_HEIGHT + _PANEL_HEIGHT * rows),
            draw=draw,
        )
    ]


def _said(results: Results, design: AdmissibleCouplings) -> str:
    """Say what the map shows."""
    shades = ", ".join(f"{100 * shade:.0f}" for shade in SHADES)
    words = words_of(results)
    said = (
        "Left of the edge couplings are stable with this device. The darker, the more probably"
        f" displays through the coupling feel real ({METHOD_NAMES[design.method]},"
        f" {design.draws} draws of the {words.users}): shades begin at {shades} and"
        f" {percent(design.decision)}."
    )
    if len(design.environments) > 1:
        said += f" “All together” shows the least probable of the {words.environments}."
    if results.provenance.scene.get("coupling") is not None:
        said += " The cross is the coupling in use."
    return said


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


def draw_devices(ax: Axes, devices: DeviceMap, of_environment: DeviceProbabilities) -> None:
    """Draw a cell per device, damping upwards and mass to the right, with its probability.

    Parameters
    ----------
    ax : Axes
        To draw on.
    devices : DeviceMap
        The devices.
    of_environment : DeviceProbabilities
        Probabilities of one environment.
    """
    for (row, column), probability in np.ndenumerate(of_environment.probability):
        stable = devices.stable[row][column]
        ax.add_patch(
            Rectangle(
                (column - 0.5, row - 0.5), 1.0, 1.0, linewidth=0.4, edgecolor=COLOURS["rule"],
                facecolor=COLOURS["coupled"], alpha=_CELL_ALPHA * float(probability),
            )
        )  # fmt: skip
        # An unstable coupling has no number: its display was not judged.
        text = f"{100.0 * probability:.0f}" if stable else "–"
        ax.text(column, row, text, ha="center", va="center", fontsize=6)
    own = Rectangle(
        (devices.own[1] - 0.5, devices.own[0] - 0.5), 1.0, 1.0, fill=False, linewidth=1.2,
        edgecolor=COLOURS["ink"],
    )  # fmt: skip
    ax.add_patch(own)
    ax.set_xlim(-0.5, len(devices.mass) - 0.5)
    ax.set_ylim(-0.5, len(devices.damping) - 0.5)
    ax.set_xticks(range(len(devices.mass)), [brief(mass) for mass in devices.mass])
    ax.set_yticks(range(len(devices.damping)), [brief(value) for value in devices.damping])
    ax.grid(visible=False)
    ax.set_xlabel("mass (kg)")
    ax.set_ylabel("damping (N·s/m)")


def device_drawings(results: Results) -> list[Drawing]:
    """Return the map of each environment whose probability moves with the device."""
    devices = results.sensitivity
    if devices is None:
        return []
    names = [found.name for found in device_ranges(devices) if found.varies]
    drawn = [one for one in devices.environments if one.name in names]
    if not drawn:
        return []
    columns = min(len(drawn), _DEVICE_COLUMNS)

    def draw(figure: Figure) -> None:
        frame = Frame(gap=4, line=9)
        axes = panels(figure, len(drawn), columns=_DEVICE_COLUMNS, frame=frame)
        titles = row_labels([one.name for one in drawn], most=_DEVICE_TITLE_WIDTH)
        for ax, of_environment, title in zip(axes, drawn, titles, strict=True):
            draw_devices(ax, devices, of_environment)
            ax.set_title(title, loc="left")
        outer_labels(axes, columns)

    rows = -(-len(drawn) // _DEVICE_COLUMNS)
    through = "through the coupling" if devices.coupled else "directly"
    said = (
        f"Probability in per cent that it feels real {through}, at every ω"
        f" ({METHOD_NAMES[devices.method]}, {devices.draws} draws)."
    )
    if devices.coupled:
        said += " A dash: the coupling is not stable."
    return [
        Drawing(
            name="device",
            title="Probability of feeling real, by mass and damping of the device",
            description=said + " The frame is the scene’s device.",
            size=(WIDE, _DEVICE_LABELS + _DEVICE_HEIGHT * rows),
            draw=draw,
        )
    ]
